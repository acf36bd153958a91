//! Where the robot can turn towards its next view. On a slope, wheels that turn on the spot slide down it; beside ground that may
//! fall away, and on a slope above ground that does, the robot so goes back the way it has come before it turns.

use nalgebra::{Matrix3, Vector3};

use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use crate::information_map::InformationMap;

/// How far it goes back at least and at most [m].
const BACK_M: [f64; 2] = [0.8, 2.5];
/// Pieces of the way that lie so far apart do not belong to one drive [m].
const GAP_M: f64 = 0.6;
/// The way is looked at this finely [m].
const STEP_M: f64 = 0.1;
/// On a slope of less than this the wheels hold while the robot turns [deg].
const HOLDS_DEG: f64 = 8.0;
/// The slope at a place is that of the ground within this distance: as wide as the robot is long [m].
const SLOPE_M: f64 = 0.95;
/// What lies so far below the plane of the slope is a drop [m].
const DROP_M: f64 = 0.3;
/// So many cells with ground say what the slope is.
const LEAST_CELLS: f64 = 6.0;

/// The nearest cell back along the way driven last at which the robot can turn; `None` where it can turn as it stands, and where it
/// has come from nowhere or finds no such place.
pub(super) fn place_to_turn(
    grid: &PlanningGrid,
    map: &InformationMap,
    robot: [f64; 2],
    config: &PlanningConfig,
) -> Option<usize> {
    let here = grid.at(map.cell_containing(robot[0], robot[1])?)?;
    let place = TurningPlace { grid, clearance_m: config.turn_clearance_m };
    if config.turn_clearance_m <= 0.0 || place.is_safe(here) {
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
            let point = [0, 1].map(|axis| to[axis] + share * (from[axis] - to[axis]));
            let back_m = gone + distance(at, to) + share * length;
            if back_m > BACK_M[1] {
                return None;
            }
            let cell = grid.at(map.cell_containing(point[0], point[1])?)?;
            if back_m >= BACK_M[0] && grid.has(&grid.driven, cell) && place.is_safe(cell) {
                return Some(cell);
            }
        }
        gone += distance(at, to) + length;
        at = from;
    }
    None
}

/// What a robot that turns may slide into.
struct TurningPlace<'a> {
    grid: &'a PlanningGrid,
    clearance_m: f64,
}

impl TurningPlace<'_> {
    /// Whether a robot that turns at a cell does not slide over an edge: one beside it that was not seen, or one down the slope.
    fn is_safe(&self, at: usize) -> bool {
        !self.grid.has(&self.grid.precarious, at) && !self.slides_over_an_edge(at)
    }

    fn slides_over_an_edge(&self, at: usize) -> bool {
        let Some(ground) = self.ground(at) else { return false };
        if ground.x.hypot(ground.y) < HOLDS_DEG.to_radians().tan() {
            return false;
        }
        let [x, y] = self.grid.centre(at);
        self.cells_within(self.clearance_m, at).any(|cell| {
            let [to_x, to_y] = self.grid.centre(cell);
            let rise = (to_x - x) * ground.x + (to_y - y) * ground.y;
            rise < 0.0 && (self.is_edge(cell) || self.lies_under(cell, ground.z + rise))
        })
    }

    /// The plane through the ground around a cell with the least squares of the heights: how much it rises along x and y, and its
    /// height at the cell [m]. `None` where too little of it is known, as may be under the scanner.
    fn ground(&self, at: usize) -> Option<Vector3<f64>> {
        let [x, y] = self.grid.centre(at);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for cell in self.cells_within(SLOPE_M, at).filter(|&cell| !self.is_edge(cell)) {
            let (Some(height), [cell_x, cell_y]) = (self.grid.ground(cell), self.grid.centre(cell)) else { continue };
            let row = Vector3::new(cell_x - x, cell_y - y, 1.0);
            normal += row * row.transpose();
            right += row * f64::from(height);
        }
        if normal[(2, 2)] < LEAST_CELLS {
            return None;
        }
        Some(normal.cholesky()?.solve(&right))
    }

    /// Whether what was seen in a cell lies far below a height, as the face of a bank does.
    fn lies_under(&self, at: usize, height_m: f64) -> bool {
        let seen = self.grid.known_cell(at).map(|(digest, within)| digest.cells.height[within]);
        seen.is_some_and(|seen| f64::from(seen) < height_m - DROP_M)
    }

    fn is_edge(&self, at: usize) -> bool {
        self.grid.has(&self.grid.steps, at) || self.grid.has(&self.grid.steep, at)
    }

    fn cells_within(&self, radius_m: f64, at: usize) -> impl Iterator<Item = usize> {
        let len = self.grid.len();
        let cells = self.grid.disc(radius_m).into_iter();
        cells.filter_map(move |offset| at.checked_add_signed(offset).filter(|&cell| cell < len))
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
