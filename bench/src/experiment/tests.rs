use mirador_core::view_planning::{StopReason, StrategyRegistry};

use super::*;
use crate::exploration::{GivenUp, Step};

fn settings() -> Settings {
    Settings {
        worlds: vec!["simple".into()],
        experiments: vec!["simple_ii".into(), "coverage_tour".into()],
        seeds: 2,
        coarser: 10,
        max_scans: 2,
        ..Settings::default()
    }
}

fn run_in(folder: &std::path::Path, settings: &Settings) -> Result<Vec<String>, ExperimentError> {
    let mut said = Vec::new();
    let registry = StrategyRegistry::default();
    run(settings, folder, 2, &registry, &|| false, &mut |line| said.push(line.to_owned())).map(|_| said)
}

fn group(efforts: &[(f64, f64, f64)]) -> Group {
    let entry = entries(&["simple".into()], &["coverage_tour".into()], &StrategyRegistry::default()).unwrap().remove(0);
    let mut steps = Vec::new();
    for (k, &(metres, coverage, quality)) in efforts.iter().enumerate() {
        let mission_s = metres / 0.8 + 14.4 * (k + 1) as f64;
        steps.push(Step { metres, coverage, quality, known_cells: 0, planning_ms: 1.0, computing_ms: 2.0, mission_s });
    }
    let run = RunRecord {
        experiment: String::new(),
        world: "simple".into(),
        strategy: "coverage_tour".into(),
        weights_name: String::new(),
        weights: None,
        seed: 1,
        mode: "kinematic".into(),
        stop: None,
        given_up: Vec::new(),
        is_stuck: false,
        steps,
        ways: Vec::new(),
        model_error: None,
        pose_error_m: None,
        wall_s: 1.0,
        picture: None,
    };
    Group { entry, runs: vec![run] }
}

#[test]
fn the_source_s_eight_experiments_are_run_in_their_worlds_and_every_strategy_in_each() {
    let registry = StrategyRegistry::default();
    let all = entries(&Settings::default().worlds, &[], &registry).unwrap();
    let named: Vec<&Entry> = all.iter().filter(|entry| !entry.experiment.is_empty()).collect();
    assert_eq!(named.len(), 8);
    assert!(named.iter().all(|entry| entry.literature().is_some() && entry.experiment.starts_with(&entry.world)));
    let fourth = named.iter().find(|entry| entry.experiment == "simple IV").unwrap();
    assert_eq!((fourth.strategy.as_str(), fourth.weights), ("greedy_new_cells", None));
    for world in &Settings::default().worlds {
        for name in registry.names() {
            assert!(all.iter().any(|entry| &entry.world == world && entry.strategy == name), "{name} in {world}");
        }
    }
    let mut ids: Vec<String> = all.iter().map(Entry::id).collect();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), all.len());
}

#[test]
fn effort_is_compared_where_both_coverage_and_quality_are_reached() {
    let other = group(&[(0.0, 0.3, 0.2), (10.0, 0.6, 0.4), (20.0, 0.8, 0.5), (40.0, 0.8, 0.6)]);
    let own = group(&[(0.0, 0.3, 0.2), (12.0, 0.9, 0.5), (30.0, 0.95, 0.6), (90.0, 1.0, 0.7)]);
    let found = matched(&own, &other);
    assert_eq!((found.pairs, found.reached), (1, 1));
    assert_eq!((found.scans, found.metres), (vec![3.0 / 4.0], vec![30.0 / 40.0]));
    let never = matched(&other, &own);
    assert_eq!((never.reached, Matched::median(&never.scans)), (0, None));
}

#[test]
fn a_run_that_does_not_end_by_its_own_criterion_is_a_failure_and_targets_given_up_are_counted_by_what_was_there() {
    let mut group = group(&[(0.0, 0.3, 0.2)]);
    let given_up = |what: &str| GivenUp { after_scan: 0, position: [1.0, 2.0], what: what.into() };
    let run = |stop, is_stuck| RunRecord { stop, is_stuck, ..group.runs[0].clone() };
    let mut runs = [
        run(Some(StopReason::Done), false),
        run(Some(StopReason::NothingToGain), false),
        run(Some(StopReason::NoCandidate), false),
        run(None, true),
        run(None, false),
    ];
    runs[0].given_up = vec![given_up("a kerb"), given_up("a wall")];
    runs[3].given_up = vec![given_up("a kerb")];
    let words: Vec<String> = runs.iter().map(RunRecord::stop_word).collect();
    assert_eq!(words, ["done", "nothing_to_gain", "no_candidate", "stuck", "cut_off"]);
    group.runs = runs.to_vec();
    assert_eq!(group.failures(), 3);
    assert_eq!(group.given_up(), [("a kerb".to_owned(), 2), ("a wall".to_owned(), 1)].into());
}

#[test]
fn an_experiment_goes_on_where_it_was_and_refuses_other_settings() {
    let folder = tempfile::tempdir().unwrap();
    let first = run_in(folder.path(), &settings()).unwrap();
    assert_eq!(first.len(), 5, "four runs and the ceiling: {first:?}");
    std::fs::remove_file(folder.path().join("runs/simple-coverage_tour-2.json")).unwrap();
    let second = run_in(folder.path(), &settings()).unwrap();
    assert_eq!(second.len(), 2, "{second:?}");
    assert!(second[0].contains("4 of 5") && second[1].contains("coverage_tour seed 2"), "{second:?}");
    let other = Settings { coarser: 9, ..settings() };
    let refused = run_in(folder.path(), &other).unwrap_err();
    assert!(refused.is_usage() && refused.to_string().contains("coarser was 10, now 9"), "{refused}");
    let mut other = settings();
    other.planning.tour.least_gain = 0.3;
    let refused = run_in(folder.path(), &other).unwrap_err().to_string();
    assert!(refused.contains("(planning.tour.least_gain was 0.168, now 0.3)"), "{refused}");
}

#[test]
fn settings_of_the_planner_decide_how_a_run_goes() {
    let driven = |spacing_m: f64| {
        let folder = tempfile::tempdir().unwrap();
        let mut one = Settings { experiments: vec!["coverage_tour".into()], seeds: 1, ..settings() };
        one.planning.spacing_m = spacing_m;
        run_in(folder.path(), &one).unwrap();
        let run = std::fs::read_to_string(folder.path().join("runs/simple-coverage_tour-1.json")).unwrap();
        let run: serde_json::Value = serde_json::from_str(&run).unwrap();
        run["steps"].as_array().unwrap().last().unwrap()["metres"].as_f64().unwrap()
    };
    assert!(driven(8.0) > driven(1.0) + 1.0, "views farther apart are farther to drive to");
}

#[test]
fn a_folder_of_somebody_else_and_a_spoilt_run_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
    assert!(matches!(run_in(folder.path(), &settings()), Err(ExperimentError::NotOurs { .. })));
    let folder = tempfile::tempdir().unwrap();
    let one = Settings { experiments: vec!["simple_ii".into()], seeds: 1, ..settings() };
    run_in(folder.path(), &one).unwrap();
    std::fs::write(folder.path().join("runs/simple-simple_ii-1.json"), "{").unwrap();
    let error = run_in(folder.path(), &one).unwrap_err().to_string();
    assert!(error.contains("simple-simple_ii-1.json") && error.contains("remove it"), "{error}");
}

#[test]
fn what_is_not_known_is_answered_with_what_there_is() {
    let refused = |settings: Settings| settings.validate(&StrategyRegistry::default()).unwrap_err().to_string();
    assert!(refused(Settings { worlds: vec!["moon".into()], ..settings() }).contains("unstructured"));
    assert!(
        refused(Settings { experiments: vec!["pears".into()], ..settings() }).contains("simple_iv, multi_criteria")
    );
    assert!(refused(Settings { experiments: vec!["structured_i".into()], ..settings() }).contains("structured_i"));
    assert!(refused(Settings { coarser: 0, ..settings() }).contains("--coarser"));
    assert!(refused(Settings { seeds: 0, ..settings() }).contains("--seeds"));
    let mut planning = settings().planning;
    planning.tour.least_gain = 7.0;
    assert!(refused(Settings { planning, ..settings() }).contains("tour.least_gain"));
}
