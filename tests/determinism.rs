//! The same input gives the same bits: again, from the recording, and with any number of threads.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use mirador_ipc_schema::{text, topics};
use mirador_recorder::RunReader;
use support::outputs::{assert_same_bits, recording};
use support::{Stage, data, small_tour};

/// Runs into a folder of the stage.
fn run_into(stage: &Stage, out: &str, arguments: &[String]) {
    let mut all = vec!["--quiet".to_owned(), "--out".to_owned(), out.to_owned()];
    all.extend_from_slice(arguments);
    stage.run_well(&all);
}

/// Replays the recording of an earlier run.
fn replay_into(stage: &Stage, out: &str, of: &str) {
    let recording = stage.path(of).join("run.mcap").display().to_string();
    run_into(stage, out, &["replay".to_owned(), recording]);
}

fn recording_of(stage: &Stage, out: &str) -> RunReader {
    recording(&stage.path(out))
}

fn set(settings: &[&str]) -> Vec<String> {
    settings.iter().flat_map(|s| ["--set".to_owned(), (*s).to_owned()]).collect()
}

#[test]
fn a_scene_gives_the_same_bits_again_from_its_recording_and_with_other_threads() {
    let stage = Stage::new();
    let scene = small_tour();
    run_into(&stage, "first", &scene);
    run_into(&stage, "again", &scene);
    assert_same_bits(&stage.path("first"), &stage.path("again"));
    replay_into(&stage, "replayed", "first");
    assert_same_bits(&stage.path("first"), &stage.path("replayed"));
    let threads = set(&["services.alignment.threads=1", "services.planning.threads=1", "services.analysis.threads=2"]);
    run_into(&stage, "threads", &[scene, threads].concat());
    assert_same_bits(&stage.path("first"), &stage.path("threads"));
}

#[test]
fn a_recording_is_replayed_with_the_configuration_it_was_made_with_unless_another_is_given() {
    let stage = Stage::new();
    let settings = set(&["acquisition.max_scans=3", "planning.seed=7", "alignment.registration=point_to_point"]);
    run_into(&stage, "first", &[small_tour(), settings].concat());
    replay_into(&stage, "replayed", "first");
    assert_same_bits(&stage.path("first"), &stage.path("replayed"));
    let recording = stage.path("first").join("run.mcap").display().to_string();
    let other = set(&["alignment.registration=point_to_plane"]);
    run_into(&stage, "other", &[vec!["replay".to_owned(), recording], other].concat());
    let method = |out: &str| {
        let mut hypotheses = Vec::new();
        let alignment = recording_of(&stage, out).read_about::<topics::Alignment>(1, &mut hypotheses).unwrap().unwrap();
        text::unpack(&alignment.method).to_owned()
    };
    assert_eq!((method("replayed"), method("other")), ("point_to_point".to_owned(), "point_to_plane".to_owned()));
}

#[test]
fn another_seed_gives_other_bits() {
    let stage = Stage::new();
    let two = set(&["acquisition.max_scans=2"]);
    run_into(&stage, "one", &[small_tour(), two.clone()].concat());
    run_into(&stage, "two", &[small_tour(), two, set(&["acquisition.seed=2"])].concat());
    let read = |out: &str| std::fs::read(stage.path(out).join("model.ply")).unwrap();
    assert!(read("one") != read("two"), "the comparison of the other tests can fail");
}

#[test]
fn real_scans_give_the_same_bits_from_their_recording_and_with_other_threads() {
    let Some(scans) = data("determinism", "3dtk_dat") else { return };
    let stage = Stage::new();
    let replay = ["replay", &scans.display().to_string(), "--grid", "226x360"].map(str::to_owned).to_vec();
    run_into(&stage, "first", &replay);
    replay_into(&stage, "replayed", "first");
    assert_same_bits(&stage.path("first"), &stage.path("replayed"));
    replay_into(&stage, "twice", "replayed");
    assert_same_bits(&stage.path("first"), &stage.path("twice"));
    let threads = set(&["services.alignment.threads=1", "services.planning.threads=1", "services.analysis.threads=2"]);
    run_into(&stage, "threads", &[replay, threads].concat());
    assert_same_bits(&stage.path("first"), &stage.path("threads"));
}
