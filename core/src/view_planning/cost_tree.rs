//! Travel cost (4.6): one shortest-path tree grown from the robot serves all candidates.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A dense grid of ground, rows of constant y with x running fastest.
pub(super) struct Terrain {
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Side of a cell [m].
    pub cell_m: f64,
    /// 1 / C_nc of the cells that can be driven on; infinite where not.
    pub slowness: Vec<f64>,
}

impl Terrain {
    pub fn is_passable(&self, at: usize) -> bool {
        self.slowness.get(at).is_some_and(|s| s.is_finite())
    }

    /// Calls `visit` with every cell that can be entered from `at` and the length of the step [m]: 8 neighbours, a
    /// diagonal one only if both cells beside it can be driven on too.
    fn for_each_step(&self, at: usize, mut visit: impl FnMut(usize, f64)) {
        let (x, y) = (at % self.width, at / self.width);
        let side = |dx: isize, dy: isize| -> Option<usize> {
            let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            let next = y * self.width + x;
            (x < self.width && y < self.height && self.is_passable(next)).then_some(next)
        };
        let straight = [(1, 0), (0, 1), (-1, 0), (0, -1)].map(|(dx, dy)| side(dx, dy));
        for next in straight.into_iter().flatten() {
            visit(next, self.cell_m);
        }
        for (k, (dx, dy)) in [(1, 1), (-1, 1), (-1, -1), (1, -1)].into_iter().enumerate() {
            if straight[k].is_some()
                && straight[(k + 1) % 4].is_some()
                && let Some(next) = side(dx, dy)
            {
                visit(next, self.cell_m * std::f64::consts::SQRT_2);
            }
        }
    }
}

/// The cheapest way from the start to every cell: C = sum of d(c_i, c_{i-1}) / C_nc(c_i) (4.6).
pub(super) struct CostTree {
    cost: Vec<f64>,
    parent: Vec<u32>,
}

impl CostTree {
    /// Dijkstra's algorithm. Of equal ways the one settled first is kept, and equal costs are settled in the order of
    /// the cells, so the tree is always the same.
    pub fn grow(terrain: &Terrain, start: usize) -> Self {
        let cells = terrain.slowness.len();
        let mut tree = Self { cost: vec![f64::INFINITY; cells], parent: vec![u32::MAX; cells] };
        if !terrain.is_passable(start) {
            return tree;
        }
        tree.cost[start] = 0.0;
        // The bits of numbers that are not negative are ordered like the numbers.
        let mut front = BinaryHeap::from([Reverse((0.0f64.to_bits(), start as u32))]);
        while let Some(Reverse((bits, at))) = front.pop() {
            let (cost, at) = (f64::from_bits(bits), at as usize);
            if cost > tree.cost[at] {
                continue;
            }
            terrain.for_each_step(at, |next, length| {
                let through_here = cost + length * terrain.slowness[next];
                if through_here < tree.cost[next] {
                    tree.cost[next] = through_here;
                    tree.parent[next] = at as u32;
                    front.push(Reverse((through_here.to_bits(), next as u32)));
                }
            });
        }
        tree
    }

    /// C of a cell [m], or `None` when no path leads there.
    pub fn cost(&self, at: usize) -> Option<f64> {
        self.cost.get(at).copied().filter(|cost| cost.is_finite())
    }

    /// The cells from the start to `at`, both included; empty when no path leads there.
    pub fn path_to(&self, at: usize) -> Vec<usize> {
        if self.cost(at).is_none() {
            return Vec::new();
        }
        let mut path = vec![at];
        let mut at = at;
        while let Some(&parent) = self.parent.get(at)
            && parent != u32::MAX
        {
            at = parent as usize;
            path.push(at);
        }
        path.reverse();
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn terrain(width: usize, slowness: Vec<f64>) -> Terrain {
        Terrain { width, height: slowness.len() / width, cell_m: 0.3, slowness }
    }

    /// Bellman and Ford: relax every step again and again until nothing changes.
    fn brute_force(terrain: &Terrain, start: usize) -> Vec<f64> {
        let mut cost = vec![f64::INFINITY; terrain.slowness.len()];
        if terrain.is_passable(start) {
            cost[start] = 0.0;
        }
        let passable = |x: i32, y: i32| {
            x >= 0
                && y >= 0
                && x < terrain.width as i32
                && y < terrain.height as i32
                && terrain.slowness[y as usize * terrain.width + x as usize].is_finite()
        };
        loop {
            let mut changed = false;
            for at in 0..cost.len() {
                let (x, y) = ((at % terrain.width) as i32, (at / terrain.width) as i32);
                for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                    if (dx, dy) == (0, 0) || !passable(x + dx, y + dy) || !passable(x + dx, y) || !passable(x, y + dy) {
                        continue;
                    }
                    let next = (y + dy) as usize * terrain.width + (x + dx) as usize;
                    let through = cost[at] + 0.3 * f64::from(dx * dx + dy * dy).sqrt() * terrain.slowness[next];
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

    proptest! {
        #[test]
        fn the_tree_finds_the_cheapest_ways(
            cells in prop::collection::vec(prop_oneof![1 => Just(f64::INFINITY), 2 => 1.0..1.5f64], 81), start in 0..81usize,
        ) {
            let terrain = terrain(9, cells);
            let tree = CostTree::grow(&terrain, start);
            for (at, &expected) in brute_force(&terrain, start).iter().enumerate() {
                match tree.cost(at) {
                    Some(cost) => prop_assert!((cost - expected).abs() < 1e-9),
                    None => prop_assert!(expected.is_infinite()),
                }
            }
        }

        #[test]
        fn paths_go_step_by_step_over_passable_cells_and_cut_no_corner(
            cells in prop::collection::vec(prop_oneof![1 => Just(f64::INFINITY), 2 => 1.0..1.5f64], 81), start in 0..81usize,
        ) {
            let terrain = terrain(9, cells);
            let tree = CostTree::grow(&terrain, start);
            for at in 0..81 {
                let path = tree.path_to(at);
                prop_assert_eq!(path.is_empty(), tree.cost(at).is_none());
                prop_assert!(path.is_empty() || (path[0] == start && path.last() == Some(&at)));
                for step in path.windows(2) {
                    let (ax, ay, bx, by) = (step[0] % 9, step[0] / 9, step[1] % 9, step[1] / 9);
                    prop_assert!(ax.abs_diff(bx).max(ay.abs_diff(by)) == 1);
                    prop_assert!(terrain.is_passable(ay * 9 + bx) && terrain.is_passable(by * 9 + ax));
                }
            }
        }
    }

    #[test]
    fn worse_ground_costs_more() {
        let tree = CostTree::grow(&terrain(3, vec![1.0, 1.0, 1.25]), 0);
        assert!((tree.cost(2).unwrap() - (0.3 + 0.3 / 0.8)).abs() < 1e-12);
    }

    #[test]
    fn a_start_that_is_not_passable_reaches_nothing() {
        let tree = CostTree::grow(&terrain(3, vec![f64::INFINITY, 1.0, 1.0]), 0);
        assert!((0..3).all(|at| tree.cost(at).is_none()));
    }
}
