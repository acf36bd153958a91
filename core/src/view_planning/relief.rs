//! Where the ground steps or is too steep for the robot, by the heights of neighbouring cells.
//!
//! Over a step a cell that can be driven on stands higher than ground beside it that the robot cannot get down to, as at the
//! edge of a deck or of a bank; whether that ground could be driven on does not matter to who falls onto it. The robot keeps
//! clear of such cells, and so of any two neighbours that it may enter the ground differs by no more than it masters. A kerb
//! is as high as that at most; a bank that rises as much again in the next cell is a slope, which no single pair of cells
//! tells from a kerb: that is judged over two cells.

use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use super::tile_digest::SIDE;

/// The largest differences in height of the ground that the robot masters [m]: a step, and as much as the steepest slope
/// rises between the middles of the cells.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct ReliefLimits {
    /// Between cells that share a side.
    pub beside: f32,
    /// Between cells that share a corner; also within a cell.
    pub diagonal: f32,
    /// Between the neighbours on both sides of a cell, along a line of cells and along a diagonal: a kerb passes, a slope
    /// that is too steep does not.
    pub over_beside: f32,
    pub over_diagonal: f32,
    /// The steepest slope.
    pub slope: f32,
    /// The step.
    pub step: f32,
}

/// Of the step, so much is left for kerbs and rough ground where slopes are judged.
const STEP_SHARE: f64 = 0.5;

impl ReliefLimits {
    pub fn new(config: &PlanningConfig, cell_m: f64) -> Self {
        let slope = config.max_slope_deg.to_radians().tan();
        let limit = |distance_m: f64, step_m: f64| (step_m + distance_m * slope) as f32;
        let diagonal_m = cell_m * std::f64::consts::SQRT_2;
        let part = STEP_SHARE * config.max_step_m;
        Self {
            beside: limit(cell_m, config.max_step_m),
            diagonal: limit(diagonal_m, config.max_step_m),
            over_beside: limit(2.0 * cell_m, part),
            over_diagonal: limit(2.0 * diagonal_m, part),
            slope: slope as f32,
            step: config.max_step_m as f32,
        }
    }

    /// The largest difference between ends of the ground of two neighbouring cells, for the choice of levels.
    pub fn between_levels(config: &PlanningConfig, cell_m: f64) -> f64 {
        config.max_step_m + 2.0 * std::f64::consts::SQRT_2 * cell_m * config.max_slope_deg.to_radians().tan()
    }
}

/// Cells of a patch along a side: a tile, and one cell around it.
const PATCH: usize = SIDE + 2;

/// Heights of the ground of a tile and of the cells around it [m, map frame], NaN where none is known; rows of constant y.
#[derive(Debug, Clone)]
pub(super) struct Patch([[f32; PATCH]; PATCH]);

impl Patch {
    /// The ground around the tile over a group of sixteen columns and sixteen rows.
    pub fn of(grid: &PlanningGrid, group: usize, tile_row: usize) -> Self {
        let mut heights = [[f32::NAN; PATCH]; PATCH];
        // Where a patch's cells lie in the tile before, this one, and the next: from, to, and the first of the tile's.
        let spans = [(0, 1, SIDE - 1), (1, PATCH - 1, 0), (PATCH - 1, PATCH, 0)];
        for (dy, &(top, bottom, first_row)) in spans.iter().enumerate() {
            for (dx, &(left, right, first)) in spans.iter().enumerate() {
                let place = (group + dx).checked_sub(1).zip((tile_row + dy).checked_sub(1));
                let Some(digest) = place.and_then(|(group, row)| grid.tile(group, row)) else { continue };
                for (row, heights) in (first_row..).zip(&mut heights[top..bottom]) {
                    let grounds = digest.cells.ground.as_chunks::<SIDE>().0[row];
                    let seen = digest.grounded[row] | digest.navigable[row];
                    for (bit, height) in (first..).zip(&mut heights[left..right]) {
                        *height = if seen >> bit & 1 == 1 { grounds[bit] } else { f32::NAN };
                    }
                }
            }
        }
        Self(heights)
    }

    /// The cells that stand over one of their neighbours by more than the robot masters, by rows.
    pub fn over_steps(&self, limits: &ReliefLimits) -> [u16; SIDE] {
        std::array::from_fn(|y| {
            let [below, row, above] = self.rows(y);
            bits(|x| {
                let over = |other: f32, limit: f32| row[x + 1] - other > limit;
                over(row[x], limits.beside)
                    | over(row[x + 2], limits.beside)
                    | over(below[x + 1], limits.beside)
                    | over(above[x + 1], limits.beside)
                    | over(below[x], limits.diagonal)
                    | over(below[x + 2], limits.diagonal)
                    | over(above[x], limits.diagonal)
                    | over(above[x + 2], limits.diagonal)
            })
        })
    }

    /// The cells with ground on both sides that differs by more than the steepest slope, by rows.
    pub fn steep(&self, limits: &ReliefLimits) -> [u16; SIDE] {
        std::array::from_fn(|y| {
            let [below, row, above] = self.rows(y);
            bits(|x| {
                let differ = |a: f32, b: f32, limit: f32| (a - b).abs() > limit;
                !row[x + 1].is_nan()
                    & (differ(row[x], row[x + 2], limits.over_beside)
                        | differ(below[x + 1], above[x + 1], limits.over_beside)
                        | differ(below[x], above[x + 2], limits.over_diagonal)
                        | differ(above[x], below[x + 2], limits.over_diagonal))
            })
        })
    }

    /// A row of the tile between those before and behind it.
    fn rows(&self, y: usize) -> [&[f32; PATCH]; 3] {
        [&self.0[y], &self.0[y + 1], &self.0[y + 2]]
    }
}

#[inline]
fn bits(is_set: impl Fn(usize) -> bool) -> u16 {
    (0..SIDE).fold(0, |bits, x| bits | u16::from(is_set(x)) << x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> ReliefLimits {
        ReliefLimits::new(&PlanningConfig::default(), 0.3)
    }

    fn patch(height: impl Fn(f32, f32) -> f32) -> Patch {
        let at = |k: usize| 0.3 * k as f32;
        Patch(std::array::from_fn(|y| std::array::from_fn(|x| height(at(x), at(y)))))
    }

    #[test]
    fn a_step_of_a_wheel_s_radius_and_the_steepest_slope_are_mastered_and_half_a_metre_is_not() {
        let slope = 20f32.to_radians().tan();
        assert!(limits().beside > 0.165 + 0.29 * slope && limits().diagonal > 0.165 + 0.42 * slope);
        assert!(limits().diagonal < 0.35, "{:?}", limits());
    }

    #[test]
    fn a_slope_is_too_steep_whichever_way_it_falls_and_a_kerb_on_level_ground_is_not() {
        for heading in (0..360).step_by(15) {
            let (sin, cos) = (heading as f32).to_radians().sin_cos();
            let slope = |deg: f32| patch(move |x, y| (x * cos + y * sin) * deg.to_radians().tan());
            assert_eq!(slope(20.0).steep(&limits()), [0; SIDE], "{heading}");
            assert_eq!(slope(31.0).steep(&limits()), [u16::MAX; SIDE], "{heading}");
            let kerb = patch(|x, y| if (x - 2.4) * cos + (y - 2.4) * sin > 0.0 { 0.15 } else { 0.0 });
            assert_eq!((kerb.steep(&limits()), kerb.over_steps(&limits())), ([0; SIDE], [0; SIDE]), "{heading}");
        }
    }

    #[test]
    fn the_upper_side_of_an_edge_is_marked_and_unknown_ground_marks_nothing() {
        let edge = |height: f32, is_known: bool| {
            patch(move |x, _| match x < 2.25 {
                true => height,
                false if is_known => 0.0,
                false => f32::NAN,
            })
        };
        // The last cell of the deck is the seventh of the tile.
        assert_eq!(edge(0.5, true).over_steps(&limits()), [1 << 6; SIDE]);
        assert_eq!(edge(0.5, false).over_steps(&limits()), [0; SIDE]);
        assert_eq!(edge(0.5, true).steep(&limits()), [0b1100_0000; SIDE]);
        assert_eq!(edge(0.5, false).steep(&limits()), [0; SIDE]);
    }
}
