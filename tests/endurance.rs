//! Many scans in a row: memory depends on the map, not on how long the graph runs.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::process::Stdio;

use mirador_ipc_schema::Domain;
use support::observer::Observer;
use support::{Stage, finish, living, small_tour, summary};

/// Scans after which the map of the closed tour has stopped growing. From here on a sample is taken once a round of the tour,
/// always at the same place: what is at work differs from place to place.
const WARM: u32 = 39;
const ROUND: u32 = 8;
const SCANS: u32 = 200;
/// What a process may grow by for reasons that do not add up: an allocator that takes another page or two.
const SLACK_BYTES: u64 = 2 << 20;

/// What the graph takes at one moment.
#[derive(Debug)]
struct Sample {
    /// Resident memory of every process [bytes].
    resident: BTreeMap<String, u64>,
    /// Files in shared memory.
    files: usize,
    /// Bytes they take.
    shared: u64,
}

fn sample(domain: &Domain, processes: &[(String, u32)]) -> Sample {
    let files: Vec<_> = domain.segments();
    Sample {
        resident: processes.iter().map(|(name, pid)| (name.clone(), resident(*pid))).collect(),
        files: files.len(),
        shared: files.iter().filter_map(|f| fs::metadata(f).ok()).map(|m| m.blocks() * 512).sum(),
    }
}

fn resident(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    line.split_ascii_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
}

#[test]
fn two_hundred_scans_take_no_more_memory_than_forty() {
    let stage = Stage::new();
    let mut arguments = small_tour();
    arguments.extend(["--set", "acquisition.rounds=25", "--quiet"].map(str::to_owned));
    let child = stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 1);
    let processes: Vec<_> = living(stage.domain()).into_iter().filter(|(name, _)| name != "observer").collect();
    assert_eq!(processes.len(), 6, "{processes:?}");
    let mut samples = Vec::new();
    for scans in (WARM..SCANS).step_by(ROUND as usize) {
        observer.until_finished("recorder", scans);
        samples.push((scans, sample(stage.domain(), &processes)));
    }
    drop(observer);
    let finished = finish(child);
    assert!(finished.status.success(), "{}", finished.stderr);
    stage.assert_nothing_left();
    let summary = summary(&stage.path("mirador-out"));
    assert_eq!(summary["scans"], SCANS);
    assert_eq!(summary["lost_messages"], 0);
    let first = &samples[0].1;
    for (scans, sample) in &samples {
        println!("{scans}: {sample:?}");
        assert_eq!(sample.files, first.files, "files in shared memory after {scans} scans");
        assert_eq!(sample.shared, first.shared, "bytes in shared memory after {scans} scans");
    }
    // Work in progress comes and goes with every scan, so the peaks of the two halves are compared.
    let (early, late) = samples.split_at(samples.len() / 2);
    for name in first.resident.keys() {
        let peak = |half: &[(u32, Sample)]| half.iter().map(|(_, s)| s.resident[name]).max().unwrap();
        let (begin, end) = (peak(early), peak(late));
        println!("{name}: {:.1} MB, then {:.1} MB", begin as f64 / 1e6, end as f64 / 1e6);
        assert!(end <= begin + begin / 20 + SLACK_BYTES, "{name} has grown from {begin} to {end} bytes");
    }
}
