//! Travel cost (4.6): one shortest-path tree grown from the robot serves all candidates.

/// A dense grid of ground, rows of constant y with x running fastest. The outermost cells are never passable.
#[derive(Debug, Default)]
pub(super) struct Terrain {
    /// Cells along x.
    pub width: usize,
    /// Side of a cell [m].
    pub cell_m: f64,
    /// 1 / C_nc of the cells that can be driven on, 1 or more; infinite where not.
    pub slowness: Vec<f32>,
}

/// The steps to the eight neighbours: along x and y, and whether they are diagonal.
const STEPS: [(isize, isize); 8] = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];

/// No parent: the start, or no path.
const NONE: u8 = u8::MAX;

impl Terrain {
    pub fn is_passable(&self, at: usize) -> bool {
        self.slowness.get(at).is_some_and(|s| s.is_finite())
    }

    fn offset(&self, step: usize) -> isize {
        let (dx, dy) = STEPS[step];
        dy * self.width as isize + dx
    }

    /// Calls `visit` with every cell that can be entered from `at`, the number of the step, and its length [cells]: a
    /// diagonal step only if both cells beside it can be driven on too.
    #[inline]
    fn for_each_step(&self, at: usize, offsets: &[isize; 8], mut visit: impl FnMut(usize, usize, f64)) {
        let mut is_free = [false; 5];
        for step in 0..4 {
            let next = at.wrapping_add_signed(offsets[step]);
            is_free[step] = self.slowness[next].is_finite();
            if is_free[step] {
                visit(next, step, 1.0);
            }
        }
        is_free[4] = is_free[0];
        for step in 4..8 {
            let next = at.wrapping_add_signed(offsets[step]);
            if is_free[step - 4] && is_free[step - 3] && self.slowness[next].is_finite() {
                visit(next, step, std::f64::consts::SQRT_2);
            }
        }
    }
}

/// The cheapest way from the start to every cell: C = sum of d(c_i, c_{i-1}) / C_nc(c_i) (4.6).
///
/// Cells wait in buckets as wide as the cheapest step, so that no cell of a bucket can make another one of it cheaper and
/// a bucket needs no order (Denardo and Fox 1979): a few steps a cell, where a heap would take some dozen.
#[derive(Debug, Default)]
pub(super) struct CostTree {
    width: usize,
    cost: Vec<f64>,
    /// The number of the step that leads to the cell.
    step: Vec<u8>,
    buckets: Vec<Vec<u32>>,
}

impl CostTree {
    /// Grows the tree anew in the memory it has. Of equal ways the one found first is kept, and cells are taken in a
    /// fixed order, so the tree is always the same.
    pub fn grow(&mut self, terrain: &Terrain, start: usize) {
        self.width = terrain.width;
        self.cost.clear();
        self.cost.resize(terrain.slowness.len(), f64::INFINITY);
        self.step.clear();
        self.step.resize(terrain.slowness.len(), NONE);
        if !terrain.is_passable(start) {
            return;
        }
        let slowest = terrain.slowness.iter().copied().filter(|s| s.is_finite()).fold(1.0, f32::max);
        // The dearest step reaches so many buckets ahead, and rounding may add one.
        let count = (f64::from(slowest) * std::f64::consts::SQRT_2).ceil() as usize + 2;
        self.buckets.resize(count.max(self.buckets.len()), Vec::new());
        let offsets: [isize; 8] = std::array::from_fn(|step| terrain.offset(step));
        self.cost[start] = 0.0;
        self.buckets[0].push(start as u32);
        self.empty_buckets(terrain, &offsets);
    }

    fn empty_buckets(&mut self, terrain: &Terrain, offsets: &[isize; 8]) {
        let Self { cost, step, buckets, .. } = self;
        let count = buckets.len();
        let (mut bucket, mut idle) = (0usize, 0);
        // So many empty buckets in a row: nothing waits any more.
        while idle < count {
            let slot = bucket % count;
            let mut taken = 0;
            while let Some(&at) = buckets[slot].get(taken) {
                taken += 1;
                let at = at as usize;
                let here = cost[at];
                // Found again by a cheaper way, and taken in an earlier bucket.
                if ((here / terrain.cell_m) as usize) < bucket {
                    continue;
                }
                terrain.for_each_step(at, offsets, |next, number, length| {
                    let through_here = here + length * terrain.cell_m * f64::from(terrain.slowness[next]);
                    if through_here < cost[next] {
                        cost[next] = through_here;
                        step[next] = number as u8;
                        let due = ((through_here / terrain.cell_m) as usize).max(bucket);
                        buckets[due % count].push(next as u32);
                    }
                });
            }
            idle = if taken == 0 { idle + 1 } else { 0 };
            buckets[slot].clear();
            bucket += 1;
        }
    }

    /// C of a cell [m], or `None` when no path leads there.
    pub fn cost(&self, at: usize) -> Option<f64> {
        self.cost.get(at).copied().filter(|cost| cost.is_finite())
    }

    /// The cell before this one on the way from the start.
    pub fn parent(&self, at: usize) -> Option<usize> {
        let &step = self.step.get(at).filter(|&&step| step != NONE)?;
        let (dx, dy) = STEPS[usize::from(step)];
        Some(at.wrapping_add_signed(-(dy * self.width as isize + dx)))
    }

    /// The cells from the start to `at`, both included; empty when no path leads there.
    pub fn path_to(&self, at: usize) -> Vec<usize> {
        if self.cost(at).is_none() {
            return Vec::new();
        }
        let mut path = vec![at];
        let mut at = at;
        while let Some(parent) = self.parent(at) {
            at = parent;
            path.push(at);
        }
        path.reverse();
        path
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.cost.capacity() * 8 + self.step.capacity() + self.buckets.iter().map(|b| 4 * b.capacity()).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 11;

    /// Nine by nine cells within a rim that cannot be driven on.
    fn terrain(inner: &[f32]) -> Terrain {
        let mut slowness = vec![f32::INFINITY; SIDE * SIDE];
        for (k, &value) in inner.iter().enumerate() {
            slowness[place(k)] = value;
        }
        Terrain { width: SIDE, cell_m: 0.3, slowness }
    }

    fn place(inner: usize) -> usize {
        (inner / 9 + 1) * SIDE + inner % 9 + 1
    }

    fn grown(terrain: &Terrain, start: usize) -> CostTree {
        let mut tree = CostTree::default();
        tree.grow(terrain, start);
        tree
    }

    /// Bellman and Ford: relax every step again and again until nothing changes.
    fn brute_force(terrain: &Terrain, start: usize) -> Vec<f64> {
        let mut cost = vec![f64::INFINITY; terrain.slowness.len()];
        if terrain.is_passable(start) {
            cost[start] = 0.0;
        }
        let passable = |x: usize, y: usize| terrain.is_passable(y * SIDE + x);
        loop {
            let mut changed = false;
            for at in (0..cost.len()).filter(|&at| terrain.is_passable(at)) {
                let (x, y) = (at % SIDE, at / SIDE);
                for (dx, dy) in (-1..=1isize).flat_map(|dx| (-1..=1isize).map(move |dy| (dx, dy))) {
                    let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                    if (dx, dy) == (0, 0) || !passable(nx, ny) || !passable(nx, y) || !passable(x, ny) {
                        continue;
                    }
                    let next = ny * SIDE + nx;
                    let length = 0.3 * ((dx * dx + dy * dy) as f64).sqrt();
                    let through = cost[at] + length * f64::from(terrain.slowness[next]);
                    if through < cost[next] - 1e-12 {
                        cost[next] = through;
                        changed = true;
                    }
                }
            }
            if !changed {
                return cost;
            }
        }
    }

    fn ground() -> impl Strategy<Value = Vec<f32>> {
        prop::collection::vec(prop_oneof![1 => Just(f32::INFINITY), 2 => 1.0..2.0f32, 2 => Just(1.0f32)], 81)
    }

    proptest! {
        #[test]
        fn the_tree_finds_the_cheapest_ways(cells in ground(), start in 0..81usize) {
            let terrain = terrain(&cells);
            let mut tree = grown(&terrain, place(start));
            // Grown again in the same memory it is the same tree.
            tree.grow(&terrain, place(start));
            for (at, &expected) in brute_force(&terrain, place(start)).iter().enumerate() {
                match tree.cost(at) {
                    Some(cost) => prop_assert!((cost - expected).abs() < 1e-9, "{} {}", cost, expected),
                    None => prop_assert!(expected.is_infinite()),
                }
            }
        }

        #[test]
        fn paths_go_step_by_step_over_passable_cells_and_cut_no_corner(cells in ground(), start in 0..81usize) {
            let terrain = terrain(&cells);
            let tree = grown(&terrain, place(start));
            for at in 0..SIDE * SIDE {
                let path = tree.path_to(at);
                prop_assert_eq!(path.is_empty(), tree.cost(at).is_none());
                prop_assert!(path.is_empty() || (path[0] == place(start) && path.last() == Some(&at)));
                let mut cost = 0.0;
                for step in path.windows(2) {
                    let (ax, ay, bx, by) = (step[0] % SIDE, step[0] / SIDE, step[1] % SIDE, step[1] / SIDE);
                    prop_assert!(ax.abs_diff(bx).max(ay.abs_diff(by)) == 1);
                    prop_assert!(terrain.is_passable(ay * SIDE + bx) && terrain.is_passable(by * SIDE + ax));
                    let length = if ax == bx || ay == by { 0.3 } else { 0.3 * std::f64::consts::SQRT_2 };
                    cost += length * f64::from(terrain.slowness[step[1]]);
                }
                prop_assert!(path.is_empty() || (cost - tree.cost(at).unwrap()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn worse_ground_costs_more() {
        let mut cells = vec![f32::INFINITY; 81];
        cells[..3].copy_from_slice(&[1.0, 1.0, 1.25]);
        let tree = grown(&terrain(&cells), place(0));
        assert!((tree.cost(place(2)).unwrap() - (0.3 + 0.3 / 0.8)).abs() < 1e-12);
    }

    #[test]
    fn a_start_that_is_not_passable_reaches_nothing() {
        let mut cells = vec![1.0; 81];
        cells[0] = f32::INFINITY;
        let tree = grown(&terrain(&cells), place(0));
        assert!((0..SIDE * SIDE).all(|at| tree.cost(at).is_none()));
    }
}
