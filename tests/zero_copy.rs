//! The points of a scan are written once; every process reads them where they were written.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;
use support::{Stage, small_tour, summary};

/// Where a service saw the points of each scan: inode of the segment and offset in it.
fn places(out: &Path, service: &str) -> BTreeMap<u64, BTreeSet<(u64, u64)>> {
    let log = out.join("logs").join(format!("{service}.log"));
    let mut places: BTreeMap<u64, BTreeSet<(u64, u64)>> = BTreeMap::new();
    for line in fs::read_to_string(&log).unwrap().lines() {
        let line: Value = serde_json::from_str(line).unwrap_or_else(|e| panic!("{}: {e}: {line}", log.display()));
        let fields = &line["fields"];
        if fields["message"] == "payload" {
            let number = |name: &str| fields[name].as_u64().unwrap_or_else(|| panic!("{service}: no {name}: {line}"));
            places.entry(number("scan")).or_default().insert((number("inode"), number("offset")));
        }
    }
    places
}

#[test]
fn every_process_reads_the_points_where_acquisition_wrote_them() {
    let stage = Stage::new();
    let mut arguments: Vec<String> = ["--log-level", "debug", "--log-format", "json"].map(str::to_owned).to_vec();
    arguments.extend(small_tour());
    stage.run_well(&arguments);
    let out = stage.path("mirador-out");
    let written = places(&out, "acquisition");
    assert_eq!(written.keys().copied().collect::<Vec<_>>(), (0..8).collect::<Vec<_>>(), "every scan was written");
    for (scan, places) in &written {
        assert_eq!(places.len(), 1, "scan {scan} was written once");
        assert!(places.iter().all(|(inode, _)| *inode > 0), "scan {scan}: {places:?}");
    }
    // Two scans may share a slot one after the other, but the slots differ: it is not one constant that is logged.
    assert!(written.values().collect::<BTreeSet<_>>().len() > 1, "{written:?}");
    for service in ["alignment", "analysis", "planning"] {
        assert_eq!(places(&out, service), written, "{service}");
    }
    let summary = summary(&out);
    let services = summary["services"].as_array().unwrap();
    let names: Vec<_> = services.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["acquisition", "alignment", "analysis", "planning", "recorder"]);
    for service in services {
        assert_eq!(service["copied_payload_bytes"], 0, "{service}");
        assert_eq!(service["lost_messages"], 0, "{service}");
        assert!(service["sent_messages"].as_u64().unwrap() > 0, "{service}");
    }
}
