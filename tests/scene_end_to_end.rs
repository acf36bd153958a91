//! The built-in scene through the whole graph, as processes.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use support::{Stage, summary};

#[test]
fn a_tour_scans_the_built_in_scene() {
    let stage = Stage::new();
    let finished = stage.run_well(&["tour"]);
    let out = stage.path("mirador-out");
    for file in ["model.ply", "trajectory.tum", "map.png", "run.mcap", "report.html", "summary.json", "config.toml"] {
        let size = std::fs::metadata(out.join(file)).unwrap_or_else(|e| panic!("{file}: {e}")).len();
        assert!(size > 100, "{file} has {size} bytes");
    }
    let summary = summary(&out);
    assert_eq!(summary["scans"], 8);
    assert_eq!(summary["aligned"], 8);
    assert_eq!(summary["copied_payload_bytes"], 0);
    assert_eq!(summary["lost_messages"], 0);
    assert_eq!(summary["restarts"], 0);
    assert!(summary["coverage"].as_f64().unwrap() > 0.9, "{}", summary["coverage"]);
    assert!(summary["errors"]["ate_rmse_m"].as_f64().unwrap() < 0.25, "{}", summary["errors"]);
    for stage_name in ["surface", "alignment", "analysis", "map", "planning", "end_to_end"] {
        assert_eq!(summary["latency_ms"][stage_name]["n"], 8, "{stage_name}");
    }
    assert!(finished.stdout.contains("[acquisition]"), "the configuration in effect is printed");
    assert!(finished.stdout.contains("8 scans, 8 aligned"), "{}", finished.stdout);
}
