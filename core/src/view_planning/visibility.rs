//! Which cells does a scanner see? Straight rays over the grid, the same for every candidate.

/// One cell of a ray, relative to the scanner's cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Offset in the grid's arrays.
    pub offset: isize,
    /// Cells along x and y.
    pub dx: i16,
    /// Cells along y.
    pub dy: i16,
    /// Whether this ray is the one that is aimed best at this cell: each cell in range belongs to one ray, and counts
    /// as seen when that ray reaches it.
    pub is_own: bool,
}

/// The rays from a cell to every cell on the rim of a square, cut off at the range. Every cell in range lies exactly
/// on the ray it belongs to; the line walked to it leaves the true line by at most half a cell.
pub(super) struct RayTable {
    steps: Vec<Step>,
    ends: Vec<usize>,
}

impl RayTable {
    /// Rays of `radius` cells over a grid of `width` cells a row.
    pub fn new(radius: i32, width: usize) -> Self {
        let rim = (-radius..=radius)
            .flat_map(|k| [(radius, k), (-radius, k)])
            .chain((1 - radius..radius).flat_map(|k| [(k, radius), (k, -radius)]));
        let mut table = Self { steps: Vec::new(), ends: Vec::new() };
        for target in rim {
            for k in 1..=radius {
                let (dx, dy) = (rounded(target.0 * k, radius), rounded(target.1 * k, radius));
                if dx * dx + dy * dy > radius * radius {
                    break;
                }
                let offset = dy as isize * width as isize + dx as isize;
                let is_own = best_target(dx, dy, radius) == target;
                table.steps.push(Step { offset, dx: dx as i16, dy: dy as i16, is_own });
            }
            table.ends.push(table.steps.len());
        }
        table
    }

    /// The rays, each from the scanner outwards, without the scanner's own cell.
    pub fn rays(&self) -> impl Iterator<Item = &[Step]> + '_ {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).filter_map(|(start, &end)| self.steps.get(start..end))
    }
}

/// a / b to the nearest integer, halves away from zero; b > 0.
fn rounded(a: i32, b: i32) -> i32 {
    a.signum() * ((2 * a.abs() + b) / (2 * b))
}

/// The rim cell of the ray aimed best at a cell.
fn best_target(dx: i32, dy: i32, radius: i32) -> (i32, i32) {
    if dx.abs() >= dy.abs() {
        (dx.signum() * radius, rounded(dy * radius, dx.abs().max(1)))
    } else {
        (rounded(dx * radius, dy.abs()), dy.signum() * radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// The cells seen from the middle of a square of walls.
    fn seen(radius: i32, walls: &[(i32, i32)]) -> Vec<(i32, i32)> {
        let table = RayTable::new(radius, 1000);
        let mut seen = Vec::new();
        for ray in table.rays() {
            for step in ray {
                let cell = (i32::from(step.dx), i32::from(step.dy));
                if step.is_own {
                    seen.push(cell);
                }
                if walls.contains(&cell) {
                    break;
                }
            }
        }
        seen
    }

    proptest! {
        #[test]
        fn every_cell_in_range_belongs_to_exactly_one_ray(radius in 1..60i32) {
            let mut count = BTreeMap::new();
            for cell in seen(radius, &[]) {
                *count.entry(cell).or_insert(0) += 1;
            }
            for x in -radius..=radius {
                for y in -radius..=radius {
                    let in_range = (x, y) != (0, 0) && x * x + y * y <= radius * radius;
                    prop_assert_eq!(count.get(&(x, y)).copied().unwrap_or(0), i32::from(in_range), "{} {}", x, y);
                }
            }
        }

        #[test]
        fn a_mirrored_world_is_seen_mirrored(walls in prop::collection::vec((-9..=9i32, -9..=9i32), 0..12)) {
            let flip = |cells: Vec<(i32, i32)>| {
                let mut cells: Vec<_> = cells.into_iter().map(|(x, y)| (-x, -y)).collect();
                cells.sort();
                cells
            };
            let mirrored: Vec<_> = walls.iter().map(|&(x, y)| (-x, -y)).collect();
            let mut there = seen(10, &mirrored);
            there.sort();
            prop_assert_eq!(flip(seen(10, &walls)), there);
        }
    }

    #[test]
    fn a_wall_is_seen_and_hides_what_is_behind_it() {
        let wall: Vec<_> = (-20..=20).map(|y| (5, y)).collect();
        let seen = seen(20, &wall);
        assert!(seen.contains(&(5, 0)) && seen.contains(&(5, 3)) && seen.contains(&(4, 0)) && seen.contains(&(-15, 2)));
        assert!(seen.iter().all(|&(x, _)| x <= 5));
    }
}
