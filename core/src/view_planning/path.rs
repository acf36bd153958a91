//! From a chain of cells to the few waypoints a robot needs.

use super::survey::Survey;
use crate::information_map::cells_touched_by_segment;

/// A straight piece goes over so many cells at most.
const LONGEST_PIECE: usize = 64;

/// The centres of the cells at which the way bends [m, map frame]. A piece of the way is straightened only if every cell the
/// straight piece touches can be driven on, and none lies closer to an obstacle than the cells of the way that it replaces:
/// what the way goes round to keep its distance must not be cut again.
///
/// From each bend the way goes straight to the farthest cell it can be straight to, not to the last one before the first it
/// cannot: else a step aside that is no longer needed stays, and the robot turns on the spot for it.
pub(super) fn waypoints(survey: &Survey, cells: &[usize]) -> Vec<[f64; 3]> {
    let mut kept: Vec<usize> = cells.first().copied().into_iter().collect();
    let mut anchor = 0;
    while anchor + 1 < cells.len() {
        anchor = farthest_straight(survey, cells, anchor);
        kept.push(cells[anchor]);
    }
    kept.into_iter().map(|at| survey.position(at)).collect()
}

/// The last of the cells behind the anchor that the way can go straight to; the next one at least.
fn farthest_straight(survey: &Survey, cells: &[usize], anchor: usize) -> usize {
    let reach = &cells[anchor..(anchor + LONGEST_PIECE + 1).min(cells.len())];
    let closest: Vec<u8> = reach
        .iter()
        .scan(0, |closest, &at| {
            *closest = survey.grid.closeness(at).max(*closest);
            Some(*closest)
        })
        .collect();
    let straight = (2..reach.len()).rev().find(|&k| is_clear(survey, reach[0], reach[k], closest[k]));
    anchor + straight.unwrap_or(1)
}

/// Whether every cell under the straight line between two cell centres can be driven on, and none is closer to an obstacle
/// than `closest` (see [`super::grid::PlanningGrid::closeness`]).
pub(super) fn is_clear(survey: &Survey, from: usize, to: usize, closest: u8) -> bool {
    let centre = |at: usize| {
        let index = survey.grid.index(at);
        [f64::from(index.x) + 0.5, f64::from(index.y) + 0.5]
    };
    cells_touched_by_segment(centre(from), centre(to), |cell| {
        let passes = |at| survey.terrain.is_passable(at) && survey.grid.closeness(at) <= closest;
        survey.grid.at(cell).is_some_and(passes)
    })
}
