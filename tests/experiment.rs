//! `mirador experiment` as users run it, small: a coarse scanner and few scans. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::SystemTime;

use serde_json::Value;
use support::{Stage, eventually, finish, signal};

/// Two entries of the simple world, two seeds, two scans each.
const SMALL: [&str; 13] = [
    "experiment",
    "--out",
    "e",
    "--worlds",
    "simple",
    "--experiments",
    "simple_ii,coverage_tour",
    "--coarser",
    "10",
    "--seeds",
    "2",
    "--max-scans",
    "2",
];

/// The files of finished runs and when they were written.
fn runs(stage: &Stage) -> Vec<(PathBuf, SystemTime)> {
    let Ok(entries) = fs::read_dir(stage.path("e/runs")) else { return Vec::new() };
    let paths = entries.map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "json"));
    let mut runs: Vec<_> = paths.map(|path| (path.clone(), fs::metadata(path).unwrap().modified().unwrap())).collect();
    runs.sort();
    runs
}

#[test]
fn an_experiment_writes_its_tables_and_goes_on_without_repeating_what_is_finished() {
    let stage = Stage::new();
    stage.run_well(&SMALL);
    let first = runs(&stage);
    assert_eq!(first.len(), 5, "four runs and the ceiling: {first:?}");

    let report: Value = serde_json::from_str(&fs::read_to_string(stage.path("e/experiment.json")).unwrap()).unwrap();
    assert_eq!(report["bench"], "experiment");
    let rows = report["rows"].as_array().unwrap();
    let find = |name: &str, strategy: &str, provenance: &str| {
        let is_it = |row: &&Value| {
            row["name"] == name && row["params"]["strategy"] == strategy && row["provenance"] == provenance
        };
        rows.iter().find(is_it).unwrap_or_else(|| panic!("no row {name} {strategy}")).clone()
    };
    for name in ["metres", "quality", "coverage", "scans", "wall_time", "planning_time", "model_error_median"] {
        for strategy in ["multi_criteria", "coverage_tour"] {
            let row = find(name, strategy, "measured");
            assert!(row["p50"].as_f64().unwrap() > 0.0 && row["params"]["mode"] == "kinematic", "{row}");
        }
    }
    let scans = find("scans", "multi_criteria", "measured");
    assert_eq!((&scans["n"], &scans["p50"]), (&2.into(), &2.0.into()));
    assert_eq!((&scans["pose_error_m"], &scans["stop"]["cut_off"]), (&Value::Null, &2.into()));
    assert_eq!(find("scans", "multi_criteria", "literature")["p50"], 10.0);
    assert!(find("model_error_median", "coverage_tour", "measured")["p50"].as_f64().unwrap() < 0.02);

    let page = fs::read_to_string(stage.path("e/experiment.html")).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("</html>"));
    assert_eq!(page.matches("mission time [min]").count(), 3, "three curves");
    assert_eq!(page.matches("data:image/png;base64,").count(), 2, "a map for each entry");
    assert!(!page.contains("src=\"http") && !page.contains("href=\"http"), "nothing from the network");
    let text = fs::read_to_string(stage.path("e/experiment.md")).unwrap();
    assert!(text.contains("| simple II | multi_criteria | 0.65, 0.25, 0.1, 0.09 | 2 |"), "{text}");

    // Once more: nothing is run again but what is missing.
    fs::remove_file(stage.path("e/runs/simple-simple_ii-1.json")).unwrap();
    let again = stage.run_well(&SMALL);
    assert!(again.stderr.contains("4 of 5 are there already"), "{}", again.stderr);
    let second = runs(&stage);
    let is_kept = |run: &&(PathBuf, SystemTime)| second.contains(run);
    assert_eq!((second.len(), first.iter().filter(is_kept).count()), (5, 4));
}

#[test]
fn other_settings_and_other_folders_are_refused_with_the_reason() {
    let stage = Stage::new();
    stage.run_well(&SMALL);
    let before = runs(&stage);
    let refused = |arguments: &[&str]| {
        let finished = stage.run(arguments);
        assert_eq!(finished.status.code(), Some(2), "{arguments:?}: {}", finished.stderr);
        finished.stderr
    };
    let other: Vec<&str> = SMALL.iter().map(|&word| if word == "10" { "8" } else { word }).collect();
    assert!(refused(&other).contains("coarser was 10, now 8"));
    assert_eq!(runs(&stage), before);
    fs::create_dir(stage.path("mine")).unwrap();
    fs::write(stage.path("mine/thesis.tex"), "").unwrap();
    assert!(refused(&["experiment", "--out", "mine"]).contains("not an experiment"));
    assert!(refused(&["experiment", "--worlds", "moon"]).contains("unstructured"));
    assert!(refused(&["experiment", "--experiments", "pears"]).contains("structured_ii"));
    let with = |set: &str| refused(&["experiment", "--out", "e", "--set", set]);
    assert!(with("alignment.mode=continuous").contains("keys of planning.view only"));
    assert!(with("planning.view.strategy=random").contains("--experiments"));
    assert!(with("planning.view.tour.least_gian=0.2").contains("least_gian"));
    assert!(
        refused(&[&SMALL[..], &["--set", "planning.view.tour.least_gain=0.2"]].concat())
            .contains("least_gain was 0.168")
    );
    assert_eq!(runs(&stage), before);
}

#[test]
fn an_interrupted_experiment_keeps_what_is_finished_and_goes_on() {
    let stage = Stage::new();
    let long: Vec<&str> =
        SMALL.iter().map(|&word| if word == "simple_ii,coverage_tour" { "simple_ii" } else { word }).collect();
    let long = [&long[..11], &["--max-scans", "60"]].concat();
    let child = stage.mirador(&long).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    eventually("a first run is finished", || !runs(&stage).is_empty());
    signal(child.id(), "INT");
    let stopped = finish(child);
    let there = runs(&stage);
    // It may have been done already when the signal came.
    assert!([Some(130), Some(0)].contains(&stopped.status.code()), "{:?} {}", stopped.status, stopped.stderr);
    assert!(stage.path("e/experiment.html").exists());
    stage.run_well(&long);
    let all = runs(&stage);
    assert!(there.iter().all(|run| all.contains(run)));
    assert_eq!(all.len(), 3);
}
