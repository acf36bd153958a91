//! Where the ground steps or is too steep for the robot, by the heights of neighbouring cells.
//!
//! Over a step a cell that can be driven on stands higher than ground beside it that the robot cannot get down to, as at the
//! edge of a deck or of a bank; whether that ground could be driven on does not matter to who falls onto it. The robot keeps
//! clear of such cells, and so of any two neighbours that it may enter the ground differs by no more than it masters.
//!
//! No single pair of cells tells a kerb from a slope. Slopes are judged over two cells, ledges such as kerbs over five: by how
//! much more the ground rises over the middle two of four intervals than over the outer two. That is nothing on a slope,
//! however it bends (a third difference), and the height of the ledge whether it lies between cells or within one.

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
    /// By more than this a ledge stands over the slope that it lies in.
    pub ledge: f32,
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
            ledge: config.max_step_m as f32,
            slope: slope as f32,
            step: config.max_step_m as f32,
        }
    }

    /// The largest difference between ends of the ground of two neighbouring cells, for the choice of levels.
    pub fn between_levels(config: &PlanningConfig, cell_m: f64) -> f64 {
        config.max_step_m + 2.0 * std::f64::consts::SQRT_2 * cell_m * config.max_slope_deg.to_radians().tan()
    }
}

/// Cells around a tile that belong to its patch.
const RIM: usize = 3;
/// Cells of a patch along a side.
const PATCH: usize = SIDE + 2 * RIM;

/// Heights of the ground of a tile and of the cells around it [m, map frame], NaN where none is known; rows of constant y.
#[derive(Debug, Clone)]
pub(super) struct Patch([[f32; PATCH]; PATCH]);

impl Patch {
    /// The ground around the tile over a group of sixteen columns and sixteen rows.
    pub fn of(grid: &PlanningGrid, group: usize, tile_row: usize) -> Self {
        let mut heights = [[f32::NAN; PATCH]; PATCH];
        // Where a patch's cells lie in the tile before, this one, and the next: from, to, and the first of the tile's.
        let spans = [(0, RIM, SIDE - RIM), (RIM, RIM + SIDE, 0), (RIM + SIDE, PATCH, 0)];
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
        let (beside, diagonal) = (limits.beside, limits.diagonal);
        self.rows(|line, found| {
            for (dx, dy) in AROUND {
                let limit = if dx == 0 || dy == 0 { beside } else { diagonal };
                let (here, there) = (line.at(0, 0), line.at(dx, dy));
                for x in 0..SIDE {
                    found[x] |= u32::from(here[x] - there[x] > limit);
                }
            }
        })
    }

    /// The cells with ground on both sides that differs by more than the steepest slope, and the upper ones at ledges, by rows.
    pub fn steep(&self, limits: &ReliefLimits) -> [u16; SIDE] {
        self.rows(|line, found| {
            for (dx, dy) in AROUND {
                let limit = if dx == 0 || dy == 0 { limits.over_beside } else { limits.over_diagonal };
                line.add_ledges([dx, dy], limits.ledge, limit, found);
            }
            let here = line.at(0, 0);
            for x in 0..SIDE {
                found[x] &= u32::from(!here[x].is_nan());
            }
        })
    }

    /// One bit for every cell of the tile that `find` marks, row by row.
    #[inline(always)]
    fn rows(&self, find: impl Fn(Row<'_>, &mut [u32; SIDE])) -> [u16; SIDE] {
        std::array::from_fn(|y| {
            let mut found = [0; SIDE];
            find(Row { patch: self, y }, &mut found);
            found.iter().enumerate().fold(0, |bits, (x, found)| bits | (*found as u16) << x)
        })
    }
}

/// The ways to a cell's neighbours.
const AROUND: [(isize, isize); 8] = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)];

/// A row of the tile.
#[derive(Clone, Copy)]
struct Row<'a> {
    patch: &'a Patch,
    y: usize,
}

impl Row<'_> {
    /// The heights so many cells from those of the row along x and y, at most three.
    #[inline(always)]
    fn at(&self, dx: isize, dy: isize) -> [f32; SIDE] {
        let row = &self.patch.0[(self.y + RIM).wrapping_add_signed(dy)];
        let first = RIM.wrapping_add_signed(dx);
        std::array::from_fn(|x| row[first + x])
    }

    /// Marks the cells from whose one neighbour to the opposite one, this way, the ground rises by more than `limit`, and those
    /// on the upper side of a ledge that is climbed this way.
    #[inline(always)]
    fn add_ledges(&self, [dx, dy]: [isize; 2], ledge: f32, limit: f32, found: &mut [u32; SIDE]) {
        let [far, before, near, here, behind, end] = [-3, -2, -1, 0, 1, 2].map(|k| self.at(k * dx, k * dy));
        for x in 0..SIDE {
            // Around the cell: it is above the ledge. Around the one before it: the ledge begins behind that.
            let (rise, outside) = (behind[x] - near[x], end[x] - before[x]);
            let is_above = (2.0 * rise - outside > ledge) & (rise > 0.5 * ledge) & (here[x] - near[x] >= 0.5 * rise);
            let (rise_before, outside_before) = (here[x] - before[x], behind[x] - far[x]);
            let begins = (2.0 * rise_before - outside_before > ledge)
                & (rise_before > 0.5 * ledge)
                & (near[x] - before[x] < 0.5 * rise_before);
            found[x] |= u32::from((rise > limit) | is_above | begins);
        }
    }
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
    fn a_step_of_a_decimetre_and_the_steepest_slope_are_mastered_and_half_a_metre_is_not() {
        let slope = 20f32.to_radians().tan();
        assert!(limits().beside > 0.1 + 0.29 * slope && limits().diagonal > 0.1 + 0.42 * slope);
        assert!(limits().diagonal < 0.3, "{:?}", limits());
    }

    #[test]
    fn a_slope_is_too_steep_whichever_way_it_falls_and_a_kerb_on_level_ground_is_not() {
        for heading in (0..360).step_by(15) {
            let (sin, cos) = (heading as f32).to_radians().sin_cos();
            let slope = |deg: f32| patch(move |x, y| (x * cos + y * sin) * deg.to_radians().tan());
            assert_eq!(slope(20.0).steep(&limits()), [0; SIDE], "{heading}");
            assert_eq!(slope(31.0).steep(&limits()), [u16::MAX; SIDE], "{heading}");
            let bend = patch(|x, y| 0.04 * ((x - 3.0) * cos + (y - 3.0) * sin).powi(2));
            assert_eq!(bend.steep(&limits()), [0; SIDE], "{heading}");
        }
    }

    #[test]
    fn a_kerb_is_a_ledge_wherever_it_lies_between_the_cells_and_a_low_one_is_none() {
        for shift in (0..10).map(|k| 0.03 * k as f32) {
            // The mean height of a cell through which the kerb's edge runs, on a slope of 10 degrees.
            let kerb = |height: f32, is_bar: bool| {
                let share = move |x: f32, edge: f32| ((x + 0.15 - edge) / 0.3).clamp(0.0, 1.0);
                patch(move |x, _| {
                    let bar = if is_bar { share(x, 2.7 + shift) } else { 0.0 };
                    height * (share(x, 2.4 + shift) - bar) + 0.176 * x
                })
            };
            for is_bar in [false, true] {
                // The mean heights of the two cells that a bar lies in show less of it.
                let ledge = kerb(if is_bar { 0.14 } else { 0.12 }, is_bar).steep(&limits());
                assert!(ledge.iter().all(|row| *row != 0), "{shift} {is_bar} {ledge:?}");
                // A bar as narrow as a cell counts double where the ground falls on both sides of it.
                let low = if is_bar { 0.04 } else { 0.08 };
                assert_eq!(kerb(low, is_bar).steep(&limits()), [0; SIDE], "{shift}");
                assert_eq!(kerb(0.12, is_bar).over_steps(&limits()), [0; SIDE], "{shift}");
            }
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
        // The last cell of the deck is the fifth of the tile.
        assert_eq!(edge(0.5, true).over_steps(&limits()), [1 << 4; SIDE]);
        assert_eq!(edge(0.5, false).over_steps(&limits()), [0; SIDE]);
        assert_eq!(edge(0.5, true).steep(&limits()), [0b11_0000; SIDE]);
        assert_eq!(edge(0.5, false).steep(&limits()), [0; SIDE]);
    }
}
