//! What happens when processes die: nothing that was measured is lost, and the result is the same.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use serde_json::Value;
use support::observer::{Observer, is_running, kill_9};
use support::{Finished, Stage, eventually, finish, living, signal, small_tour, summary};

const SERVICES: [&str; 5] = ["acquisition", "alignment", "analysis", "planning", "recorder"];
/// Rounds of the tour of 8 poses.
const ROUNDS: u32 = 2;
const SCANS: u32 = 8 * ROUNDS;
/// A run that nobody waits for to end.
const ENDLESS: u32 = 1000;
/// What is promised for the end of a graph.
const PROMISED: Duration = Duration::from_secs(2);

fn arguments(rounds: u32, more: &[&str]) -> Vec<String> {
    let mut arguments = small_tour();
    arguments.extend(["--set".to_owned(), format!("acquisition.rounds={rounds}"), "--quiet".to_owned()]);
    arguments.extend(more.iter().map(|a| (*a).to_owned()));
    arguments
}

fn start(stage: &Stage, arguments: &[String]) -> Child {
    stage.mirador(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// The files that must not depend on who died: trajectory and model.
fn results(out: &Path) -> [Vec<u8>; 2] {
    ["trajectory.tum", "model.ply"].map(|name| fs::read(out.join(name)).unwrap())
}

/// The results of a run in which nobody dies.
fn undisturbed(stage: &Stage) -> &'static [Vec<u8>; 2] {
    static RESULTS: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    RESULTS.get_or_init(|| {
        stage.run_well(&arguments(ROUNDS, &["--out", "undisturbed"]));
        results(&stage.path("undisturbed"))
    })
}

fn assert_undisturbed(stage: &Stage, finished: &Finished, restarts: u64) {
    let logs = || {
        let folder = stage.path("mirador-out").join("logs");
        let texts = SERVICES.map(|s| fs::read_to_string(folder.join(format!("{s}.log"))).unwrap_or_default());
        format!("{}\n{}", finished.stderr, texts.join("\n"))
    };
    assert_eq!(finished.status.code(), Some(0), "{}", logs());
    let summary = summary(&stage.path("mirador-out"));
    assert_eq!(summary["restarts"], restarts, "{}", logs());
    assert_eq!(summary["scans"], SCANS, "{}", logs());
    assert_eq!(summary["poses"].as_array().unwrap().len(), SCANS as usize);
    let planned = summary["latency_ms"]["planning"]["n"].as_u64();
    assert_eq!(planned, Some(u64::from(SCANS)), "every scan is planned on\n{}", logs());
    let [trajectory, model] = results(&stage.path("mirador-out"));
    let [expected_trajectory, expected_model] = undisturbed(stage);
    assert_eq!(
        String::from_utf8_lossy(&trajectory),
        String::from_utf8_lossy(expected_trajectory),
        "the trajectory is another\n{}",
        logs()
    );
    assert!(model == *expected_model, "the model is another\n{}", logs());
    stage.assert_nothing_left();
}

/// Kills `victim` once a `witness` has finished the scan of each moment: with other witnesses the victim is caught in
/// other parts of its work.
fn killed(victim: &str, moments: &[(&str, u32)]) {
    let stage = Stage::new();
    undisturbed(&stage);
    let child = start(&stage, &arguments(ROUNDS, &[]));
    let mut observer = Observer::join(stage.domain());
    let mut dead = BTreeSet::new();
    for (witness, scans) in moments {
        observer.until(&format!("{witness} has finished {scans} scans while {victim} is alive"), |seen| {
            let alive = seen.get(victim).is_some_and(|h| !dead.contains(&h.pid));
            alive && seen.get(*witness).is_some_and(|h| h.finished_scans >= *scans)
        });
        let pid = observer.pid(victim);
        kill_9(pid);
        dead.insert(pid);
    }
    drop(observer);
    let finished = finish(child);
    assert_undisturbed(&stage, &finished, moments.len() as u64);
}

/// One death in the work of every service.
fn moments(scans: [u32; 5]) -> Vec<(&'static str, u32)> {
    SERVICES.into_iter().zip(scans).collect()
}

#[test]
fn killed_acquisition_changes_nothing() {
    killed("acquisition", &moments([2, 4, 6, 8, 10]));
}

#[test]
fn killed_alignment_changes_nothing() {
    killed("alignment", &moments([2, 4, 6, 8, 10]));
}

#[test]
fn killed_analysis_changes_nothing() {
    killed("analysis", &moments([2, 4, 6, 8, 10]));
}

#[test]
fn killed_planning_changes_nothing() {
    killed("planning", &moments([2, 4, 6, 8, 10]));
}

#[test]
fn a_killed_recorder_changes_nothing() {
    killed("recorder", &moments([2, 4, 6, 8, 10]));
}

#[test]
fn services_killed_before_their_first_scan_change_nothing() {
    for victim in SERVICES {
        killed(victim, &[(victim, 0)]);
    }
}

#[test]
fn all_services_killed_at_once_change_nothing() {
    let stage = Stage::new();
    undisturbed(&stage);
    let child = start(&stage, &arguments(ROUNDS, &[]));
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 3);
    observer.until("everybody has been heard", |seen| SERVICES.iter().all(|s| seen.contains_key(*s)));
    for service in SERVICES {
        kill_9(observer.pid(service));
    }
    drop(observer);
    let finished = finish(child);
    assert_undisturbed(&stage, &finished, 5);
}

/// Interrupts a run with a signal; returns how it ended and its summary.
fn interrupted_by(name: &str) -> (Finished, Value) {
    let stage = Stage::new();
    let child = start(&stage, &arguments(ENDLESS, &[]));
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 3);
    drop(observer);
    let processes = living(stage.domain());
    assert!(processes.len() == 6, "{processes:?}");
    let begin = Instant::now();
    signal(child.id(), name);
    eventually("the processes of the graph have ended", || {
        !processes.iter().any(|(name, pid)| name != "supervisor" && is_running(*pid))
    });
    assert!(begin.elapsed() < PROMISED, "the services needed {:?}", begin.elapsed());
    let finished = finish(child);
    assert!(begin.elapsed() < PROMISED, "the program needed {:?}", begin.elapsed());
    stage.assert_nothing_left();
    let summary = summary(&stage.path("mirador-out"));
    (finished, summary)
}

fn assert_interrupted((finished, summary): &(Finished, Value)) {
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert_eq!(finished.stderr, "", "an interrupted run is no error");
    assert_eq!(summary["interrupted"], true);
    assert_eq!(summary["recording_complete"], true);
    let scans = summary["scans"].as_u64().unwrap();
    assert!((3..u64::from(8 * ENDLESS)).contains(&scans), "{scans} scans");
    assert_eq!(summary["restarts"], 0);
}

#[test]
fn ctrl_c_ends_the_graph_and_leaves_the_results_so_far() {
    assert_interrupted(&interrupted_by("INT"));
}

#[test]
fn sigterm_ends_the_graph_like_ctrl_c() {
    assert_interrupted(&interrupted_by("TERM"));
}

#[test]
fn ctrl_c_before_the_first_scan_ends_the_graph() {
    let stage = Stage::new();
    let child = start(&stage, &arguments(ENDLESS, &[]));
    eventually("the supervisor is there", || living(stage.domain()).iter().any(|(name, _)| name == "supervisor"));
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert_eq!(finished.stderr, "");
    stage.assert_nothing_left();
}

#[test]
fn a_killed_supervisor_takes_its_children_along_and_the_next_run_cleans_up() {
    let stage = Stage::new();
    let mut child = start(&stage, &arguments(ENDLESS, &[]));
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 3);
    drop(observer);
    let services: Vec<u32> = living(stage.domain()).iter().map(|(_, pid)| *pid).filter(|p| *p != child.id()).collect();
    assert_eq!(services.len(), 5);
    let begin = Instant::now();
    kill_9(child.id());
    eventually("the children have ended", || !services.iter().any(|pid| is_running(*pid)));
    assert!(begin.elapsed() < PROMISED, "the children needed {:?}", begin.elapsed());
    child.wait().unwrap();
    assert!(!stage.domain().segments().is_empty(), "a killed supervisor cannot clean up: the test shows nothing");
    let finished = stage.run_well(&arguments(1, &[]));
    assert_eq!(finished.stderr, "");
    assert_eq!(summary(&stage.path("mirador-out"))["scans"], 8);
    assert!(stage.path("mirador-out.1").is_dir(), "the folder of the killed run is kept aside");
}

/// Runs a graph in which a command takes the place of planning; it must end by itself with exit code 1.
fn with_planning_by(command: &str) -> String {
    let stage = Stage::new();
    let setting = format!("services.planning.command={command}");
    let finished = stage.run(&arguments(1, &["--set", &setting]));
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    stage.assert_nothing_left();
    let errors: Vec<_> = finished.stderr.lines().filter(|l| l.starts_with("error:")).collect();
    assert_eq!(errors.len(), 1, "{}", finished.stderr);
    let tries = finished.stderr.lines().filter(|l| l.contains("started again")).count();
    assert_eq!(tries, 5, "it is tried as often as the graph file says\n{}", finished.stderr);
    errors[0].to_owned()
}

#[test]
fn a_service_whose_program_is_not_there_ends_the_run_by_name() {
    let error = with_planning_by("[\"/nowhere/planner\"]");
    assert!(error.contains("planning") && error.contains("/nowhere/planner"), "{error}");
}

#[test]
fn a_service_that_always_fails_ends_the_run_with_its_last_words() {
    let error = with_planning_by("[\"sh\", \"-c\", \"echo no licence for this robot >&2; exit 3\"]");
    assert!(error.contains("planning") && error.contains("exit code 3"), "{error}");
    assert!(error.contains("no licence for this robot"), "{error}");
}

#[test]
fn a_service_that_never_may_be_restarted_ends_the_run_when_it_dies() {
    let stage = Stage::new();
    let child = start(&stage, &arguments(ENDLESS, &["--set", "services.analysis.restart=never"]));
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 3);
    observer.until("analysis has been heard", |seen| seen.contains_key("analysis"));
    kill_9(observer.pid("analysis"));
    drop(observer);
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    assert!(finished.stderr.contains("error: analysis ended (signal 9)"), "{}", finished.stderr);
    let summary = summary(&stage.path("mirador-out"));
    assert!(summary["scans"].as_u64().unwrap() >= 3, "the scans before it are there");
    stage.assert_nothing_left();
}
