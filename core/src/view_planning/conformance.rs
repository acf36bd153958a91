//! What every strategy of the registry must hold to, whatever it is after; and what the source's one holds besides.

use super::strategy::Strategy;
use super::*;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::information_map::{
    CellIndex, CellState, InformationMap, MapConfig, Zone, ZoneConfig, cells_touched_by_segment,
};
use crate::scan::{Point, ScanView};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;

/// A world drawn as text: `.` ground, `#` wall, anything else unknown; the first line has y = 0. Every cell of ground
/// holds eight points of quality `quality`.
fn map_of(rows: &[String], quality: f32) -> InformationMap {
    let (mut points, mut scores) = (Vec::new(), Vec::new());
    for (y, row) in rows.iter().enumerate() {
        for (x, kind) in row.chars().enumerate() {
            let (navigable, obstacle, normal) = match kind {
                '.' => (0.95, 0.0, Vector3::z()),
                '#' => (0.0, 0.95, Vector3::x()),
                _ => continue,
            };
            let mut score = PointScore { flags: PointScore::VALID | PointScore::REACHABLE, ..PointScore::NONE };
            score.navigable = PointScore::quantise(navigable);
            score.obstacle = PointScore::quantise(obstacle);
            score.quality = PointScore::quantise(quality);
            score.set_normal(&normal);
            for _ in 0..8 {
                points.push(Point::new(0.3 * (x as f32 + 0.5), 0.3 * (y as f32 + 0.5), 0.0));
                scores.push(score);
            }
        }
    }
    let mut map = InformationMap::new(MapConfig::default()).unwrap();
    map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    map
}

fn field(width: usize, height: usize) -> Vec<String> {
    vec![".".repeat(width); height]
}

fn at(x: f64, y: f64) -> Situation {
    Situation { map_from_robot: Pose::translation(x, y, 0.0), scan_number: 1, run_seed: 7, threads: 1 }
}

fn config() -> PlanningConfig {
    let mut config = PlanningConfig { spacing_m: 1.0, cells_per_candidate: 20, ..Default::default() };
    config.scanner.range_m = 6.0;
    config
}

fn strategies() -> Vec<Box<dyn Strategy>> {
    let registry = StrategyRegistry::default();
    registry.names().map(|name| registry.create(name).unwrap()).collect()
}

fn any_world() -> impl Generator<Value = Vec<String>> {
    let cell = prop_oneof![12 => Just('.'), 1 => Just('#'), 2 => Just(' ')];
    prop::collection::vec(prop::collection::vec(cell, 40).prop_map(String::from_iter), 40)
}

/// Whether a robot from `situation` may be in this cell: proven ground clear of obstacles, or its own surroundings.
fn may_be_in(map: &InformationMap, cell: CellIndex, situation: &Situation, config: &PlanningConfig) -> bool {
    let is_obstacle = |cell| matches!(map.state(cell), CellState::Known(c) if c < config.sight_threshold);
    let robot = situation.map_from_robot.translation.vector;
    let start = map.cell_containing(robot.x, robot.y).unwrap();
    let distance = |a: CellIndex, b: CellIndex| 0.3 * f64::from((a.x - b.x).pow(2) + (a.y - b.y).pow(2)).sqrt();
    if cell == start || (distance(cell, start) <= config.start_clearance_m && !is_obstacle(cell)) {
        return true;
    }
    let around = (-3..=3).flat_map(|x| (-3..=3).map(move |y| CellIndex { x: cell.x + x, y: cell.y + y }));
    matches!(map.state(cell), CellState::Known(c) if c > config.navigable_threshold)
        && around.into_iter().all(|near| distance(near, cell) > config.footprint_radius_m || !is_obstacle(near))
        && config.is_in_work_area(map.centre_of(cell))
}

fn check_plan(plan: &ViewPlan, map: &InformationMap, situation: &Situation, config: &PlanningConfig) {
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
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_strategy_sends_the_robot_off_proven_ground(rows in any_world(), x in 0.5..11.5f64, y in 0.5..11.5f64, bounded in any::<bool>()) {
        let map = map_of(&rows, 0.3);
        let work_area = bounded.then_some(WorkArea { min: [1.0, 1.0], max: [9.0, 11.0] });
        let config = PlanningConfig { work_area, ..config() };
        for mut strategy in strategies() {
            let plan = strategy.plan(&map, &at(x, y), &config);
            check_plan(&plan, &map, &at(x, y), &config);
        }
    }

    #[test]
    fn the_same_input_gives_the_same_plan_on_any_number_of_threads(rows in any_world(), seed in 0..100u64) {
        let map = map_of(&rows, 0.3);
        let situation = Situation { run_seed: seed, ..at(6.0, 6.0) };
        for (mut one, mut other) in strategies().into_iter().zip(strategies()) {
            let plan = one.plan(&map, &situation, &config());
            for threads in [1, 2, 3, 64] {
                prop_assert_eq!(&plan, &other.plan(&map, &Situation { threads, ..situation }, &config()));
            }
        }
    }

    #[test]
    fn candidates_keep_their_distance_and_their_number(rows in any_world(), seed in 0..100u64) {
        let map = map_of(&rows, 0.3);
        let plan = MultiCriteria.plan(&map, &Situation { run_seed: seed, ..at(6.0, 6.0) }, &config());
        prop_assert!(plan.candidates.len() <= plan.navigable_cells / 20);
        for (i, a) in plan.candidates.iter().enumerate() {
            let distance = |b: [f64; 2]| (a.position[0] - b[0]).hypot(a.position[1] - b[1]);
            prop_assert!(distance([6.0, 6.0]) > 1.0);
            prop_assert!(plan.candidates[..i].iter().all(|b| distance([b.position[0], b.position[1]]) > 1.0));
        }
    }
}

#[test]
fn every_strategy_explores_towards_the_unknown() {
    let map = map_of(&field(60, 30), 0.3);
    for mut strategy in strategies() {
        let plan = strategy.plan(&map, &at(4.5, 4.5), &config());
        assert!(plan.chosen().is_some(), "{}: {:?}", strategy.name(), plan.decision);
        assert_eq!(plan.strategy, strategy.name());
        assert_eq!(plan.map_revision, map.revision());
        assert!(plan.path.len() == 2, "open ground needs no bend: {:?}", plan.path);
    }
}

#[test]
fn every_strategy_says_why_it_stops() {
    let reason = |map: &InformationMap, situation: &Situation| {
        strategies().iter_mut().map(|s| s.plan(map, situation, &config()).decision).collect::<Vec<_>>()
    };
    let stop = |reason| vec![Decision::Stop { reason }; strategies().len()];
    let nothing = InformationMap::new(MapConfig::default()).unwrap();
    assert_eq!(reason(&nothing, &at(0.0, 0.0)), stop(StopReason::NoNavigableGround));
    let ground = map_of(&field(30, 30), 0.3);
    assert_eq!(reason(&ground, &at(f64::NAN, 0.0)), stop(StopReason::LocalisationLost));
    assert_eq!(reason(&ground, &at(1e12, 0.0)), stop(StopReason::LocalisationLost));
    assert_eq!(reason(&ground, &at(30.0, 30.0)), stop(StopReason::NothingReachable));
}

#[test]
fn a_plan_can_be_written_down_and_read_back() {
    let map = map_of(&field(40, 40), 0.3);
    for mut strategy in strategies() {
        let plan = strategy.plan(&map, &at(3.0, 3.0), &config());
        let text = toml::to_string(&plan).unwrap();
        assert_eq!(toml::from_str::<ViewPlan>(&text).unwrap(), plan);
    }
}

#[test]
fn a_robot_in_its_own_blind_spot_still_gets_out() {
    let mut rows = field(40, 40);
    for row in &mut rows[18..21] {
        row.replace_range(18..21, "   ");
    }
    let map = map_of(&rows, 0.3);
    let plan = MultiCriteria.plan(&map, &at(5.85, 5.85), &config());
    assert!(plan.chosen().is_some() && plan.reachable_cells > 1000);
}

#[test]
fn a_path_goes_round_a_wall() {
    let mut rows = field(40, 40);
    for row in &mut rows[0..30] {
        row.replace_range(20..21, "#");
    }
    let map = map_of(&rows, 0.3);
    let area = WorkArea { min: [0.0, 0.0], max: [12.0, 12.0] };
    let config = PlanningConfig { work_area: Some(area), farthest_m: 1e4, ..config() };
    let plan = MultiCriteria.plan(&map, &at(2.0, 2.0), &config);
    let behind: Vec<_> = plan.candidates.iter().filter(|c| c.position[0] > 7.0 && c.position[1] < 3.0).collect();
    assert!(!behind.is_empty());
    assert!(behind.iter().all(|c| c.cost > 15.0), "{behind:?}");
    assert!(plan.rejections.counts.contains_key(&RejectionReason::NearObstacle));
}

#[test]
fn a_wall_hides_the_unknown_behind_it() {
    let mut rows = field(20, 20);
    let raw = |rows: &[String]| {
        let map = map_of(rows, 0.99);
        let plan = MultiCriteria.plan(&map, &at(1.0, 3.0), &PlanningConfig { spacing_m: 0.5, ..config() });
        plan.candidates.iter().map(|c| u64::from(c.raw.unexplored_cells)).sum::<u64>() / plan.candidates.len() as u64
    };
    let open = raw(&rows);
    for row in &mut rows {
        row.replace_range(19..20, "#");
    }
    assert!(raw(&rows) * 10 < open * 9);
}

#[test]
fn known_ground_of_good_quality_within_the_work_area_is_done() {
    let area = WorkArea { min: [0.0, 0.0], max: [12.0, 12.0] };
    let config = PlanningConfig { work_area: Some(area), min_mean_quality: 0.9, ..config() };
    for mut strategy in strategies() {
        let plan = strategy.plan(&map_of(&field(40, 40), 1.0), &at(6.0, 6.0), &config);
        assert_eq!(plan.decision, Decision::Stop { reason: StopReason::Done }, "{}", strategy.name());
        assert!(plan.mean_quality.unwrap() > 0.99);
    }
}

#[test]
fn poor_quality_draws_the_robot_and_so_does_a_zone() {
    let config = PlanningConfig {
        work_area: Some(WorkArea { min: [0.0, 0.0], max: [12.0, 12.0] }),
        farthest_m: 1e4,
        ..config()
    };
    let quality = |q| {
        let plan = MultiCriteria.plan(&map_of(&field(40, 40), q), &at(6.0, 6.0), &config);
        plan.candidates.iter().map(|c| c.quality).fold(0.0, f64::max)
    };
    assert!(quality(0.1) > 0.5 && quality(0.1) > 2.0 * quality(0.6) && quality(1.0) == 0.0);

    let mut map = map_of(&field(40, 40), 1.0);
    let zone = Zone { centre: Point3::new(12.0, 6.0, 1.0), normal: Vector3::new(20.0, 0.0, 0.0) };
    let zones = ZoneConfig { retire_range_m: 0.0, ..Default::default() };
    map.update_zones(0, &[zone], &Pose::translation(6.0, 6.0, 1.0), &zones);
    let plan = MultiCriteria.plan(&map, &at(6.0, 2.0), &config);
    let best = plan.candidates.iter().max_by(|a, b| a.zones.total_cmp(&b.zones)).unwrap();
    assert!(best.zones > 0.9 && (best.position[1] - 6.0).abs() < 2.5, "{best:?}");
}

#[test]
fn another_scan_or_seed_draws_other_places() {
    let map = map_of(&field(60, 60), 0.3);
    let places = |situation: Situation| {
        let plan = MultiCriteria.plan(&map, &situation, &config());
        plan.candidates.iter().map(|c| c.position).collect::<Vec<_>>()
    };
    let base = places(at(6.0, 6.0));
    assert_ne!(base, places(Situation { scan_number: 2, ..at(6.0, 6.0) }));
    assert_ne!(base, places(Situation { run_seed: 8, ..at(6.0, 6.0) }));
}

#[test]
fn places_outside_the_work_area_are_refused_with_the_reason() {
    let map = map_of(&field(40, 40), 0.3);
    let area = WorkArea { min: [0.0, 0.0], max: [6.0, 12.0] };
    let plan = MultiCriteria.plan(&map, &at(3.0, 6.0), &PlanningConfig { work_area: Some(area), ..config() });
    assert!(plan.rejections.counts[&RejectionReason::OutsideArea] > 10);
    assert!(plan.rejected.len() <= ViewPlan::MAX_REJECTED);
    assert!(plan.candidates.iter().all(|c| c.position[0] <= 6.0));
}
