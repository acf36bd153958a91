//! Registration by a process of somebody else's, under the supervisor: honest, dead, hung, lying, flooding.
//!
//! The answering process is this test program once more (see `support::answerer`).

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::OnceLock;

use mirador_ipc_schema::Domain;
use serde_json::Value;
use support::answerer::{self, BEHAVIOUR};
use support::observer::{Observer, kill_9};
use support::{Finished, Stage, eventually, finish, signal, small_tour, summary};

#[test]
fn the_answering_process() {
    answerer::answer_if_asked();
}

/// Arguments of a tour whose registration is this program.
fn arguments(more: &[&str]) -> Vec<String> {
    let mut arguments = small_tour();
    let settings = ["alignment.registration=external", &answerer::command()];
    arguments.extend(settings.iter().chain(more).flat_map(|s| ["--set".to_owned(), (*s).to_owned()]));
    arguments.push("--quiet".into());
    arguments
}

fn start(stage: &Stage, behaviour: &str, more: &[&str]) -> Child {
    let mut command = stage.mirador(&arguments(more));
    command.env(BEHAVIOUR, behaviour).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn trajectory(out: &Path) -> String {
    fs::read_to_string(out.join("trajectory.tum")).unwrap()
}

/// The trajectory of a tour that nobody else registers.
fn by_the_built_in(stage: &Stage) -> &'static str {
    static TRAJECTORY: OnceLock<String> = OnceLock::new();
    TRAJECTORY.get_or_init(|| {
        let arguments: Vec<String> = small_tour().into_iter().chain(["--out", "built-in"].map(str::to_owned)).collect();
        stage.run_well(&arguments);
        trajectory(&stage.path("built-in"))
    })
}

fn log(stage: &Stage, service: &str) -> String {
    fs::read_to_string(stage.path("mirador-out").join("logs").join(format!("{service}.log"))).unwrap_or_default()
}

fn ended_well(stage: &Stage, finished: &Finished) -> Value {
    let logs = || format!("{}\n{}\n{}", finished.stderr, log(stage, "alignment"), log(stage, "registration"));
    assert_eq!(finished.status.code(), Some(0), "{}", logs());
    let summary = summary(&stage.path("mirador-out"));
    assert_eq!((&summary["scans"], &summary["aligned"]), (&8.into(), &8.into()), "{}", logs());
    stage.assert_nothing_left();
    summary
}

/// A run with a process that is never right: every pose is the built-in method's, and the fault is counted and named.
fn ill(behaviour: &str, fault: &str, words: &str, more: &[&str]) -> (Value, Finished) {
    let stage = Stage::new();
    let expected = by_the_built_in(&stage);
    let finished = finish(start(&stage, behaviour, more));
    let summary = ended_well(&stage, &finished);
    let registration = &summary["registration"];
    assert_eq!(registration["answered"], 0, "{registration}");
    assert_eq!(registration["questions"], registration["fallbacks"], "{registration}");
    assert!(registration["faults"][fault].as_u64().unwrap() >= 1, "{registration}");
    assert!(log(&stage, "alignment").contains(words), "{}", log(&stage, "alignment"));
    assert_eq!(trajectory(&stage.path("mirador-out")), expected, "{behaviour}: the built-in method's poses");
    (summary, finished)
}

#[test]
fn a_foreign_process_aligns_a_tour() {
    let stage = Stage::new();
    let expected = by_the_built_in(&stage);
    let finished = finish(start(&stage, "honest", &["alignment.external.deadline_ms=60000"]));
    let summary = ended_well(&stage, &finished);
    let registration = &summary["registration"];
    assert!(registration["questions"].as_u64().unwrap() >= 7, "{registration}");
    assert_eq!(registration["answered"], registration["questions"], "{registration}");
    assert!(registration["max_answer_ms"].as_f64().unwrap() > 0.0, "{registration}");
    assert!(registration["last_fault"].is_null(), "{registration}");
    assert_eq!(summary["restarts"], 0);
    // The small scanner's scans are coarse: the built-in method comes as near.
    assert!(summary["errors"]["ate_rmse_m"].as_f64().unwrap() < 0.3, "{}", summary["errors"]);
    assert_ne!(trajectory(&stage.path("mirador-out")), expected, "the poses are its own");
    let explained = stage.run(&["explain", "mirador-out", "1"]).stdout;
    assert!(explained.contains("accepted against scan 0 by external"), "{explained}");
}

#[test]
fn a_process_that_crashes_is_restarted_until_it_may_not_and_the_run_goes_on() {
    let (summary, finished) =
        ill("crash", "died", "ended while it was asked", &["programs.registration.max_restarts=1"]);
    assert!(finished.stderr.contains("registration ended (signal 6)"), "{}", finished.stderr);
    assert!(finished.stderr.contains("the run goes on without it"), "{}", finished.stderr);
    let registration = summary["services"].as_array().unwrap().iter().find(|s| s["name"] == "registration").unwrap();
    assert_eq!(registration["restarts"], 1);
    assert!(summary["registration"]["faults"]["absent"].as_u64().unwrap() >= 1, "{}", summary["registration"]);
}

#[test]
fn a_process_that_hangs_is_late_and_then_killed_and_started_again() {
    let settings = ["alignment.external.deadline_ms=100", "programs.registration.health_timeout_ms=400"];
    let stage = Stage::new();
    let child = start(&stage, "hang", &[&settings[..], &["acquisition.rounds=1000"]].concat());
    let mut observer = Observer::join(stage.domain());
    observer.until("the process was heard", |seen| seen.contains_key("registration"));
    let first = observer.pid("registration");
    observer.until("another process took its place", |seen| seen["registration"].pid != first);
    drop(observer);
    // `mirador top` counts it and says why.
    let top = stage.run(&["top", "--once", "--json"]);
    let shown: Value = serde_json::from_str(&top.stdout).unwrap();
    assert!(shown["registration"]["faults"]["late"].as_u64().unwrap() >= 1, "{}", top.stdout);
    assert!(shown["registration"]["last_fault"].is_string(), "{}", top.stdout);
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert!(finished.stderr.contains("says nothing for too long"), "{}", finished.stderr);
    let summary = summary(&stage.path("mirador-out"));
    assert_eq!(summary["registration"]["answered"], 0);
    // The last scan may have been in hand when the run was ended.
    let [scans, aligned] = ["scans", "aligned"].map(|key| summary[key].as_u64().unwrap());
    assert!(aligned > 1 && scans - aligned <= 1, "{aligned} of {scans}");
    assert!(log(&stage, "alignment").contains("no answer within 100 ms"));
}

#[test]
fn a_pose_of_nan_is_refused() {
    ill("nan", "not_finite", "its pose holds a value that is not finite", &["alignment.external.deadline_ms=60000"]);
}

#[test]
fn a_pose_that_is_not_rigid_is_refused() {
    ill("non_rigid", "not_rigid", "its pose is not a rigid motion", &["alignment.external.deadline_ms=60000"]);
}

#[test]
fn the_answer_to_an_older_request_is_refused() {
    ill("older", "outdated", "instead of request", &["alignment.external.deadline_ms=100"]);
}

#[test]
fn a_process_that_floods_is_refused() {
    ill("flood", "flood", "it floods", &["alignment.external.deadline_ms=60000"]);
}

#[test]
fn a_process_of_another_schema_is_refused_and_both_sides_are_named() {
    ill("schema", "schema", "there 00000001", &["alignment.external.deadline_ms=60000"]);
}

#[test]
fn a_program_that_is_not_there_is_named_and_the_run_goes_on() {
    let stage = Stage::new();
    let expected = by_the_built_in(&stage);
    let settings = ["programs.registration.command=[\"/nowhere/icp\"]", "alignment.external.start_timeout_ms=200"];
    let finished = finish(start(&stage, "", &[&settings[..], &["programs.registration.max_restarts=1"]].concat()));
    let summary = ended_well(&stage, &finished);
    assert!(finished.stderr.contains("/nowhere/icp"), "{}", finished.stderr);
    let registration = &summary["registration"];
    assert_eq!(registration["faults"]["absent"], registration["questions"], "{registration}");
    assert_eq!(trajectory(&stage.path("mirador-out")), expected);
}

#[test]
fn a_process_that_is_killed_is_started_again_and_asked_again() {
    let stage = Stage::new();
    let settings = ["alignment.external.deadline_ms=60000", "acquisition.rounds=1000"];
    let child = start(&stage, "honest", &settings);
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 2);
    observer.until("the process was heard", |seen| seen.contains_key("registration"));
    let first = observer.pid("registration");
    kill_9(first);
    observer.until("another process took its place", |seen| seen["registration"].pid != first);
    drop(observer);
    let answered = || {
        let top = stage.run(&["top", "--once", "--json"]);
        let shown: Value = serde_json::from_str(&top.stdout).unwrap_or_default();
        shown["registration"]["answered"].as_u64().unwrap_or(0)
    };
    let before = answered();
    eventually("it is asked again", || answered() > before);
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    let summary = summary(&stage.path("mirador-out"));
    assert_eq!(summary["restarts"], 1);
    let poses = summary["poses"].as_array().unwrap();
    assert!(poses.iter().all(|pose| pose["status"] != "rejected"), "{poses:?}");
}

#[test]
fn keyframes_are_read_where_alignment_wrote_them() {
    let stage = Stage::new();
    let settings = ["alignment.external.deadline_ms=60000", "alignment.global.method=off"];
    let mut arguments = arguments(&settings);
    arguments.extend(["--log-level", "debug", "--log-format", "json"].map(str::to_owned));
    arguments.extend(["--set".into(), answerer::logging_command()]);
    let mut command = stage.mirador(&arguments);
    let child = command.env(BEHAVIOUR, "honest").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let finished = finish(child);
    ended_well(&stage, &finished);
    let read = answerer::requests(&log(&stage, "registration"));
    let written = support::places_of(&log(&stage, "alignment"), "keyframes");
    assert!(read.len() >= 7, "{read:?}");
    for (_, place) in &read {
        assert!(written.contains(place), "{place:?} of {written:?}");
    }
    // Each is aligned to the one before, and the request says so.
    let pairs: Vec<(u32, u64)> = read.iter().map(|(target, (source, ..))| (*target, *source)).collect();
    assert!((1..8).all(|k| pairs.contains(&(k as u32 - 1, k))), "{pairs:?}");
}

#[test]
fn a_killed_alignment_goes_on_with_the_foreign_process_where_it_stopped() {
    let stage = Stage::new();
    let settings = ["alignment.external.deadline_ms=60000", "acquisition.rounds=2"];
    let finished = finish(start(&stage, "honest", &settings));
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    let (undisturbed, asked) = (trajectory(&stage.path("mirador-out")), summary(&stage.path("mirador-out")));
    let child = start(&stage, "honest", &settings);
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 4);
    observer.until("alignment has been heard", |seen| seen.contains_key("alignment"));
    kill_9(observer.pid("alignment"));
    drop(observer);
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(0), "{}\n{}", finished.stderr, log(&stage, "alignment"));
    let killed = summary(&stage.path("mirador-out"));
    assert_eq!((&killed["restarts"], &killed["scans"]), (&1.into(), &16.into()));
    assert_eq!(killed["registration"]["fallbacks"], 0, "{}", killed["registration"]);
    // What was counted before the death counts; what was asked and not yet told of is asked again.
    let count = |summary: &Value| summary["registration"]["answered"].as_u64().unwrap();
    assert!(count(&killed) + 4 >= count(&asked), "{} {}", killed["registration"], asked["registration"]);
    assert_eq!(trajectory(&stage.path("mirador-out")), undisturbed);
}

/// `bench registration` over the near pairs of a real recording, with this program as the external method.
fn compared(stage: &Stage, behaviour: &str, more: &[&str]) -> Option<Finished> {
    start_comparison(stage, behaviour, more).map(finish)
}

fn start_comparison(stage: &Stage, behaviour: &str, more: &[&str]) -> Option<Child> {
    let scans = support::data("external_registration", "handheld")?;
    let command = answerer::command();
    let mut arguments: Vec<&str> = vec!["bench", "registration", "--data", scans.to_str().unwrap()];
    arguments.extend(["--poses", "odometry.tum", "--max-distance", "0.6", "--methods", "external,gicp"]);
    arguments.extend(["--json", "r.json", "--set", &command]);
    arguments.extend(more.iter().flat_map(|setting| ["--set", setting]));
    let mut command = stage.mirador(&arguments);
    Some(command.env(BEHAVIOUR, behaviour).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
}

/// The rows of external and of gicp.
fn compared_rows(stage: &Stage) -> [Value; 2] {
    let report: Value = serde_json::from_str(&fs::read_to_string(stage.path("r.json")).unwrap()).unwrap();
    ["external", "gicp"].map(|method| {
        let rows = report["rows"].as_array().unwrap();
        rows.iter().find(|row| row["params"]["method"] == method).unwrap().clone()
    })
}

#[test]
fn a_foreign_process_is_told_which_scans_it_compares_and_is_compared_with_built_in_methods_over_a_data_set() {
    let stage = Stage::new();
    // One that is not told which scans they are refuses to answer.
    let Some(finished) = compared(&stage, "named", &["alignment.external.deadline_ms=60000"]) else { return };
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    let [external, gicp] = compared_rows(&stage);
    assert!(external["n"].as_u64().unwrap() >= 5 && external["n"] == gicp["n"], "{external}");
    for row in [&external, &gicp] {
        assert_eq!(row["success_rate"], 1.0, "{row}");
    }
    stage.assert_nothing_left();
}

#[test]
fn a_foreign_process_that_lies_fails_at_every_pair_of_a_comparison() {
    let stage = Stage::new();
    let Some(finished) = compared(&stage, "nan", &["alignment.external.deadline_ms=60000"]) else { return };
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    let [external, gicp] = compared_rows(&stage);
    assert_eq!((&external["success_rate"], &gicp["success_rate"]), (&0.0.into(), &1.0.into()), "{external}");
    stage.assert_nothing_left();
}

#[test]
fn a_comparison_without_its_program_says_what_is_missing() {
    let stage = Stage::new();
    let settings = ["programs.registration.command=[\"/nowhere/icp\"]", "alignment.external.start_timeout_ms=300"];
    let Some(finished) = compared(&stage, "honest", &settings) else { return };
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    assert!(finished.stderr.contains("/nowhere/icp"), "{}", finished.stderr);
    let refused = stage.run(&["bench", "registration", "--data", ".", "--methods", "external"]);
    assert!(!refused.status.success(), "{}", refused.stderr);
    stage.assert_nothing_left();
}

#[test]
fn a_comparison_that_the_user_stops_leaves_nothing() {
    let stage = Stage::new();
    // Every answer is awaited for so long that there is time to stop it.
    let settings = ["alignment.external.deadline_ms=1000"];
    let Some(child) = start_comparison(&stage, "hang", &settings) else { return };
    // The domain is taken after the handlers are there.
    let domain = format!("bench-{:x}", child.id());
    eventually("the comparison is under way", || Domain::existing().iter().any(|d| d.name() == domain));
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    assert!(finished.stderr.contains("stopped before everything was measured"), "{}", finished.stderr);
    stage.assert_nothing_left();
}
