//! Which cells does a triangle cover, seen from above?

use super::grid_line::cells_of_line;
use super::index::{CellIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS};

/// A triangle from above, its corners in units of a cell's side / `CELL_UNITS` (each stands for the unit's middle), in
/// the order of x, then y.
pub(super) struct Outline {
    corners: [(i32, i32); 3],
}

impl Outline {
    #[inline(always)]
    pub fn of([p, q, r]: [(i32, i32); 3]) -> Self {
        // As one number each, so that they are compared, and exchanged, without branches.
        let number = |(x, y): (i32, i32)| i64::from(x) << 32 | i64::from(y.wrapping_sub(i32::MIN) as u32);
        let corner = |n: i64| ((n >> 32) as i32, (n as u32 as i32).wrapping_add(i32::MIN));
        let (p, q, r) = (number(p), number(q), number(r));
        let (low, high) = (p.min(q), p.max(q));
        let (middle, last) = (high.min(r), high.max(r));
        Self { corners: [corner(low.min(middle)), corner(low.max(middle)), corner(last)] }
    }

    /// Calls `visit` for every cell whose centre lies inside, at most `limit` times. Edges are half open, so triangles
    /// that share an edge never share a cell. Returns whether cells were left out.
    #[inline(always)]
    pub fn cells_inside(&self, limit: usize, mut visit: impl FnMut(CellIndex)) -> bool {
        let [a, b, c] = self.corners;
        // A middle of a unit is never the middle of a cell: the last cell whose centre lies before it is exact.
        let before = |v: i32| (v - CELL_UNITS / 2) >> CELL_SHIFT;
        let (lowest, highest) = (before(a.1.min(b.1).min(c.1)) + 1, before(a.1.max(b.1).max(c.1)));
        let rows = (highest - lowest + 1) as usize;
        if lowest > highest || (before(a.0) == before(c.0) && rows <= limit) {
            return false;
        }
        let cells = |v: i32| (f64::from(v) + 0.5) / f64::from(CELL_UNITS);
        let corners = [[cells(a.0), cells(a.1)], [cells(b.0), cells(b.1)], [cells(c.0), cells(c.1)]];
        let mut left = limit;
        for (row, y) in (lowest..=highest).enumerate() {
            if row >= limit {
                return true;
            }
            let (low, high) = crossings(&corners, f64::from(y) + 0.5);
            for x in ceil(low - 0.5)..ceil(high - 0.5) {
                if left == 0 {
                    return true;
                }
                left -= 1;
                visit(CellIndex { x, y });
            }
        }
        false
    }
}

#[inline(always)]
fn ceil(value: f64) -> i32 {
    -floor(-value)
}

/// Where the horizontal line at `y`, which passes between the corners, enters and leaves the triangle. Its corners are
/// in order, so the two triangles of an edge compute the same crossing.
#[inline(always)]
fn crossings(corners: &[[f64; 2]; 3], y: f64) -> (f64, f64) {
    // All three are computed and one dropped: which one cannot be predicted. An edge along the line divides by zero,
    // and is dropped.
    let crossing = |a: [f64; 2], b: [f64; 2]| {
        let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
        let is_crossed = (a[1] <= y) != (b[1] <= y);
        if is_crossed { (x, x) } else { (f64::INFINITY, f64::NEG_INFINITY) }
    };
    let least = |a: f64, b: f64| if a < b { a } else { b };
    let greatest = |a: f64, b: f64| if a > b { a } else { b };
    let [a, b, c] = *corners;
    let (p, q, r) = (crossing(a, b), crossing(b, c), crossing(a, c));
    (least(least(p.0, q.0), r.0), greatest(greatest(p.1, q.1), r.1))
}

/// Calls `visit` for the cells under the triangle's longest side, seen from above, at most `limit` times: a steep
/// triangle is a line from above, and may pass between all cell centres. Returns whether cells were left out.
pub(super) fn cells_under_longest_side(
    corners: &[[f64; 2]; 3],
    cells: &[CellIndex; 3],
    limit: usize,
    visit: impl FnMut(CellIndex),
) -> bool {
    let length = |i: usize, j: usize| {
        let (dx, dy) = (corners[i][0] - corners[j][0], corners[i][1] - corners[j][1]);
        dx * dx + dy * dy
    };
    let sides = [(0, 1), (1, 2), (2, 0)];
    let (i, j) = sides
        .into_iter()
        .fold(sides[0], |best, side| if length(side.0, side.1) > length(best.0, best.1) { side } else { best });
    let mut line = cells_of_line(cells[i], cells[j]);
    line.by_ref().take(limit).for_each(visit);
    line.next().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covered(corners: [(i32, i32); 3]) -> Vec<CellIndex> {
        let mut cells = Vec::new();
        assert!(!Outline::of(corners).cells_inside(100_000, |cell| cells.push(cell)));
        cells
    }

    fn units(range: std::ops::Range<i32>) -> impl Strategy<Value = (i32, i32)> {
        let range = range.start * CELL_UNITS..range.end * CELL_UNITS;
        (range.clone(), range)
    }

    fn is_inside(corners: &[[f64; 2]; 3], p: [f64; 2]) -> Option<bool> {
        let side = |a: [f64; 2], b: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let sides = [side(corners[0], corners[1]), side(corners[1], corners[2]), side(corners[2], corners[0])];
        if sides.iter().any(|s| s.abs() < 1e-6) {
            return None;
        }
        Some(sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0))
    }

    proptest! {
        #[test]
        fn exactly_the_cells_with_their_centre_inside_are_covered(
            a in units(-9..9), b in units(-9..9), c in units(-9..9),
        ) {
            let cells = covered([a, b, c]);
            let middle = |v: i32| (f64::from(v) + 0.5) / f64::from(CELL_UNITS);
            let corners = [a, b, c].map(|(x, y)| [middle(x), middle(y)]);
            for x in -10..10 {
                for y in -10..10 {
                    if let Some(inside) = is_inside(&corners, [f64::from(x) + 0.5, f64::from(y) + 0.5]) {
                        prop_assert_eq!(cells.contains(&CellIndex { x, y }), inside);
                    }
                }
            }
        }

        #[test]
        fn two_halves_of_a_quad_cover_each_cell_once(
            a in units(-9..0), d in units(0..9),
        ) {
            let (b, c) = ((d.0, a.1), (a.0, d.1));
            let mut both = covered([a, b, c]);
            both.extend(covered([b, d, c]));
            let count = both.len();
            both.sort();
            both.dedup();
            prop_assert_eq!(both.len(), count);
            let mut whole = covered([a, b, d]);
            whole.extend(covered([a, d, c]));
            prop_assert_eq!(whole.len(), count);
        }
    }

    #[test]
    fn a_triangle_larger_than_the_limit_is_clipped() {
        let mut count = 0;
        assert!(Outline::of([(0, 0), (6400, 0), (0, 6400)]).cells_inside(50, |_| count += 1));
        assert_eq!(count, 50);
        assert!(Outline::of([(0, 0), (0, 1 << 18), (1, 1 << 18)]).cells_inside(50, |_| ()));
    }

    #[test]
    fn a_steep_triangle_covers_the_line_under_it() {
        let corners = [[0.5, 0.5], [6.5, 0.5], [3.5, 0.5]];
        let cells = corners.map(|c| CellIndex::containing(c[0], c[1]).unwrap());
        let mut line = Vec::new();
        assert!(!cells_under_longest_side(&corners, &cells, 100, |cell| line.push(cell.x)));
        assert_eq!(line, [0, 1, 2, 3, 4, 5, 6]);
        assert!(cells_under_longest_side(&corners, &cells, 3, |_| ()));
    }
}
