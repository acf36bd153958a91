//! Where the robot can turn towards its next view. On a slope, wheels that turn on the spot slide down it; beside ground that may
//! fall away the robot so goes back the way it has come before it turns.

use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use crate::information_map::InformationMap;

/// How far it goes back at least and at most [m].
const BACK_M: [f64; 2] = [0.8, 2.5];
/// Pieces of the way that lie so far apart do not belong to one drive [m].
const GAP_M: f64 = 0.6;
/// The way is looked at this finely [m].
const STEP_M: f64 = 0.1;

/// The nearest cell back along the way driven last at which the robot can turn; `None` where it can turn as it stands, and where it
/// has come from nowhere or finds no such place.
pub(super) fn place_to_turn(
    grid: &PlanningGrid,
    map: &InformationMap,
    robot: [f64; 2],
    config: &PlanningConfig,
) -> Option<usize> {
    let here = grid.at(map.cell_containing(robot[0], robot[1])?)?;
    if config.turn_clearance_m <= 0.0 || !grid.has(&grid.precarious, here) {
        return None;
    }
    let (mut at, mut gone) = (robot, 0.0);
    for &[from, to] in map.driven().iter().rev() {
        if distance(at, to) > GAP_M {
            break;
        }
        let length = distance(to, from);
        for step in 0..=(length / STEP_M) as usize {
            let share = (STEP_M * step as f64 / length.max(STEP_M)).min(1.0);
            let place = [0, 1].map(|axis| to[axis] + share * (from[axis] - to[axis]));
            let back_m = gone + distance(at, to) + share * length;
            if back_m > BACK_M[1] {
                return None;
            }
            let cell = grid.at(map.cell_containing(place[0], place[1])?)?;
            let is_free = grid.has(&grid.driven, cell) && !grid.has(&grid.precarious, cell);
            if back_m >= BACK_M[0] && is_free {
                return Some(cell);
            }
        }
        gone += distance(at, to) + length;
        at = from;
    }
    None
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
