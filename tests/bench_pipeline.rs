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
        ["bench", "pipeline", "--scans", "4", "--after", "2", "--json", "p.json", "--quiet", "--trace", "t.json"]
            .map(String::from)
            .to_vec();
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
    for (service, work) in [("analysis", "surface"), ("alignment", "align"), ("planning", "map"), ("planning", "plan")]
    {
        let is_of = |row: &&&Value| row["params"]["service"] == service && row["params"]["work"] == work;
        let all = rows(&report, "work");
        let parts: Vec<&str> = all.iter().filter(is_of).map(|row| row["params"]["part"].as_str().unwrap()).collect();
        // A plan follows the map at once: it has nothing to wait for.
        let delays = ["waiting", "wake_up", "taking", "computing"];
        assert_eq!(parts, if work == "plan" { &delays[3..] } else { &delays[..] }, "{service} {work}");
    }
    let process = rows(&report, "process");
    let faults =
        process.iter().find(|r| r["params"]["service"] == "analysis" && r["params"]["figure"] == "minor_faults");
    assert!(faults.is_some_and(|row| row["n"].as_u64().unwrap() >= 3), "{process:?}");
    check_trace(&stage);
    let literature = rows(&report, "end_to_end").into_iter().find(|row| row["provenance"] == "literature").unwrap();
    assert_eq!(literature["p50"], 24_400.0);
}

/// The trace holds the measured scans, and nothing of them overlaps on a thread.
fn check_trace(stage: &Stage) {
    let trace: Value = serde_json::from_str(&std::fs::read_to_string(stage.path("t.json")).unwrap()).unwrap();
    let events: Vec<&Value> = trace["traceEvents"].as_array().unwrap().iter().filter(|e| e["ph"] == "X").collect();
    assert!(events.iter().all(|event| event["args"]["scan"].as_u64().unwrap() >= 2), "{trace}");
    let critical = |name: &str| events.iter().any(|e| e["name"] == name && e["args"]["critical_path"] == true);
    assert!(["scan", "scores", "map", "plan"].iter().all(|name| critical(name)), "{trace}");
    let number = |event: &Value, key: &str| event[key].as_f64().unwrap();
    let mut on_threads: Vec<(String, f64, f64)> = events
        .iter()
        .map(|e| (format!("{} {}", e["pid"], e["tid"]), number(e, "ts"), number(e, "ts") + number(e, "dur")))
        .collect();
    on_threads.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for pair in on_threads.windows(2) {
        assert!(pair[0].0 != pair[1].0 || pair[1].1 >= pair[0].2 - 0.002, "{pair:?}");
    }
}

#[test]
fn a_replay_cannot_be_measured_and_says_what_would_be_right() {
    let stage = Stage::new();
    let finished = stage.run(&["bench", "pipeline", "--set", "acquisition.source=replay"]);
    assert_eq!(finished.status.code(), Some(2));
    assert!(finished.stderr.contains("acquisition.source = \"scene\""), "{}", finished.stderr);
}
