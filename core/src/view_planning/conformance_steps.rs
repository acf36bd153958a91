//! Worlds with steps in their ground: what every strategy must hold to there.

use super::conformance::strategies;
use super::conformance_ground::check_plan;
use super::test_worlds::{at, config, field, map_of, plan_with};
use super::*;
use crate::geometry::Pose;
use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;

/// A world with terraces, decks and kerbs on it.
fn any_terraces() -> impl Generator<Value = Vec<String>> {
    let kind = prop_oneof![Just('='), Just('^'), Just('-')];
    let terrace = (0..36usize, 0..36usize, 2..24usize, 2..24usize, kind);
    let cell = prop_oneof![40 => Just('.'), 1 => Just('#'), 2 => Just(' ')];
    let ground = prop::collection::vec(prop::collection::vec(cell, 40), 40);
    (ground, prop::collection::vec(terrace, 1..5)).prop_map(|(mut rows, terraces)| {
        for (x, y, width, height, kind) in terraces {
            for row in rows.iter_mut().skip(y).take(height) {
                row.iter_mut().skip(x).take(width).filter(|cell| **cell != ' ').for_each(|cell| *cell = kind);
            }
        }
        rows.into_iter().map(String::from_iter).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_strategy_sends_the_robot_over_a_step(rows in any_terraces(), x in 0.5..11.5f64, y in 0.5..11.5f64, clearance in 0.3..3.0f64, is_on_ground in any::<bool>()) {
        let map = map_of(&rows, 0.3);
        let config = PlanningConfig { start_clearance_m: clearance, ..config() };
        let z = map.lowest_level(map.cell_containing(x, y).unwrap()).map_or(0.0, |level| level.ground());
        let mut situation = at(x, y);
        situation.map_from_robot.translation.z = if is_on_ground { z } else { 0.0 };
        for mut strategy in strategies() {
            let plan = plan_with(strategy.as_mut(), &map, &situation, &config);
            check_plan(&plan, &map, &situation, &config);
        }
    }
}

#[test]
fn the_robot_stays_on_a_deck_and_off_a_terrace_but_climbs_a_kerb() {
    let mut rows = field(40, 60);
    for row in &mut rows[20..32] {
        row.replace_range(4..36, &"^".repeat(32));
    }
    for row in &mut rows[50..] {
        row.replace_range(.., &"-".repeat(40));
    }
    let map = map_of(&rows, 0.3);
    let on_deck = Situation { map_from_robot: Pose::translation(6.0, 7.8, 3.0), ..at(0.0, 0.0) };
    let heights = |situation: &Situation| -> Vec<f64> {
        let plan = plan_with(&mut MultiCriteria::default(), &map, situation, &config());
        check_plan(&plan, &map, situation, &config());
        assert!(plan.candidates.len() > 3, "{plan:?}");
        plan.candidates.iter().map(|candidate| candidate.position[2]).collect()
    };
    assert!(heights(&on_deck).iter().all(|z| *z > 2.9));
    let beside = heights(&at(6.0, 12.0));
    assert!(beside.iter().all(|z| *z < 0.2) && beside.iter().any(|z| *z > 0.07), "{beside:?}");
    // Who masters higher steps is not held up by them.
    let giant = PlanningConfig { max_step_m: 2.0, max_slope_deg: 60.0, ..config() };
    let low = map_of(&rows.iter().map(|row| row.replace('^', "=")).collect::<Vec<_>>(), 0.3);
    let plan = plan_with(&mut MultiCriteria::default(), &low, &at(6.0, 12.0), &giant);
    assert!(plan.candidates.iter().any(|candidate| candidate.position[2] > 0.5));
}

#[test]
fn a_robot_whose_blind_spot_ends_at_a_terrace_gets_away_from_it() {
    let mut rows = field(40, 40);
    for row in &mut rows[18..21] {
        row.replace_range(18..21, "   ");
    }
    for row in &mut rows {
        row.replace_range(21..40, &"=".repeat(19));
    }
    let map = map_of(&rows, 0.3);
    for mut strategy in strategies() {
        let plan = plan_with(strategy.as_mut(), &map, &at(5.85, 5.85), &config());
        assert!(
            plan.chosen().is_some_and(|chosen| chosen.position[2] < 0.1),
            "{}: {:?}",
            strategy.name(),
            plan.decision
        );
        check_plan(&plan, &map, &at(5.85, 5.85), &config());
    }
}
