//! The ways to bring one's own, as the pages of the documentation give them: their commands are run, and print what they
//! say.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use support::observer::Observer;
use support::page::{build_examples, matches, root, run, target};
use support::{Stage, eventually, finish, python, signal, small_tour, summary};

#[test]
fn three_dots_stand_for_anything() {
    assert!(matches("overlap 0.9, 3 iterations", "overlap ..., ... iterations"));
    assert!(matches("by external: 4 of 4", "by external..."));
    assert!(matches("as it is", "as it is"));
    for wrong in ["by gicp...", "by external: 4", "by ... of 5", "by ...: 5..."] {
        assert!(!matches("by external: 4 of 4", wrong), "{wrong}");
    }
}

#[test]
fn a_method_in_a_crate_of_its_own() {
    let stage = Stage::new();
    build_examples();
    run(&stage, "own-registration.md", &[]);
}

#[test]
fn an_alignment_service_in_the_place_of_ours() {
    let stage = Stage::new();
    build_examples();
    run(&stage, "own-alignment.md", &[("my-target", &target())]);
    let summary = summary(&stage.path("my-run"));
    assert!(summary["errors"]["ate_rmse_m"].as_f64().unwrap() < 0.5, "{}", summary["errors"]);
    assert!(summary["registration"].is_null(), "nobody else registers");
}

#[test]
fn a_method_that_another_binary_has_is_not_known_to_mirador() {
    let stage = Stage::new();
    let finished = stage.run(&["tour", "--set", "alignment.registration=damped"]);
    assert_eq!(finished.status.code(), Some(2));
    assert!(finished.stderr.contains("`damped`") && finished.stderr.contains("gicp"), "{}", finished.stderr);
}

#[test]
fn a_registration_process_in_python() {
    let Some(environment) = python::environment("a_registration_process_in_python") else { return };
    let stage = Stage::new();
    run(&stage, "own-registration-process.md", &[("my-python", &environment)]);
    let summary = summary(&stage.path("my-run"));
    let registration = &summary["registration"];
    assert!(registration["answered"].as_u64().unwrap() >= 7, "{registration}");
    assert_eq!(registration["fallbacks"], 0, "{registration}");
    assert!(summary["errors"]["ate_rmse_m"].as_f64().unwrap() < 0.1, "{}", summary["errors"]);
}

#[test]
fn listening_from_python() {
    let Some(environment) = python::environment("listening_from_python") else { return };
    let stage = Stage::new();
    let domain = format!("mirador_messages {}", stage.domain().name());
    run(&stage, "python.md", &[("my-python", &environment), ("mirador_messages mirador", Path::new(&domain))]);
}

/// A tour whose registration is the Python example, with this folder of modules.
fn with_python(stage: &Stage, environment: &Path, modules: &Path, more: &[&str]) -> Child {
    let (python, icp) = (environment.join("bin/python"), root().join("examples/python_icp/icp.py"));
    let command = format!("programs.registration.command=[\"{}\", \"{}\"]", python.display(), icp.display());
    let mut arguments = small_tour();
    let settings = ["alignment.registration=external", command.as_str()];
    arguments.extend(settings.iter().chain(more).flat_map(|s| ["--set".to_owned(), (*s).to_owned()]));
    arguments.extend(["--quiet", "--log-level", "debug", "--log-format", "json"].map(str::to_owned));
    let mut command = stage.mirador(&arguments);
    command.env("PYTHONPATH", modules).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn log(stage: &Stage, service: &str) -> String {
    fs::read_to_string(stage.path("mirador-out").join("logs").join(format!("{service}.log"))).unwrap_or_default()
}

#[test]
fn python_reads_keyframes_where_alignment_wrote_them() {
    let Some(environment) = python::environment("python_reads_keyframes_where_alignment_wrote_them") else { return };
    let stage = Stage::new();
    let settings = ["alignment.external.deadline_ms=60000", "alignment.global.method=off"];
    let finished = finish(with_python(&stage, &environment, &root().join("python"), &settings));
    assert!(finished.status.success(), "{}\n{}", finished.stderr, log(&stage, "registration"));
    let written = support::places_of(&log(&stage, "alignment"), "keyframes");
    let read: Vec<(u64, u64, u64)> = log(&stage, "registration")
        .lines()
        .filter_map(|line| line.split(' ').map(|word| word.parse().ok()).collect::<Option<Vec<u64>>>())
        .filter_map(|numbers| <[u64; 3]>::try_from(numbers).ok())
        .map(|[scan, inode, offset]| (scan, inode, offset))
        .collect();
    assert!(read.len() >= 7, "{}", log(&stage, "registration"));
    assert!(read.iter().all(|place| written.contains(place)), "{read:?} {written:?}");
}

#[test]
fn a_python_of_another_schema_is_named_and_the_run_goes_on() {
    let Some(environment) = python::environment("a_python_of_another_schema_is_named_and_the_run_goes_on") else {
        return;
    };
    let stage = Stage::new();
    // The module of a version in which keyframes were something else.
    let modules = stage.path("modules/mirador_messages");
    fs::create_dir_all(&modules).unwrap();
    for entry in fs::read_dir(root().join("python/mirador_messages")).unwrap().map(Result::unwrap) {
        if entry.path().is_file() {
            fs::copy(entry.path(), modules.join(entry.file_name())).unwrap();
        }
    }
    let schema = fs::read_to_string(modules.join("schema.py")).unwrap();
    let line = schema.lines().find(|line| line.contains("Topic(\"registration_request\"")).unwrap();
    let hash = line.split('"').nth(3).unwrap();
    fs::write(modules.join("schema.py"), schema.replace(hash, "00000000deadbeef")).unwrap();
    let settings = ["alignment.external.start_timeout_ms=2000", "acquisition.rounds=1000"];
    let child = with_python(&stage, &environment, &stage.path("modules"), &settings);
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 3);
    drop(observer);
    let mut shown = Value::Null;
    eventually("top says why the program is not there", || {
        shown = serde_json::from_str(&stage.run(&["top", "--once", "--json"]).stdout).unwrap_or_default();
        let services = shown["services"].as_array().cloned().unwrap_or_default();
        services.iter().any(|s| s["service"] == "registration" && s["state"] == "failed")
    });
    let said = shown.to_string();
    assert!(said.contains("00000000deadbeef") && said.contains("another layout"), "{said}");
    assert!(shown["registration"]["faults"]["absent"].as_u64().unwrap() > 0, "{said}");
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert!(finished.stderr.contains("00000000deadbeef") && finished.stderr.contains(hash), "{}", finished.stderr);
    let summary = summary(&stage.path("mirador-out"));
    assert!(summary["scans"].as_u64().unwrap() >= 3 && summary["registration"]["answered"] == 0);
}

#[test]
fn the_python_module_reads_every_topic_in_place() {
    let Some(environment) = python::environment("the_python_module_reads_every_topic_in_place") else { return };
    let stage = Stage::new();
    let mut arguments = small_tour();
    arguments.extend(["--set", "acquisition.rounds=1000", "--quiet"].map(str::to_owned));
    let child = stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 1);
    drop(observer);
    let mut tests = Command::new(environment.join("bin/python"));
    tests.args(["-m", "unittest", "discover", "-s"]).arg(root().join("python/tests"));
    tests.env("PYTHONPATH", root().join("python")).env("MIRADOR_TEST_DOMAIN", stage.domain().name());
    let tested = finish(tests.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    assert!(tested.status.success(), "{}\n{}", tested.stdout, tested.stderr);
    assert!(tested.stderr.contains("Ran 10 tests"), "{}", tested.stderr);
    signal(child.id(), "INT");
    assert_eq!(finish(child).status.code(), Some(130));
}
