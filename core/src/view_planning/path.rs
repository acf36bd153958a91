//! From a chain of cells to the few waypoints a robot needs.

use super::survey::Survey;
use crate::information_map::cells_touched_by_segment;

/// The centres of the cells at which the way bends [m, map frame]. A piece of the way is straightened only if every cell the
/// straight piece touches can be driven on, and none lies closer to an obstacle than the cells of the way that it replaces:
/// what the way goes round to keep its distance must not be cut again.
pub(super) fn waypoints(survey: &Survey, cells: &[usize]) -> Vec<[f64; 3]> {
    let Some(&first) = cells.first() else { return Vec::new() };
    let mut kept = vec![first];
    let mut anchor = first;
    let mut closest = survey.grid.closeness(first);
    for pair in cells.windows(2) {
        // The way from the anchor to pair[0] is straight; when it cannot go on to pair[1], it bends at pair[0].
        let next = survey.grid.closeness(pair[1]);
        if !is_clear(survey, anchor, pair[1], closest.max(next)) {
            anchor = pair[0];
            kept.push(anchor);
            closest = survey.grid.closeness(anchor);
        }
        closest = closest.max(next);
    }
    if let Some(&last) = cells.last()
        && last != anchor
    {
        kept.push(last);
    }
    kept.into_iter().map(|at| survey.position(at)).collect()
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
