//! `mirador bench planning` as users run it, small. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;

use serde_json::Value;
use support::Stage;

fn report(stage: &Stage, options: &[&str]) -> Value {
    stage.run_well(&[&["bench", "planning", "--json", "p.json"], options].concat());
    serde_json::from_str(&fs::read_to_string(stage.path("p.json")).unwrap()).unwrap()
}

#[test]
fn a_growing_map_has_rows_with_time_candidates_and_memory() {
    let stage = Stage::new();
    let report = report(&stage, &["--cases", "growth", "--growth-scans", "40", "--repetitions", "2"]);
    assert_eq!(report["bench"], "planning");
    let rows = report["rows"].as_array().unwrap();
    let of = |name: &str| rows.iter().filter(|row| row["name"] == name).collect::<Vec<_>>();
    assert_eq!(of("evaluate_candidates").len(), 2);
    for row in of("evaluate_candidates") {
        assert_eq!((&row["unit"], &row["provenance"]), (&"ms".into(), &"measured".into()));
        assert_eq!(row["params"]["scans_in_map"], 40);
        assert!(row["params"]["candidates"].as_u64().unwrap() > 20, "{row}");
        assert!(row["cells_per_second"].as_f64().unwrap() > 1e6 && row["bytes"].as_u64().unwrap() > 1_000_000, "{row}");
    }
    assert_eq!((of("first_plan").len(), of("other_weights").len()), (1, 1));
}

#[test]
fn an_exploration_tells_scans_metres_quality_and_coverage() {
    let stage = Stage::new();
    let only = ["--cases", "exploration", "--strategies", "greedy_replanning", "--seeds", "1", "--coarser", "8"];
    let report = report(&stage, &only);
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2, "one a world");
    for row in rows {
        assert_eq!((&row["name"], &row["params"]["strategy"]), (&"exploration".into(), &"greedy_replanning".into()));
        assert!(row["scans"].as_u64().unwrap() > 1 && row["metres"].as_f64().unwrap() > 1.0, "{row}");
        for share in ["mean_quality", "coverage"] {
            assert!((0.1..=1.0).contains(&row[share].as_f64().unwrap()), "{row}");
        }
    }
}

#[test]
fn wrong_options_are_refused_with_what_would_be_right() {
    let stage = Stage::new();
    let refused = |option: &[&str]| {
        let finished = stage.run(&[&["bench", "planning"], option].concat());
        assert_eq!(finished.status.code(), Some(2), "{option:?}: {}", finished.stderr);
        finished.stderr
    };
    assert!(refused(&["--cases", "pears"]).contains("evaluate, growth"));
    assert!(refused(&["--strategies", "pears"]).contains("coverage_tour"));
    assert!(refused(&["--repetitions", "0"]).contains("repetitions"));
    assert!(refused(&["--growth-scans", "3"]).contains("growth_scans"));
}
