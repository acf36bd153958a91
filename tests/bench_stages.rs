//! `mirador bench stages` as users run it, small. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use serde_json::Value;
use support::Stage;

#[test]
fn every_stage_has_a_row_for_each_number_of_threads() {
    let stage = Stage::new();
    let finished = stage.run_well(&["bench", "stages", "--repetitions", "1", "--threads", "1,2", "--json", "s.json"]);
    let report: Value = serde_json::from_str(&std::fs::read_to_string(stage.path("s.json")).unwrap()).unwrap();
    assert_eq!(report["bench"], "stages");
    let rows = report["rows"].as_array().unwrap();
    let of = |name: &str, provenance: &str| {
        let is_asked = |row: &&Value| row["name"] == name && row["provenance"] == provenance;
        rows.iter().filter(is_asked).collect::<Vec<_>>()
    };
    for name in ["surface", "scores", "condense", "add", "map"] {
        let measured = of(name, "measured");
        let threads: Vec<_> = measured.iter().filter_map(|row| row["params"]["threads"].as_u64()).collect();
        assert_eq!(threads, [1, 2], "{name}");
        for row in measured {
            assert_eq!((&row["n"], &row["unit"]), (&Value::from(15), &Value::from("ms")), "{row}");
            assert!(row["params"]["returns"].as_u64().unwrap() > 100_000 && finished.stdout.contains(name), "{row}");
        }
    }
    let [moved] = of("move_scan", "measured")[..] else { panic!("{report}") };
    assert!(moved["bytes_per_known_m2"].as_f64().unwrap() > 100.0 && moved["items_per_scan"].as_u64().unwrap() > 1000);
    assert_eq!(of("surface", "literature")[0]["p50"], 120.0);
}

#[test]
fn wrong_options_are_refused_with_what_would_be_right() {
    let stage = Stage::new();
    for (option, value) in [("--repetitions", "0"), ("--threads", "0")] {
        let finished = stage.run(&["bench", "stages", option, value]);
        assert_eq!(finished.status.code(), Some(2), "{option}: {}", finished.stderr);
        assert!(
            finished.stderr.contains(&option[2..]) && finished.stderr.contains("at least 1"),
            "{}",
            finished.stderr
        );
    }
}
