//! Where a robot may be, cell by cell and by definition, to hold the plans of every strategy against.

use super::*;
use crate::information_map::{CellIndex, CellState, InformationMap, cells_touched_by_segment};

/// Height of the ground of a cell that can be driven on.
fn ground(map: &InformationMap, cell: CellIndex, config: &PlanningConfig) -> Option<f64> {
    let is_proven = matches!(map.state(cell), CellState::Known(c) if c > config.navigable_threshold);
    is_proven.then(|| map.lowest_level(cell).unwrap().ground())
}

/// Whether the ground of two neighbouring cells, both of which can be driven on, differs by more than the robot masters.
fn is_step(map: &InformationMap, a: CellIndex, b: CellIndex, config: &PlanningConfig) -> bool {
    let limit = config.max_step_m + distance(a, b) * config.max_slope_deg.to_radians().tan();
    let grounds = ground(map, a, config).zip(ground(map, b, config));
    grounds.is_some_and(|(a, b)| (a - b).abs() > limit)
}

fn around(cell: CellIndex) -> impl Iterator<Item = CellIndex> {
    (-1..=1).flat_map(move |x| (-1..=1).map(move |y| CellIndex { x: cell.x + x, y: cell.y + y }))
}

/// Height of the ground of a cell, whether or not it can be driven on.
fn any_ground(map: &InformationMap, cell: CellIndex, config: &PlanningConfig) -> Option<f64> {
    let level = map.lowest_level(cell).filter(|level| level.evidence.has_ground());
    ground(map, cell, config).or(level.map(|level| level.ground()))
}

/// How far two cells are apart [m].
fn distance(a: CellIndex, b: CellIndex) -> f64 {
    0.3 * f64::from((a.x - b.x).pow(2) + (a.y - b.y).pow(2)).sqrt()
}

/// Whether the ground of a neighbour of a cell that can be driven on lies lower by more than the robot masters.
fn stands_over_a_step(map: &InformationMap, cell: CellIndex, config: &PlanningConfig) -> bool {
    let Some(here) = ground(map, cell, config) else { return false };
    let slope = config.max_slope_deg.to_radians().tan();
    let is_far_below = |next: CellIndex| {
        let limit = config.max_step_m + distance(cell, next) * slope;
        any_ground(map, next, config).is_some_and(|there| here - there > limit)
    };
    around(cell).any(is_far_below)
}

/// Whether the ground on both sides of a cell differs by more than the steepest slope and half a step, or it is the upper side
/// of a ledge.
fn is_steep(map: &InformationMap, cell: CellIndex, config: &PlanningConfig) -> bool {
    let slope = config.max_slope_deg.to_radians().tan();
    let differs = |side: CellIndex| {
        let (dx, dy) = (side.x - cell.x, side.y - cell.y);
        let at = |k: i32| any_ground(map, CellIndex { x: cell.x + k * dx, y: cell.y + k * dy }, config);
        let between = |a: i32, b: i32| at(a).zip(at(b)).map(|(a, b)| b - a);
        let limit = 0.5 * config.max_step_m + 2.0 * distance(side, cell) * slope;
        // The height of the ledge around the cell k steps on, and whether that cell is above it.
        let ledge = |k: i32| {
            let (rise, outside) = (between(k - 1, k + 1)?, between(k - 2, k + 2)?);
            let is_ledge = 2.0 * rise - outside > config.max_step_m && rise > 0.5 * config.max_step_m;
            Some((is_ledge, between(k - 1, k)? >= 0.5 * rise))
        };
        between(-1, 1).is_some_and(|rise| rise.abs() > limit)
            || ledge(0).is_some_and(|(is_ledge, is_above)| is_ledge && is_above)
            || ledge(-1).is_some_and(|(is_ledge, is_above)| is_ledge && !is_above)
    };
    any_ground(map, cell, config).is_some() && around(cell).any(differs)
}

/// Whether ground of which nothing was ever seen lies too near: beside ground, and of a disc of it as wide as gaps may be.
fn is_near_hidden_ground(map: &InformationMap, cell: CellIndex, start: CellIndex, config: &PlanningConfig) -> bool {
    let gap_m = 0.5 * config.hidden_width_m;
    let is_seen =
        |at: CellIndex| map.state(at) != CellState::Unknown || distance(at, start) <= config.start_clearance_m;
    let stands = |at| matches!(map.state(at), CellState::Known(c) if c < config.sight_threshold);
    let within = |middle: CellIndex, radius_m: f64| {
        let reach = (radius_m / 0.3).floor() as i32;
        let square = (-reach..=reach).flat_map(move |x| (-reach..=reach).map(move |y| (middle.x + x, middle.y + y)));
        square.map(|(x, y)| CellIndex { x, y }).filter(move |&at| distance(at, middle) <= radius_m)
    };
    let is_wide = |at| within(at, gap_m).any(|middle| !within(middle, gap_m).any(is_seen));
    let is_hidden =
        |at: CellIndex| !is_seen(at) && is_wide(at) && around(at).any(|near| is_seen(near) && !stands(near));
    within(cell, config.hidden_clearance_m).any(is_hidden)
}

/// Whether the robot has driven over the cell, or beside it where neither a step nor steep ground is.
fn is_driven(map: &InformationMap, cell: CellIndex, config: &PlanningConfig) -> bool {
    let over = |[from, to]: &[[f64; 2]; 2], cell: CellIndex| {
        let cells = [from, to].map(|end| end.map(|metres| metres / 0.3));
        !cells_touched_by_segment(cells[0], cells[1], |touched| touched != cell)
    };
    let beside = |piece: &[[f64; 2]; 2]| {
        let sides = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(dx, dy)| CellIndex { x: cell.x + dx, y: cell.y + dy });
        sides.into_iter().any(|side| over(piece, side))
    };
    let is_even = || !is_steep(map, cell, config) && !stands_over_a_step(map, cell, config);
    map.driven().iter().any(|piece| over(piece, cell)) || (map.driven().iter().any(beside) && is_even())
}

/// Whether a robot from `situation` may be in this cell: proven ground clear of obstacles, steep ground and steps, or its
/// own surroundings.
fn may_be_in(map: &InformationMap, cell: CellIndex, situation: &Situation, config: &PlanningConfig) -> bool {
    let is_obstacle = |cell| matches!(map.state(cell), CellState::Known(c) if c < config.sight_threshold);
    let robot = situation.map_from_robot.translation.vector;
    let start = map.cell_containing(robot.x, robot.y).unwrap();
    if cell == start || (distance(cell, start) <= config.start_clearance_m && !is_obstacle(cell)) {
        return true;
    }
    let is_proven = |cell| matches!(map.state(cell), CellState::Known(c) if c > config.navigable_threshold);
    let may_be_under = |near| match config.footprint {
        FootprintRule::Clear => !is_obstacle(near) && !is_steep(map, near, config),
        FootprintRule::Verified => is_proven(near) && !is_steep(map, near, config),
    };
    if is_driven(map, cell, config) && !is_obstacle(cell) && config.is_in_work_area(map.centre_of(cell)) {
        return true;
    }
    if is_near_hidden_ground(map, cell, start, config) {
        return false;
    }
    let may_be_near = |near| {
        (distance(near, cell) > config.footprint_radius_m || may_be_under(near))
            && (distance(near, cell) > config.step_clearance_m || !stands_over_a_step(map, near, config))
    };
    let mut around = (-4..=4).flat_map(|x| (-4..=4).map(move |y| CellIndex { x: cell.x + x, y: cell.y + y }));
    is_proven(cell) && around.all(may_be_near) && config.is_in_work_area(map.centre_of(cell))
}

pub(super) fn check_plan(plan: &ViewPlan, map: &InformationMap, situation: &Situation, config: &PlanningConfig) {
    for candidate in &plan.candidates {
        let [x, y, _] = candidate.position;
        assert!(may_be_in(map, map.cell_containing(x, y).unwrap(), situation, config), "candidate {candidate:?}");
        assert!(candidate.cost > 0.0 && candidate.utility.is_finite());
        for value in [candidate.information, candidate.quality, candidate.zones] {
            assert!((0.0..=1.0).contains(&value), "{candidate:?}");
        }
    }
    match plan.chosen() {
        Some(chosen) => {
            assert_eq!(plan.path.last(), Some(&chosen.position));
            let robot = situation.map_from_robot.translation.vector;
            let first = plan.path.first().unwrap();
            assert!((first[0] - robot.x).abs() <= 0.1501 && (first[1] - robot.y).abs() <= 0.1501);
        }
        None => assert!(plan.path.is_empty()),
    }
    for piece in plan.path.windows(2) {
        let ends = [piece[0], piece[1]].map(|[x, y, _]| [x / 0.3, y / 0.3]);
        let clear = cells_touched_by_segment(ends[0], ends[1], |cell| may_be_in(map, cell, situation, config));
        assert!(clear, "{piece:?} leaves the ground that can be driven on");
        let mut touched = Vec::new();
        cells_touched_by_segment(ends[0], ends[1], |cell| {
            touched.push(cell);
            true
        });
        for &cell in &touched {
            let steps = around(cell).filter(|next| touched.contains(next) && is_step(map, cell, *next, config));
            assert_eq!(steps.count(), 0, "{piece:?} crosses a step at {cell:?}");
        }
    }
}
