use super::super::test_world::*;
use super::super::{CellIndex, CellState, InformationMap};
use super::*;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::scan::{Grid, Point, ScanView};
use proptest::prelude::*;

const HERE: CellIndex = CellIndex { x: 0, y: 0 };

fn column(parts: &[(f32, PointScore)]) -> InformationMap {
    map_of(&parts.iter().map(|(z, score)| (Point::new(0.1, 0.1, *z), *score)).collect::<Vec<_>>())
}

fn levels(map: &InformationMap) -> Levels {
    map.cell(HERE).unwrap().levels(map.config().clearance_m)
}

fn is_navigable(level: &Level) -> bool {
    matches!(level.state(3.0), CellState::Known(c) if c > 0.9)
}

#[test]
fn a_bridge_and_the_road_under_it_are_two_levels_and_neither_blocks_the_other() {
    let map = column(&[(0.0, ground()), (0.02, ground()), (3.3, ground()), (3.31, ground())]);
    let levels = levels(&map);
    let [road, deck] = levels.as_slice() else { panic!("{levels:?}") };
    assert!(is_navigable(road) && is_navigable(deck));
    assert!((road.ground() - 0.01).abs() < 3e-3 && (deck.ground() - 3.305).abs() < 3e-3);
    assert!((road.clearance - 3.29).abs() < 0.02, "{}", road.clearance);
    assert_eq!(deck.clearance, f64::INFINITY);
    assert!(!road.connects(deck, 0.5));
    assert_eq!(road.evidence.measured_count() + deck.evidence.measured_count(), 4);
}

#[test]
fn a_pier_of_the_bridge_blocks_the_road_and_not_the_deck() {
    let map = column(&[(0.0, ground()), (0.3, wall()), (0.8, wall()), (3.3, ground())]);
    let levels = levels(&map);
    let [road, deck] = levels.as_slice() else { panic!("{levels:?}") };
    assert!(matches!(road.state(3.0), CellState::Known(c) if c < 0.3));
    assert!(is_navigable(deck));
}

#[test]
fn what_hangs_over_the_robot_does_not_block_and_limits_the_clearance() {
    let map = column(&[(0.0, ground()), (1.6, crown()), (2.2, crown()), (2.4, crown())]);
    let levels = levels(&map);
    let [path] = levels.as_slice() else { panic!("{levels:?}") };
    assert!(is_navigable(path));
    assert!((path.clearance - 1.6).abs() < 0.01);
    assert_eq!(path.evidence.measured_count(), 4, "its quality still counts");
}

#[test]
fn a_branch_that_the_robot_would_hit_belongs_to_the_ground_under_it() {
    let map = column(&[(0.0, ground()), (0.8, wall())]);
    let levels = levels(&map);
    assert_eq!(levels.as_slice().len(), 1);
    assert!(!is_navigable(&levels.as_slice()[0]));
}

#[test]
fn a_high_wall_is_one_level() {
    let tall: Vec<_> = (0..40).map(|k| (0.25 * k as f32, if k < 4 { wall() } else { crown() })).collect();
    let map = column(&tall);
    let levels = levels(&map);
    assert_eq!(levels.as_slice().len(), 1);
    assert!(matches!(levels.as_slice()[0].state(3.0), CellState::Known(c) if c < 0.1));
}

#[test]
fn a_floor_over_something_that_says_nothing_is_the_lowest_level() {
    let map = column(&[(-4.0, crown()), (0.0, ground())]);
    let levels = levels(&map);
    assert_eq!(levels.as_slice().len(), 1);
    assert!(is_navigable(&levels.as_slice()[0]));
    assert!((levels.as_slice()[0].ground()).abs() < 3e-3);
}

/// The cell under a triangle between three returns on something 0.7 m high, with these points measured in it.
fn under_a_triangle(measured: &[(Point, PointScore)]) -> Level {
    let corners = [[-1.0, -1.0], [-1.0, 1.3], [1.3, -1.0], [1.3, 1.3]].map(|[x, y]| Point::new(x, y, 0.7));
    let mut scores = [ground(); 4];
    scores[0].flags |= PointScore::KEPT_WITHOUT | PointScore::KEPT_WITHOUT << 3;
    let mut map = map_of(measured);
    map.insert(ScanView::ordered(&corners, Grid { rows: 2, cols: 2 }).unwrap(), &scores, &Pose::identity()).unwrap();
    levels(&map).as_slice()[0]
}

#[test]
fn a_triangle_over_measured_ground_does_not_lift_it_and_counts_where_nothing_was_measured() {
    let level = under_a_triangle(&[(Point::new(0.1, 0.1, 0.0), ground())]);
    assert!(level.highest.abs() < 3e-3 && level.ground().abs() < 3e-3, "{level:?}");
    assert!(
        level.evidence.interpolated_count() > 0 && level.evidence.height().unwrap() > 0.1,
        "it was seen: {level:?}"
    );
    for nothing_to_drive_on in [vec![], vec![(Point::new(0.1, 0.1, 0.3), crown())]] {
        let level = under_a_triangle(&nothing_to_drive_on);
        assert!((level.ground() - 0.7).abs() < 3e-3 && (level.highest - 0.7).abs() < 3e-3, "{level:?}");
    }
}

#[test]
fn an_unknown_cell_has_no_level_and_is_not_a_cell_of_one_half() {
    let map = column(&[(0.0, ground())]);
    let unknown = CellIndex { x: 1, y: 1 };
    assert!(map.cell(unknown).unwrap().is_unknown());
    assert_eq!(map.cell(unknown).unwrap().levels(1.2).as_slice(), &[]);
    assert_eq!(map.state(unknown), CellState::Unknown);
    assert_eq!(map.state(CellIndex { x: 99, y: 0 }), CellState::Unknown);
}

#[test]
fn more_floors_than_levels_count_to_the_last() {
    let floors: Vec<_> = (0..9).map(|k| (3.0 * k as f32, ground())).collect();
    let map = column(&floors);
    let levels = levels(&map);
    assert_eq!(levels.as_slice().len(), MAX_LEVELS);
    assert_eq!(levels.as_slice()[MAX_LEVELS - 1].evidence.measured_count(), 6);
}

proptest! {
    #[test]
    fn levels_share_out_all_evidence_and_stand_a_robot_apart(
        parts in prop::collection::vec((-8.0..12.0f32, 0..3usize), 1..30),
    ) {
        let kinds = [ground(), wall(), crown()];
        let map = column(&parts.iter().map(|(z, kind)| (*z, kinds[*kind])).collect::<Vec<_>>());
        let cell = map.cell(HERE).unwrap();
        let levels = cell.levels(1.2);
        let sum: u64 = levels.as_slice().iter().map(|l| l.evidence.measured_count()).sum();
        prop_assert_eq!(sum, parts.len() as u64);
        prop_assert_eq!(cell.total().measured_count(), parts.len() as u64);
        for pair in levels.as_slice().windows(2) {
            prop_assert!(pair[1].lowest - pair[0].highest >= 1.2 - 1e-9);
            prop_assert!(pair[0].clearance <= pair[1].lowest - pair[0].highest + 1e-9);
        }
        for level in levels.as_slice() {
            prop_assert!(level.lowest <= level.highest);
        }
        match (cell.undivided(1.2), levels.as_slice()) {
            (Some(undivided), [level]) => prop_assert_eq!(undivided, *level),
            (Some(_), more) => prop_assert!(false, "{} levels of undivided evidence", more.len()),
            (None, more) => prop_assert!(more.len() > 1 || more[0].clearance < f64::INFINITY || parts.len() > 1),
        }
    }
}
