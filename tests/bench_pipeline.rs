//! `mirador bench pipeline` as users run it, small. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use serde_json::Value;
use support::{Stage, small_scanner};

fn rows<'a>(report: &'a Value, name: &str) -> Vec<&'a Value> {
    report["rows"].as_array().unwrap().iter().filter(|row| row["name"] == name).collect()
}

/// The whole graph in the scene, and every stage in the file with as many measurements as scans.
#[test]
fn every_stage_and_gap_of_the_real_graph_is_in_the_file() {
    let stage = Stage::new();
    let mut arguments: Vec<String> =
        ["bench", "pipeline", "--scans", "4", "--after", "2", "--json", "p.json", "--quiet"].map(String::from).to_vec();
    arguments.extend(small_scanner());
    let finished = stage.run_well(&arguments);
    let report: Value = serde_json::from_str(&std::fs::read_to_string(stage.path("p.json")).unwrap()).unwrap();
    assert_eq!(report["bench"], "pipeline");
    for name in ["surface", "alignment", "analysis", "map", "planning", "end_to_end", "graph_overhead"] {
        let measured: Vec<_> = rows(&report, name).into_iter().filter(|row| row["provenance"] == "measured").collect();
        let [row] = measured.as_slice() else { panic!("{name}: {measured:?}") };
        assert_eq!((&row["n"], &row["unit"]), (&Value::from(4), &Value::from("ms")), "{row}");
        assert_eq!(row["params"]["scans_in_map"], 2);
        assert!(row["params"]["points"].as_u64().unwrap() > 1000 && finished.stdout.contains(name), "{row}");
    }
    let gaps = rows(&report, "gap");
    assert!(gaps.len() == 6 && gaps.iter().all(|row| row["n"] == 4 && row["params"]["gap"].is_string()), "{gaps:?}");
    // The way is its work and its gaps: no part of it is missing or counted twice.
    let p50 = |name: &str| rows(&report, name)[0]["p50"].as_f64().unwrap();
    assert!(p50("end_to_end") >= p50("alignment").max(p50("surface")), "{report}");
    let literature = rows(&report, "end_to_end").into_iter().find(|row| row["provenance"] == "literature").unwrap();
    assert_eq!(literature["p50"], 24_400.0);
}

#[test]
fn a_replay_cannot_be_measured_and_says_what_would_be_right() {
    let stage = Stage::new();
    let finished = stage.run(&["bench", "pipeline", "--set", "acquisition.source=replay"]);
    assert_eq!(finished.status.code(), Some(2));
    assert!(finished.stderr.contains("acquisition.source = \"scene\""), "{}", finished.stderr);
}
