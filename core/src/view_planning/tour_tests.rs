use super::super::test_worlds::{at, config, field, map_of, plan_with};
use super::*;
use crate::view_planning::{PlanningConfig, WorkArea};

fn plan(map: &InformationMap, config: &PlanningConfig) -> ViewPlan {
    plan_with(&mut CoverageTour::default(), map, &at(4.5, 4.5), config)
}

#[test]
fn a_tour_names_each_view_once_and_begins_with_the_one_chosen() {
    let map = map_of(&field(80, 80), 0.3);
    let plan = plan(&map, &config());
    let Decision::Go { candidate } = plan.decision else { panic!("{:?}", plan.decision) };
    assert_eq!(plan.tour[0], candidate);
    assert!(plan.tour.len() > 2, "{:?}", plan.tour);
    let mut sorted = plan.tour.clone();
    sorted.sort_unstable();
    sorted.dedup();
    assert_eq!(sorted.len(), plan.tour.len());
}

#[test]
fn what_one_view_of_a_tour_shows_is_not_new_to_the_next() {
    let map = map_of(&field(60, 60), 0.3);
    let plan = plan(&map, &config());
    let in_tour: f64 = plan.tour.iter().map(|&k| plan.candidates[k].utility).sum();
    // Alone, each view of the tour shows more than it adds to those before it, but for the first taken.
    let alone: Vec<f64> = {
        let single = PlanningConfig { tour: TourConfig { max_views: 1, ..config().tour }, ..config() };
        let all = plan_with(&mut CoverageTour::default(), &map, &at(4.5, 4.5), &single);
        plan.tour.iter().map(|&k| all.candidates[k].utility).collect()
    };
    assert!(in_tour < 0.95 * alone.iter().sum::<f64>(), "{in_tour} {alone:?}");
    assert!(plan.tour.iter().zip(&alone).all(|(&k, alone)| plan.candidates[k].utility <= alone + 1e-9));
}

#[test]
fn a_smaller_least_gain_takes_more_views() {
    let map = map_of(&field(80, 80), 0.1);
    let area = WorkArea { min: [0.0, 0.0], max: [24.0, 24.0] };
    let views = |least_gain| {
        let tour = TourConfig { least_gain, ..TourConfig::default() };
        plan(&map, &PlanningConfig { tour, work_area: Some(area), ..config() }).tour.len()
    };
    assert!(views(0.05) > views(0.4), "{} {}", views(0.05), views(0.4));
}

#[test]
fn enough_quality_is_enough() {
    let map = map_of(&field(60, 60), 0.6);
    let area = WorkArea { min: [0.0, 0.0], max: [18.0, 18.0] };
    let decision = |enough_quality| {
        let tour = TourConfig { enough_quality, ..TourConfig::default() };
        plan(&map, &PlanningConfig { tour, work_area: Some(area), ..config() }).decision
    };
    assert_eq!(decision(0.5), Decision::Stop { reason: StopReason::Done });
    assert!(matches!(decision(1.0), Decision::Go { .. }));
}

#[test]
fn it_does_not_stop_before_it_has_looked_from_all_over_the_ground() {
    // All is seen well, but for a corner that only few places show.
    let mut rows = field(60, 60);
    rows.iter_mut().take(12).for_each(|row| row.replace_range(48.., &" ".repeat(12)));
    let map = map_of(&rows, 0.95);
    let area = WorkArea { min: [0.0, 0.0], max: [18.0, 18.0] };
    let plan = |run_seed, max_candidates| {
        let config = PlanningConfig { max_candidates, work_area: Some(area), ..config() };
        plan_with(&mut CoverageTour::default(), &map, &Situation { run_seed, ..at(3.0, 15.0) }, &config)
    };
    for run_seed in 0..8 {
        let [few, many] = [2, 1000].map(|most| plan(run_seed, most));
        assert!(matches!(many.decision, Decision::Go { .. }), "{:?}", many.decision);
        assert!(matches!(few.decision, Decision::Go { .. }), "{run_seed}: {:?}", few.decision);
        assert!(few.candidates.len() <= 2);
    }
}

#[test]
fn the_views_of_the_last_look_are_kept_when_nothing_is_left() {
    let map = map_of(&field(60, 60), 1.0);
    let area = WorkArea { min: [0.0, 0.0], max: [18.0, 18.0] };
    let config = PlanningConfig { max_candidates: 5, work_area: Some(area), ..config() };
    let plan = plan(&map, &config);
    assert_eq!(plan.decision, Decision::Stop { reason: StopReason::Done });
    assert!(!plan.candidates.is_empty() && plan.candidates.len() <= 5);
}
