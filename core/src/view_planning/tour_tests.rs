use super::super::test_worlds::{at, config, field, map_of, plan_with};
use super::*;
use crate::view_planning::{PlanningConfig, WorkArea};

fn plan(map: &InformationMap, config: &PlanningConfig) -> ViewPlan {
    plan_with(&mut CoverageTour, map, &at(4.5, 4.5), config)
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
        let all = plan_with(&mut CoverageTour, &map, &at(4.5, 4.5), &single);
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
