//! Paths keep their distance from obstacles where there is room, and go through gaps where there is no other way.

use super::config::PlanningConfig;
use super::plan::ViewPlan;
use super::random::Random;
use super::test_worlds::{at, ground_of, map_of, plan_with};
use crate::information_map::{CellIndex, CellState, InformationMap, Obstruction, cells_touched_by_segment};

/// Forty by forty cells of ground with a wall over `columns` of the row at y = 6 m.
fn walled(columns: impl Fn(usize) -> bool) -> InformationMap {
    let row = |y: usize| (0..40).map(|x| if y == 20 && columns(x) { '#' } else { '.' }).collect();
    map_of(&(0..40).map(row).collect::<Vec<String>>(), 0.3)
}

/// The least distance of the path's cells from a wall's [m], without the robot's own surroundings.
fn least_distance(plan: &ViewPlan, map: &InformationMap, robot: [f64; 2]) -> f64 {
    let is_wall = |cell| matches!(map.state(cell), CellState::Known(c) if c < 0.5);
    let walls: Vec<CellIndex> =
        (0..1600).map(|k| CellIndex { x: k % 40, y: k / 40 }).filter(|cell| is_wall(*cell)).collect();
    let mut least = f64::INFINITY;
    for piece in plan.path.windows(2) {
        cells_touched_by_segment(
            [piece[0][0] / 0.3, piece[0][1] / 0.3],
            [piece[1][0] / 0.3, piece[1][1] / 0.3],
            |cell| {
                let [x, y] = map.centre_of(cell);
                if (x - robot[0]).hypot(y - robot[1]) > 1.5 {
                    let to = |wall: &CellIndex| 0.3 * f64::from(cell.x - wall.x).hypot(f64::from(cell.y - wall.y));
                    least = walls.iter().map(to).fold(least, f64::min);
                }
                true
            },
        );
    }
    least
}

/// Of many random choices the first path that leads well behind the wall.
fn way_across(map: &InformationMap, clearance_m: f64) -> ViewPlan {
    let config = PlanningConfig { clearance_m, ..PlanningConfig::default() };
    let plans = (0..64).map(|run_seed| {
        plan_with(&mut Random::default(), map, &super::Situation { run_seed, ..at(6.0, 2.0) }, &config)
    });
    let mut across = plans.filter(|plan| plan.path.last().is_some_and(|[_, y, _]| *y > 7.5));
    across.next().expect("some candidate lies across the wall")
}

#[test]
fn a_path_around_the_end_of_a_wall_swings_out_where_there_is_room() {
    let map = walled(|x| (14..26).contains(&x));
    let [near, far] = [0.0, 0.95].map(|clearance_m| least_distance(&way_across(&map, clearance_m), &map, [6.0, 2.0]));
    assert!((0.5..0.95).contains(&near), "without clearance it cuts the corner: {near} m");
    assert!(far > 0.95, "with it it does not: {far} m");
}

#[test]
fn a_gap_narrower_than_the_clearance_is_driven_through_where_there_is_no_other_way() {
    let map = walled(|x| !(18..=22).contains(&x));
    let plan = way_across(&map, 0.95);
    let least = least_distance(&plan, &map, [6.0, 2.0]);
    assert!((0.5..0.95).contains(&least), "{least} m");
}

#[test]
fn what_held_the_robot_is_kept_away_from_and_closes_a_gap() {
    let mut map = walled(|x| !(18..=22).contains(&x));
    assert!(way_across(&map, 0.95).path.len() > 1);
    assert!(map.obstruct(Obstruction { centre: [6.0, 6.0], radius_m: 0.3 }));
    assert!(!map.obstruct(Obstruction { centre: [6.0, 6.0], radius_m: 0.3 }), "it is known already");
    assert!(!map.obstruct(Obstruction { centre: [f64::NAN, 6.0], radius_m: 0.3 }));
    let plans = (0..64).map(|run_seed| {
        let situation = super::Situation { run_seed, ..at(6.0, 2.0) };
        plan_with(&mut Random::default(), &map, &situation, &PlanningConfig::default())
    });
    assert!(plans.flat_map(|plan| plan.candidates).all(|candidate| candidate.position[1] < 6.0));
}

#[test]
fn a_robot_shut_in_by_what_held_it_reaches_nothing_until_that_is_forgotten() {
    let mut map = walled(|_| false);
    for k in 0..40 {
        let angle = std::f64::consts::TAU * f64::from(k) / 40.0;
        map.obstruct(Obstruction { centre: [6.0 + 2.5 * angle.cos(), 6.0 + 2.5 * angle.sin()], radius_m: 0.3 });
    }
    let plan = |map: &InformationMap| plan_with(&mut Random::default(), map, &at(6.0, 6.0), &PlanningConfig::default());
    let shut_in = plan(&map);
    assert!(shut_in.candidates.is_empty(), "{:?}", shut_in.decision);
    let revision = map.revision();
    assert!(map.forget_obstructions() && map.revision() > revision && !map.forget_obstructions());
    assert!(!plan(&map).candidates.is_empty());
}

#[test]
fn a_way_that_was_driven_stays_open_whatever_is_seen_beside_it() {
    // A gap too narrow for the footprint, through which it has come all the same.
    let mut map = walled(|x| x != 20);
    let behind = |map: &InformationMap| {
        let plans = (0..64).map(|run_seed| {
            let situation = super::Situation { run_seed, ..at(6.15, 2.0) };
            plan_with(&mut Random::default(), map, &situation, &PlanningConfig::default())
        });
        plans.flat_map(|plan| plan.candidates).filter(|candidate| candidate.position[1] > 7.0).count()
    };
    assert_eq!(behind(&map), 0);
    map.drove(&[[6.15, 2.0], [6.15, 9.0]]);
    assert!(behind(&map) > 0);
}

#[test]
fn one_cell_that_is_taken_for_an_obstacle_does_not_shut_a_way_that_was_driven_and_three_do() {
    let behind = |gap: std::ops::RangeInclusive<usize>| {
        // A wall with a gap that the robot has come through; in the gap now an obstacle, as wide as is asked for.
        let mut map = walled(|x| !(19..=21).contains(&x) || gap.contains(&x));
        map.drove(&[[6.15, 2.0], [6.15, 9.0]]);
        let plans = (0..64).map(|run_seed| {
            let situation = super::Situation { run_seed, ..at(6.15, 2.0) };
            plan_with(&mut Random::default(), &map, &situation, &PlanningConfig::default())
        });
        plans.flat_map(|plan| plan.candidates).filter(|candidate| candidate.position[1] > 7.0).count()
    };
    assert!(behind(20..=20) > 0);
    assert_eq!(behind(19..=21), 0);
}

#[test]
fn a_way_that_was_driven_from_far_away_ends_where_the_window_does() {
    let mut map = walled(|x| x != 20);
    let config = PlanningConfig { near_m: 10.0, ..PlanningConfig::default() };
    let reach = config.near_m + config.scanner.range_m;
    for [dx, dy] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]] {
        map.drove(&[[6.15, 2.0], [6.15 + 3.0 * reach * dx, 2.0 + 3.0 * reach * dy]]);
    }
    let plan = plan_with(&mut Random::default(), &map, &at(6.15, 2.0), &config);
    assert!(plan.reachable_cells > 0);
}

#[test]
fn a_robot_beside_ground_that_was_never_measured_goes_back_before_it_turns() {
    // Ground that ends at y = 6 m, and nothing seen behind it.
    let mut map = map_of(&vec![".".repeat(60); 20], 0.3);
    let second_waypoint = |map: &InformationMap, robot: [f64; 2], turn_clearance_m: f64| {
        let config = PlanningConfig { turn_clearance_m, ..PlanningConfig::default() };
        let plan = plan_with(&mut Random::default(), map, &at(robot[0], robot[1]), &config);
        assert!(plan.path.len() > 1, "{:?}", plan.decision);
        [plan.path[1][0], plan.path[1][1]]
    };
    let went_back = |[x, y]: [f64; 2]| (x - 9.0).abs() < 0.3 && (2.5..4.5).contains(&y);
    assert!(!went_back(second_waypoint(&map, [9.0, 5.0], 1.5)), "it has come from nowhere");
    map.drove(&[[9.0, 1.0], [9.0, 5.0]]);
    assert!(went_back(second_waypoint(&map, [9.0, 5.0], 1.5)), "{:?}", second_waypoint(&map, [9.0, 5.0], 1.5));
    assert!(!went_back(second_waypoint(&map, [9.0, 5.0], 0.0)));
    assert!(!went_back(second_waypoint(&map, [9.0, 3.0], 1.5)), "where it can turn it turns");
}

#[test]
fn a_robot_on_a_slope_above_a_drop_goes_back_before_it_turns() {
    // Ground that falls along y, and by a metre more at y = 6 m.
    let went_back = |slope_deg: f32, drop_m: f32| {
        let slope = slope_deg.to_radians().tan();
        let mut map = ground_of(60, 40, |_, y| -slope * y - if y > 6.0 { drop_m } else { 0.0 });
        map.drove(&[[9.0, 1.0], [9.0, 4.9]]);
        let plan = plan_with(&mut Random::default(), &map, &at(9.0, 4.9), &PlanningConfig::default());
        assert!(plan.path.len() > 1, "{:?}", plan.decision);
        let [x, y, _] = plan.path[1];
        (x - 9.0).abs() < 0.3 && (2.4..4.3).contains(&y)
    };
    assert!(went_back(12.0, 1.0));
    assert!(!went_back(4.0, 1.0), "on a gentle slope its wheels hold");
    assert!(!went_back(12.0, 0.0), "there is no drop");
    assert!(!went_back(-12.0, 1.0), "the drop is up the slope");
}
