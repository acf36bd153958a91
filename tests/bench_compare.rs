//! `mirador bench compare` as users run it, on a report that was measured here. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;

use serde_json::Value;
use support::Stage;

/// Measures something small, with enough samples to be judged.
fn measured(stage: &Stage) -> Value {
    stage.run_well(&["bench", "simulator", "--repetitions", "8", "--json", "old.json", "--quiet"]);
    serde_json::from_str(&fs::read_to_string(stage.path("old.json")).unwrap()).unwrap()
}

/// The samples and percentiles of the rows of this name, `times` as large.
fn scaled(report: &Value, name: &str, times: f64) -> Value {
    let mut report = report.clone();
    for row in report["rows"].as_array_mut().unwrap().iter_mut().filter(|row| row["name"] == name) {
        for sample in row["samples"].as_array_mut().unwrap() {
            *sample = (sample.as_f64().unwrap() * times).into();
        }
        for key in ["p50", "p90", "p99", "max"] {
            row[key] = (row[key].as_f64().unwrap() * times).into();
        }
    }
    report
}

#[test]
fn a_measured_report_is_compared_with_itself_and_with_slower_ones() {
    let stage = Stage::new();
    let report = measured(&stage);
    assert!(report["rows"].as_array().unwrap().iter().all(|row| row["samples"].as_array().unwrap().len() == 8));
    let same = stage.run_well(&["bench", "compare", "old.json", "old.json", "--json", "c.json"]);
    assert!(same.stdout.contains("0 slower, 0 faster"), "{}", same.stdout);
    let comparison: Value = serde_json::from_str(&fs::read_to_string(stage.path("c.json")).unwrap()).unwrap();
    assert_eq!(comparison["rows"].as_array().unwrap().len(), report["rows"].as_array().unwrap().len());
    assert_eq!(comparison["rows"][0]["verdict"], "alike");
    // Several times as slow is beyond the scatter of any machine.
    fs::write(stage.path("slow.json"), scaled(&report, "physics", 5.0).to_string()).unwrap();
    let slow = stage.run(&["bench", "compare", "old.json", "slow.json"]);
    assert_eq!(slow.status.code(), Some(1), "{}{}", slow.stdout, slow.stderr);
    assert!(slow.stdout.contains("\nslower\n") && slow.stdout.contains("physics (threads 1"), "{}", slow.stdout);
    assert!(!slow.stdout.contains("rays"), "{}", slow.stdout);
    let fast = stage.run_well(&["bench", "compare", "slow.json", "old.json"]);
    assert!(fast.stdout.contains("\nfaster\n") && !fast.stdout.contains("\nslower\n"), "{}", fast.stdout);
    let bearable = stage.run_well(&["bench", "compare", "old.json", "slow.json", "--threshold", "9"]);
    assert!(bearable.stdout.contains("0 slower"), "{}", bearable.stdout);
    // Rays a second: fewer is slower.
    fs::write(stage.path("fewer.json"), scaled(&report, "rays", 0.2).to_string()).unwrap();
    assert_eq!(stage.run(&["bench", "compare", "old.json", "fewer.json"]).status.code(), Some(1));
}

#[test]
fn wrong_usage_is_answered_with_file_and_field_and_exit_code_2() {
    let stage = Stage::new();
    let machine = r#"{"cpu": "a", "cores": 2, "os": "b", "commit": "c"}"#;
    let row =
        r#"{"name": "x", "params": {}, "unit": "ms", "n": 1, "p50": 1, "p90": 1, "max": 1, "provenance": "measured"}"#;
    fs::write(stage.path("a.json"), format!("{{\"bench\": \"ipc\", \"machine\": {machine}, \"rows\": [{row}]}}"))
        .unwrap();
    fs::write(stage.path("b.json"), "[1, 2").unwrap();
    let refused = |arguments: &[&str]| {
        let finished = stage.run(&[&["bench", "compare"], arguments].concat());
        assert_eq!(finished.status.code(), Some(2), "{arguments:?}: {}{}", finished.stdout, finished.stderr);
        finished.stderr
    };
    let missing = refused(&["a.json", "a.json"]);
    assert!(missing.contains("a.json: rows[0]: missing field `p99`"), "{missing}");
    assert!(refused(&["b.json", "a.json"]).contains("b.json: not JSON"));
    assert!(refused(&["nowhere.json", "a.json"]).contains("nowhere.json"));
    assert!(refused(&["a.json"]).contains("NEW.json"));
    assert!(refused(&["a.json", "a.json", "--threshold", "-1"]).contains("--threshold -1"));
}
