use super::super::test_world::*;
use super::*;
use crate::analysis::PointScore;
use crate::information_map::{CellState, InformationMap};
use crate::scan::Point;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

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

/// What [`LevelChoice`] says, one level at a time: from every level that is reached and can be driven on, all levels of the
/// eight cells around it.
fn by_the_book(map: &InformationMap, reach: &Reach) -> BTreeMap<CellIndex, usize> {
    let all: BTreeMap<CellIndex, Levels> = map.known_cells().map(|(index, cell)| (index, cell.levels(1.2))).collect();
    let is_passable = |level: &Level| matches!(level.state(3.0), CellState::Known(c) if c > reach.navigable_threshold);
    let is_at = |level: &Level, low: f64, high: f64| {
        level.lowest - reach.max_step_m <= high && low <= level.highest + reach.max_step_m
    };
    let (mut reached, mut first, mut queue) = (BTreeSet::new(), BTreeMap::new(), VecDeque::new());
    let mut visit = |index: CellIndex, queue: &mut VecDeque<(CellIndex, Level)>, touches: &dyn Fn(&Level) -> bool| {
        for (k, level) in all.get(&index).iter().flat_map(|levels| levels.as_slice().iter().enumerate()) {
            if touches(level) && reached.insert((index, k)) {
                first.entry(index).or_insert(k);
                if is_passable(level) {
                    queue.push_back((index, *level));
                }
            }
        }
    };
    let here = map.cell_containing(reach.robot.x, reach.robot.y).unwrap();
    for (dx, dy) in (-9..=9).flat_map(|x| (-9..=9).map(move |y| (x, y))) {
        if f64::from(dx * dx + dy * dy).sqrt() * 0.3 <= reach.start_m {
            let z = reach.robot.z;
            visit(CellIndex { x: here.x + dx, y: here.y + dy }, &mut queue, &|level| is_at(level, z, z));
        }
    }
    while let Some((index, from)) = queue.pop_front() {
        for (dx, dy) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
            let leads_to = |level: &Level| match is_passable(level) {
                true => from.connects(level, reach.max_step_m),
                false => is_at(level, from.lowest, from.highest),
            };
            visit(CellIndex { x: index.x + dx, y: index.y + dy }, &mut queue, &leads_to);
        }
    }
    first
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn exactly_the_levels_that_steps_lead_to_are_reached_and_the_first_is_chosen(
        cells in prop::collection::vec((0..36i32, 0..36i32, 0..48i32, 0..8u8), 300..1500), robot in (0.0..10.0f64, 0.0..10.0f64),
    ) {
        // Floors 3 m apart, with ramps from one to the next, clutter on them and holes in them.
        let mut points = Vec::new();
        for floor in 0..3 {
            points.extend(sheet((0, 35), (0, 35), |x, _| 3.0 * floor as f32 + 0.01 * (x % 7) as f32, ground()));
        }
        points.extend(sheet((5, 24), (10, 13), |x, _| 0.15 * (x - 4) as f32, ground()));
        let mut holes = BTreeSet::new();
        for (x, y, z, kind) in cells {
            match kind {
                0 => { holes.insert((x, y, z % 3)); }
                1 | 2 => points.extend(sheet((x, x), (y, y), |_, _| 0.2 * z as f32, wall())),
                3 => points.extend(sheet((x, x), (y, y), |_, _| 0.2 * z as f32, crown())),
                _ => points.extend(sheet((x, x), (y, y), |_, _| 0.2 * z as f32, ground())),
            }
        }
        let cell = |v: f32| (v / 0.3).floor() as i32;
        points.retain(|(p, _)| !holes.contains(&(cell(p.x), cell(p.y), (p.z / 3.0) as i32)));
        let map = map_of(&points);
        let reach = Reach { max_step_m: 0.43, ..reach(robot.0, robot.1, 0.0) };
        let (choice, expected) = (map.choose_levels(&reach), by_the_book(&map, &reach));
        for (index, _) in map.known_cells() {
            let first = expected.get(&index);
            prop_assert_eq!((choice.is_reached(index), choice.of(index)), (first.is_some(), first.copied().unwrap_or(0)));
        }
    }
}
