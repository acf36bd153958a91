use super::super::test_world::*;
use super::*;
use crate::analysis::PointScore;
use crate::scan::Point;

fn reach(x: f64, y: f64, z: f64) -> Reach {
    Reach { robot: Point3::new(x, y, z), window_m: 40.0, start_m: 1.0, max_step_m: 0.4, navigable_threshold: 0.7 }
}

/// A road along y through a dam along x, which a deck crosses 3 m over it, with a ramp at its left end.
fn bridge(with_ramp: bool) -> InformationMap {
    let mut points: Vec<(Point, PointScore)> = sheet((-5, 5), (-30, 30), |_, _| 0.0, ground());
    points.extend(sheet((-30, 30), (-3, 3), |_, _| 3.0, ground()));
    if with_ramp {
        // From the deck's left end down to the ground, and back to the road in the open.
        points.extend(sheet((-60, -31), (-3, 3), |x, _| 3.0 + 0.1 * (x + 30) as f32, ground()));
        points.extend(sheet((-60, -31), (-10, -4), |_, _| 0.0, ground()));
        points.extend(sheet((-64, -61), (-10, 3), |_, _| 0.0, ground()));
        points.extend(sheet((-30, -6), (-10, -4), |_, _| 0.0, ground()));
    }
    map_of(&points)
}

fn cell(x: i32, y: i32) -> CellIndex {
    CellIndex { x, y }
}

#[test]
fn from_the_road_the_way_leads_under_the_deck_and_from_the_deck_over_the_road() {
    let map = bridge(false);
    let below = map.choose_levels(&reach(0.0, -6.0, 0.0));
    for y in -30..=30 {
        assert_eq!((below.of(cell(0, y)), below.is_reached(cell(0, y))), (0, true), "{y}");
    }
    assert!(!below.is_reached(cell(20, 0)), "the deck beside the road is out of reach");
    let above = map.choose_levels(&reach(6.0, 0.0, 3.0));
    for x in -30..=30_i32 {
        let crosses = x.abs() <= 5;
        assert_eq!((above.of(cell(x, 0)), above.is_reached(cell(x, 0))), (usize::from(crosses), true), "{x}");
    }
    assert!(!above.is_reached(cell(0, 20)));
}

#[test]
fn a_ramp_leads_from_level_to_level_and_the_nearer_one_is_chosen() {
    let map = bridge(true);
    let choice = map.choose_levels(&reach(0.0, -6.0, 0.0));
    assert!(choice.is_reached(cell(20, 0)) && choice.is_reached(cell(-45, 0)));
    assert_eq!(choice.of(cell(0, 0)), 0);
}

#[test]
fn a_parapet_is_an_obstacle_of_the_deck_and_not_of_the_road() {
    let mut points = sheet((-5, 5), (-30, 30), |_, _| 0.0, ground());
    points.extend(sheet((-30, 30), (-3, 3), |_, _| 3.0, ground()));
    for z in [3.2, 3.6, 3.9] {
        points.extend(sheet((-30, 30), (4, 4), |_, _| z, wall()));
    }
    let map = map_of(&points);
    let state = |choice: &LevelChoice, index: CellIndex| {
        let levels = map.cell(index).unwrap().levels(1.2);
        choice.pick(index, &levels).unwrap().state(3.0)
    };
    let above = map.choose_levels(&reach(6.0, 0.0, 3.0));
    assert!(matches!(state(&above, cell(0, 4)), CellState::Known(c) if c < 0.1));
    let below = map.choose_levels(&reach(0.0, -6.0, 0.0));
    assert!(matches!(state(&below, cell(0, 4)), CellState::Known(c) if c > 0.9));
    assert!(below.is_reached(cell(0, 20)));
}

#[test]
fn a_robot_that_is_nowhere_reaches_nothing() {
    let map = bridge(false);
    for robot in [[f64::NAN, 0.0, 0.0], [1e12, 0.0, 0.0], [500.0, 500.0, 0.0]] {
        let choice = map.choose_levels(&reach(robot[0], robot[1], robot[2]));
        assert_eq!((choice.of(cell(0, 0)), choice.is_reached(cell(0, 0))), (0, false));
    }
    assert_eq!(empty_map().choose_levels(&reach(0.0, 0.0, 0.0)), LevelChoice::default());
}
