//! What every strategy of the registry must hold to, whatever it is after; and what the source's one holds besides.

use super::conformance_ground::check_plan;
use super::strategy::Strategy;
use super::test_worlds::{at, config, field, map_of, plan_with};
use super::*;
use crate::geometry::Pose;
use crate::information_map::{InformationMap, MapConfig, Zone, ZoneConfig};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;

pub(super) fn strategies() -> Vec<Box<dyn Strategy>> {
    let registry = StrategyRegistry::default();
    registry.names().map(|name| registry.create(name).unwrap()).collect()
}

fn any_world() -> impl Generator<Value = Vec<String>> {
    let cell = prop_oneof![12 => Just('.'), 1 => Just('#'), 2 => Just(' ')];
    prop::collection::vec(prop::collection::vec(cell, 40).prop_map(String::from_iter), 40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_strategy_sends_the_robot_off_proven_ground(rows in any_world(), x in 0.5..11.5f64, y in 0.5..11.5f64, bounded in any::<bool>(), strict in any::<bool>()) {
        let map = map_of(&rows, 0.3);
        let work_area = bounded.then_some(WorkArea { min: [1.0, 1.0], max: [9.0, 11.0] });
        let footprint = if strict { FootprintRule::Verified } else { FootprintRule::Clear };
        let config = PlanningConfig { work_area, footprint, ..config() };
        for mut strategy in strategies() {
            let plan = plan_with(strategy.as_mut(), &map, &at(x, y), &config);
            check_plan(&plan, &map, &at(x, y), &config);
        }
    }

    #[test]
    fn the_same_input_gives_the_same_plan_on_any_number_of_threads(rows in any_world(), seed in 0..100u64) {
        let map = map_of(&rows, 0.3);
        let situation = Situation { run_seed: seed, ..at(6.0, 6.0) };
        for (mut one, mut other) in strategies().into_iter().zip(strategies()) {
            let plan = plan_with(one.as_mut(), &map, &situation, &config());
            for threads in [1, 2, 3, 64] {
                prop_assert_eq!(&plan, &plan_with(other.as_mut(), &map, &Situation { threads, ..situation }, &config()));
            }
        }
    }

    #[test]
    fn candidates_keep_their_distance_and_their_number(rows in any_world(), seed in 0..100u64) {
        let map = map_of(&rows, 0.3);
        let plan = plan_with(&mut MultiCriteria::default(), &map, &Situation { run_seed: seed, ..at(6.0, 6.0) }, &config());
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
        let plan = plan_with(strategy.as_mut(), &map, &at(4.5, 4.5), &config());
        assert!(plan.chosen().is_some(), "{}: {:?}", strategy.name(), plan.decision);
        assert_eq!(plan.strategy, strategy.name());
        assert_eq!(plan.map_revision, map.revision());
        assert!(plan.path.len() == 2, "open ground needs no bend: {:?}", plan.path);
    }
}

#[test]
fn every_strategy_says_why_it_stops() {
    let reason = |map: &InformationMap, situation: &Situation| {
        strategies().iter_mut().map(|s| plan_with(s.as_mut(), map, situation, &config()).decision).collect::<Vec<_>>()
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
        let plan = plan_with(strategy.as_mut(), &map, &at(3.0, 3.0), &config());
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
    let plan = plan_with(&mut MultiCriteria::default(), &map, &at(5.85, 5.85), &config());
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
    let plan = plan_with(&mut MultiCriteria::default(), &map, &at(2.0, 2.0), &config);
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
        let plan = plan_with(
            &mut MultiCriteria::default(),
            &map,
            &at(1.0, 3.0),
            &PlanningConfig { spacing_m: 0.5, ..config() },
        );
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
        let plan = plan_with(strategy.as_mut(), &map_of(&field(40, 40), 1.0), &at(6.0, 6.0), &config);
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
        let plan = plan_with(&mut MultiCriteria::default(), &map_of(&field(40, 40), q), &at(6.0, 6.0), &config);
        plan.candidates.iter().map(|c| c.quality).fold(0.0, f64::max)
    };
    assert!(quality(0.1) > 0.5 && quality(0.1) > 2.0 * quality(0.6) && quality(1.0) == 0.0);

    let mut map = map_of(&field(40, 40), 1.0);
    let zone = Zone { centre: Point3::new(12.0, 6.0, 1.0), normal: Vector3::new(20.0, 0.0, 0.0) };
    let zones = ZoneConfig { retire_range_m: 0.0, ..Default::default() };
    map.update_zones(0, &[zone], &Pose::translation(6.0, 6.0, 1.0), &zones);
    let plan = plan_with(&mut MultiCriteria::default(), &map, &at(6.0, 2.0), &config);
    let best = plan.candidates.iter().max_by(|a, b| a.zones.total_cmp(&b.zones)).unwrap();
    assert!(best.zones > 0.9 && (best.position[1] - 6.0).abs() < 2.5, "{best:?}");
}

#[test]
fn another_scan_or_seed_draws_other_places() {
    let map = map_of(&field(60, 60), 0.3);
    let places = |situation: Situation| {
        let plan = plan_with(&mut MultiCriteria::default(), &map, &situation, &config());
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
    let plan = plan_with(
        &mut MultiCriteria::default(),
        &map,
        &at(3.0, 6.0),
        &PlanningConfig { work_area: Some(area), ..config() },
    );
    assert!(plan.rejections.counts[&RejectionReason::OutsideArea] > 10);
    assert!(plan.rejected.len() <= ViewPlan::MAX_REJECTED);
    assert!(plan.candidates.iter().all(|c| c.position[0] <= 6.0));
}

/// A map that grows scan by scan, as a robot's does.
fn growing(rows: &[String], scans: usize) -> Vec<InformationMap> {
    (1..=scans).map(|k| map_of(&rows[..rows.len() * k / scans], 0.3)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn what_a_workspace_was_used_for_before_changes_no_plan(rows in any_world(), seed in 0..100u64) {
        let maps = growing(&rows, 3);
        let names: Vec<String> = StrategyRegistry::default().names().map(str::to_owned).collect();
        let mut workspace = Workspace::new();
        for map in &maps {
            for name in names.iter().filter(|name| *name != "greedy_unvisited") {
                for weights in [Weights::default(), Weights { information: 0.1, quality: 0.8, zones: 0.1, cost: 0.2 }] {
                    let config = PlanningConfig { weights, ..config() };
                    let situation = Situation { run_seed: seed, ..at(6.0, 2.0) };
                    let fresh = || StrategyRegistry::default().create(name).unwrap();
                    let kept = fresh().plan(&mut workspace, map, &situation, &config);
                    prop_assert_eq!(kept, plan_with(fresh().as_mut(), map, &situation, &config), "{}", name);
                }
            }
        }
    }
}

#[test]
fn a_map_that_changes_under_a_workspace_is_read_again() {
    let mut workspace = Workspace::new();
    let (wide, narrow) = (map_of(&field(40, 40), 0.3), map_of(&field(40, 20), 0.3));
    let nothing = InformationMap::new(MapConfig::default()).unwrap();
    for map in [&wide, &narrow, &wide.clone(), &nothing, &narrow] {
        let plan = MultiCriteria::default().plan(&mut workspace, map, &at(3.0, 3.0), &config());
        assert_eq!(plan, plan_with(&mut MultiCriteria::default(), map, &at(3.0, 3.0), &config()));
    }
    assert!(workspace.bytes() > 10_000);
}

#[test]
fn other_weights_weigh_the_same_candidates() {
    let map = map_of(&field(40, 40), 0.3);
    let mut workspace = Workspace::new();
    let mut plan = |information, quality| {
        let weights = Weights { information, quality, zones: 0.0, cost: 0.09 };
        MultiCriteria::default().plan(&mut workspace, &map, &at(6.0, 6.0), &PlanningConfig { weights, ..config() })
    };
    let (news, better) = (plan(1.0, 0.0), plan(0.0, 1.0));
    let terms = |plan: &ViewPlan| plan.candidates.iter().map(|c| (c.position, c.raw, c.cost)).collect::<Vec<_>>();
    assert_eq!(terms(&news), terms(&better));
    assert_ne!(news.chosen().map(|c| c.position), better.chosen().map(|c| c.position));
}

#[test]
fn ground_farther_off_is_looked_at_when_none_near_is_worth_it() {
    // A lane of ground that hardly gets better; the unknown begins behind its far end.
    let mut rows = field(40, 20);
    for row in &mut rows {
        row.push_str(&".".repeat(160));
    }
    let map = map_of(&rows, 0.985);
    let area = WorkArea { min: [0.0, 0.0], max: [70.0, 6.0] };
    let near = PlanningConfig { near_m: 15.0, work_area: Some(area), min_mean_quality: 1.0, ..config() };
    for name in ["multi_criteria", "frontier", "greedy_informative", "greedy_new_cells", "coverage_tour"] {
        let mut strategy = StrategyRegistry::default().create(name).unwrap();
        let plan = plan_with(strategy.as_mut(), &map, &at(3.0, 3.0), &near);
        let chosen = plan.chosen().unwrap_or_else(|| panic!("{name}: {:?}", plan.decision));
        assert!(chosen.position[0] > 50.0, "{name}: {chosen:?}");
        let blinkered = PlanningConfig { horizon_m: 15.0, ..near.clone() };
        let plan = plan_with(strategy.as_mut(), &map, &at(3.0, 3.0), &blinkered);
        assert!(plan.chosen().is_none_or(|chosen| chosen.position[0] < 18.5), "{name}");
    }
}

#[test]
fn a_robot_among_obstacles_or_on_unknown_ground_gets_a_plan_or_a_reason() {
    let mut rows = field(40, 40);
    for row in &mut rows[15..26] {
        row.replace_range(15..26, "###########");
    }
    let walled = map_of(&rows, 0.3);
    for row in &mut rows[15..26] {
        row.replace_range(15..26, "           ");
    }
    let unknown = map_of(&rows, 0.3);
    for mut strategy in strategies() {
        let plan = plan_with(strategy.as_mut(), &walled, &at(6.0, 6.0), &config());
        assert_eq!(plan.decision, Decision::Stop { reason: StopReason::NothingReachable }, "{}", strategy.name());
        let plan = plan_with(strategy.as_mut(), &unknown, &at(6.0, 6.0), &config());
        assert_eq!(plan.decision, Decision::Stop { reason: StopReason::NothingReachable }, "{}", strategy.name());
        let near = PlanningConfig { start_clearance_m: 3.0, ..config() };
        let plan = plan_with(strategy.as_mut(), &unknown, &at(6.0, 6.0), &near);
        assert!(plan.chosen().is_some(), "{}: {:?}", strategy.name(), plan.decision);
        check_plan(&plan, &unknown, &at(6.0, 6.0), &near);
    }
}

#[test]
fn a_strategy_that_is_told_where_it_has_been_plans_as_one_that_was_there() {
    let maps = growing(&field(60, 60), 4);
    let situation =
        |scan: usize| Situation { scan_number: scan as u64, ..at(3.0 + 3.0 * scan as f64, 2.0 + scan as f64) };
    for (mut undisturbed, mut restarted) in strategies().into_iter().zip(strategies()) {
        let mut plans = (0..4).map(|scan| plan_with(undisturbed.as_mut(), &maps[scan], &situation(scan), &config()));
        let last = plans.by_ref().last().unwrap();
        for scan in 0..3 {
            restarted.remember(&situation(scan));
        }
        let again = plan_with(restarted.as_mut(), &maps[3], &situation(3), &config());
        assert_eq!(again, last, "{}", restarted.name());
        // Asked again, it has not been anywhere else.
        assert_eq!(plan_with(restarted.as_mut(), &maps[3], &situation(3), &config()), last);
    }
}

#[test]
fn without_any_place_to_scan_from_every_strategy_stops_with_a_reason() {
    // Reachable ground, but all of it nearer to the robot than the spacing.
    let map = map_of(&field(30, 30), 0.3);
    let config = PlanningConfig { spacing_m: 30.0, ..config() };
    for mut strategy in strategies() {
        let plan = plan_with(strategy.as_mut(), &map, &at(4.5, 4.5), &config);
        let draws = ["multi_criteria", "coverage_tour", "random"].contains(&strategy.name());
        let reason = if draws { StopReason::NoCandidate } else { StopReason::Done };
        assert_eq!(plan.decision, Decision::Stop { reason }, "{}", strategy.name());
        assert!(plan.reachable_cells > 100);
        assert!(plan.rejections.counts.contains_key(&RejectionReason::NearRobot) || !draws, "{:?}", plan.rejections);
    }
}

#[test]
fn a_robot_that_stands_on_an_obstacle_or_beyond_the_map_says_so() {
    let mut rows = field(40, 40);
    for row in &mut rows[18..21] {
        row.replace_range(18..21, "###");
    }
    let map = map_of(&rows, 0.3);
    let nowhere = PlanningConfig { start_clearance_m: 0.0, ..config() };
    for mut strategy in strategies() {
        let reason = Decision::Stop { reason: StopReason::NothingReachable };
        for place in [at(5.85, 5.85), at(-30.0, 5.0)] {
            assert_eq!(plan_with(strategy.as_mut(), &map, &place, &nowhere).decision, reason, "{}", strategy.name());
        }
    }
}
