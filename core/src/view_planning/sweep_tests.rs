//! The sweep against its definition, walked line by line.

use super::*;
use proptest::prelude::*;

/// A square of cells, the scanner in the middle; a cell outside blocks nothing.
struct World {
    radius: i32,
    side: usize,
    blocks: BitPlane,
}

impl World {
    fn new(radius: i32, blocking: impl Fn(i32, i32) -> bool) -> Self {
        let side = (2 * radius as usize + 3).div_ceil(WORD) * WORD;
        let mut blocks = BitPlane::default();
        blocks.reset(side, side / WORD, 0);
        let middle = radius + 1;
        for (x, y) in (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y))) {
            if blocking(x, y) {
                blocks.set((y + middle) as usize, (x + middle) as usize);
            }
        }
        Self { radius, side, blocks }
    }

    /// A pseudo-random world in which about `per_mille` of the cells block.
    fn random(radius: i32, seed: u64, per_mille: u64) -> Self {
        let hash = move |x: i32, y: i32| {
            let mut z = seed ^ ((x as u64) << 32 | u64::from(y as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z ^ (z >> 31)) % 1000
        };
        Self::new(radius, move |x, y| hash(x, y) < per_mille)
    }

    fn blocks(&self, x: i32, y: i32) -> bool {
        let middle = self.radius + 1;
        self.blocks.has((y + middle) as usize, (x + middle) as usize)
    }

    fn sweep(&self, reach: &Reach) -> Sweep {
        let mut columns = BitPlane::default();
        columns.reset(self.side, self.side / WORD, 0);
        self.blocks.or_transposed_into(&mut columns);
        let mut sweep = Sweep::default();
        let middle = (self.radius + 1) as usize;
        sweep.run(&Blocking { rows: &self.blocks, columns: &columns }, reach, middle, middle);
        sweep
    }

    /// The definition: no blocking cell but the two at the ends is touched.
    fn is_seen(&self, x: i32, y: i32) -> bool {
        let (long, short, is_steep) = if x.abs() >= y.abs() { (x, y, false) } else { (y, x, true) };
        (0..=long.abs()).all(|k| {
            let along = k * long.signum();
            // The line passes here; within half a cell on either side it leaves this by at most half a cell.
            let across = (f64::from(short) * f64::from(k) / f64::from(long.abs())).round() as i32;
            (across - 2..=across + 2).all(|across| {
                let (bx, by) = if is_steep { (across, along) } else { (along, across) };
                let is_end = (bx, by) == (0, 0) || (bx, by) == (x, y);
                let is_outside = bx.abs().max(by.abs()) > self.radius;
                is_end || is_outside || !self.blocks(bx, by) || !touches((x, y), (bx, by))
            })
        })
    }

    fn check(&self, reach: &Reach) -> Result<(), TestCaseError> {
        let sweep = self.sweep(reach);
        let middle = self.radius + 1;
        let mut seen = 0;
        for (x, y) in reach.offsets() {
            let is_seen = sweep.sees((x + middle) as usize, (y + middle) as usize);
            seen += usize::from(is_seen);
            prop_assert_eq!(is_seen, self.is_seen(x, y), "cell ({}, {})", x, y);
        }
        // Nothing out of range is marked, nor the scanner's own cell.
        prop_assert_eq!(sweep.seen.count(), seen);
        Ok(())
    }
}

/// Whether the segment from (0, 0) to `end` and the closed square about `cell` share a point, by whole numbers: two
/// convex sets are apart when an axis tells them apart, here x, y or the segment's normal.
fn touches(end: (i32, i32), cell: (i32, i32)) -> bool {
    let apart =
        |from: i32, to: i32, middle: i32| 2 * from.max(to) < 2 * middle - 1 || 2 * from.min(to) > 2 * middle + 1;
    if apart(0, end.0, cell.0) || apart(0, end.1, cell.1) {
        return false;
    }
    let side = |dx: i32, dy: i32| (end.0 * (2 * cell.1 + dy) - end.1 * (2 * cell.0 + dx)).signum();
    let sides = [side(-1, -1), side(1, -1), side(-1, 1), side(1, 1)];
    !(sides.iter().all(|&s| s > 0) || sides.iter().all(|&s| s < 0))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn small_worlds_of_every_density_are_seen_as_defined(
        radius in 1..14i32, shrink in 0.0..1.0f64, seed in any::<u64>(), per_mille in prop_oneof![Just(5u64), Just(30), Just(100), Just(300), Just(700)],
    ) {
        let reach = Reach::new((f64::from(radius) - shrink).max(1.0));
        World::random(radius, seed, per_mille).check(&reach)?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn worlds_of_fifty_metres_are_seen_as_defined(
        radius in 60..=167i32, seed in any::<u64>(), per_mille in prop_oneof![Just(0u64), Just(1), Just(3), Just(10), Just(40)],
    ) {
        World::random(radius, seed, per_mille).check(&Reach::new(f64::from(radius)))?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn walls_and_streets_are_seen_as_defined(
        walls in prop::collection::vec((-40..=40i32, -40..=40i32, 1..30i32, any::<bool>()), 0..12), radius in 20..=40i32,
    ) {
        let is_wall = |x: i32, y: i32| {
            walls.iter().any(|&(wx, wy, length, is_upright)| {
                if is_upright { x == wx && (wy..wy + length).contains(&y) } else { y == wy && (wx..wx + length).contains(&x) }
            })
        };
        World::new(radius, is_wall).check(&Reach::new(f64::from(radius)))?;
    }
}

proptest! {
    #[test]
    fn the_simplest_fraction_between_two_has_the_least_denominator(a in -40..=40i32, b in 1..=40i32, c in -40..=40i32, d in 1..=40i32) {
        prop_assume!(a * d != c * b);
        let (low, high) = if a * d < c * b { ([a, b], [c, d]) } else { ([c, d], [a, b]) };
        let is_between = |n: i32, m: i32| low[0] * m < n * low[1] && n * high[1] < high[0] * m;
        let [n, m] = simplest(low, high);
        prop_assert!(is_between(n, m), "{}/{}", n, m);
        prop_assert!((1..m).all(|m| (-41 * m..=41 * m).all(|n| !is_between(n, m))));
    }
}

fn seen(radius: i32, walls: &[(i32, i32)]) -> Vec<(i32, i32)> {
    let world = World::new(radius, |x, y| walls.contains(&(x, y)));
    let reach = Reach::new(f64::from(radius));
    let sweep = world.sweep(&reach);
    let middle = radius + 1;
    reach.offsets().filter(|&(x, y)| sweep.sees((x + middle) as usize, (y + middle) as usize)).collect()
}

#[test]
fn open_ground_is_seen_to_the_range_and_no_farther() {
    let disc = |cells: f64| Reach::new(cells).offsets().count();
    assert_eq!(disc(1.0), 4);
    assert_eq!(disc(1.5), 8);
    assert_eq!(disc(5.0), 80);
    assert_eq!(seen(20, &[]).len(), Reach::new(20.0).offsets().count());
    // 50 m at 0.3 m a cell: 166.67 cells; the corner cells of the 167th column are out.
    assert_eq!(Reach::new(50.0 / 0.3).radius, 166);
    // A whole number of cells that division makes a hair smaller.
    assert_eq!(Reach::new(0.3 * 9.0 / 0.3 / 9.0 * 3.0).radius, 3);
}

#[test]
fn a_wall_is_seen_and_hides_what_is_behind_it() {
    let wall: Vec<_> = (-20..=20).map(|y| (5, y)).collect();
    let seen = seen(20, &wall);
    assert!(seen.contains(&(5, 0)) && seen.contains(&(5, 3)) && seen.contains(&(4, 0)) && seen.contains(&(-15, 2)));
    assert!(seen.iter().all(|&(x, _)| x <= 5));
}

#[test]
fn a_line_through_a_shared_corner_is_blocked() {
    assert!(!seen(4, &[(1, 0)]).contains(&(1, 1)), "the corner belongs to the blocking cell");
    assert!(!seen(4, &[(2, 1)]).contains(&(2, 2)));
    assert!(seen(4, &[(2, 1)]).contains(&(1, 1)));
    // (2, 1) passes the corner (1.5, 0.5)... of (2, 0) at its edge, not of (0, 1).
    assert!(!seen(4, &[(1, 0)]).contains(&(2, 1)) && !seen(4, &[(1, 1)]).contains(&(2, 1)));
    assert!(seen(4, &[(0, 1)]).contains(&(2, 1)));
}
