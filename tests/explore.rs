//! A simulated robot explores a world through the whole process graph: it decides, drives and scans.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::path::Path;

use mirador_ipc_schema::messages::Envelope;
use mirador_ipc_schema::{Topic, topics};
use support::outputs::{assert_same_bits, recording};
use support::{Stage, summary};

/// The usual robot, its scanner with beams every 1.5 degrees and sweeps every 0.6, as fast as the head turns: a quarter of
/// the points.
const COARSE_ROBOT: &str = r#"
[[robot]]
name = "robot"

[[robot.sensor]]
name = "scanner"
kind = "laser3d"
mount_m = [0, 0, 1.0]
range_m = 50
noise_m = 0.01
resolution_deg = 1.5
field_of_view_deg = 270
turn_deg = [-180, 180]
turn_step_deg = 0.6
dark_range_m = 18

[[robot.sensor]]
name = "front"
kind = "laser2d"
mount_m = [0.5, 0, 0.42]
range_m = 32
noise_m = 0.015
resolution_deg = 0.5
field_of_view_deg = 180
"#;

/// The built-in world *simple* with a coarse scanner.
fn world(stage: &Stage) -> String {
    let simple = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../worlds/simple.toml")).unwrap();
    let path = stage.path("world.toml");
    fs::write(&path, simple + COARSE_ROBOT).unwrap();
    path.display().to_string()
}

/// What a coarse scanner needs: the area a point may stand for grows with its steps.
const SETTINGS: [&str; 4] =
    ["--set", "analysis.surface.area_max_m2=0.009", "--set", "planning.view.scanner.max_area_m2=0.009"];

fn explore(stage: &Stage, world: &str, out: &str, more: &[&str]) {
    stage.run_well(&[&["explore", world, "--quiet", "--out", out][..], &SETTINGS, more].concat());
}

fn number(out: &Path, key: &str) -> f64 {
    summary(out)[key].as_f64().unwrap_or_else(|| panic!("{key}: {}", summary(out)[key]))
}

#[test]
fn a_robot_explores_and_knows_where_it_was() {
    let stage = Stage::new();
    let world = world(&stage);
    explore(&stage, &world, "out", &["--max-scans", "4"]);
    let out = stage.path("out");
    let told = summary(&out);
    assert_eq!(
        (&told["stop_reason"], &told["scans"], &told["aligned"]),
        (&"limit_reached".into(), &4.into(), &4.into())
    );
    assert_eq!((&told["tipped"], &told["given_up"]), (&false.into(), &serde_json::json!([])));
    assert_eq!(
        (&told["lost_messages"], &told["restarts"], &told["copied_payload_bytes"]),
        (&0.into(), &0.into(), &0.into())
    );
    assert!(number(&out, "distance_m") > 6.0 && number(&out, "mission_s") > 4.0 * 12.0, "{told}");
    let errors = &told["errors"];
    assert_eq!(errors["n"], 4, "every aligned scan has a true pose");
    assert!(errors["ate_rmse_m"].as_f64().unwrap() < 0.3, "{errors}");
    // What the robot says of itself and the truth, which nobody steers by, go together.
    let (mut truth, mut told) = (Vec::new(), Vec::new());
    let mut reader = recording(&out);
    reader.for_each::<topics::RobotState>(|_, items| truth.extend(items.iter().map(|s| s.map_from_robot))).unwrap();
    reader.for_each::<topics::RobotPoses>(|_, items| told.extend(items.iter().map(|p| p.map_from_robot))).unwrap();
    let (truth, told) = (truth.last().unwrap(), told.last().unwrap());
    assert!((truth[3] - told[3]).hypot(truth[7] - told[7]) < 0.5, "{truth:?} {told:?}");
    for file in ["model.ply", "map.png", "report.html", "trajectory.tum"] {
        assert!(fs::metadata(out.join(file)).unwrap().len() > 100, "{file}");
    }
    let explained = stage.run_well(&["explain", "out"]).stdout;
    assert!(explained.contains("Scan 3") && explained.contains("Plan: strategy multi_criteria"), "{explained}");
}

#[test]
fn an_exploration_ends_by_itself_when_its_work_is_done() {
    let stage = Stage::new();
    let world = world(&stage);
    explore(&stage, &world, "out", &[]);
    let out = stage.path("out");
    let told = summary(&out);
    assert_eq!((&told["stop_reason"], &told["last_decision"]), (&"done".into(), &"done".into()), "{told}");
    assert_eq!((&told["unaligned"], &told["tipped"]), (&0.into(), &false.into()));
    // The source reached 94.1 % of its world of this name.
    assert!(number(&out, "coverage") > 0.941, "{told}");
    let errors = &told["errors"];
    assert!(errors["ate_rmse_m"].as_f64().unwrap() < 0.1 && errors["ate_rmse_deg"].as_f64().unwrap() < 0.5, "{errors}");
    let model = &told["model_error"];
    assert!(model["points"].as_u64().unwrap() > 1000 && model["median_m"].as_f64().unwrap() < 0.02, "{model}");
}

#[test]
fn without_a_command_the_robot_explores_the_world_simple() {
    let stage = Stage::new();
    let finished = stage.run_well(&["--set", "acquisition.max_scans=2"]);
    assert!(finished.stdout.contains("2 scans, 2 aligned"), "{}", finished.stdout);
    let out = stage.path("mirador-out");
    let told = summary(&out);
    assert_eq!((&told["title"], &told["scans"]), (&"Exploration of simple".into(), &2.into()), "{told}");
    assert!(number(&out, "distance_m") > 0.5, "it has driven: {told}");
    assert!(out.join("report.html").is_file() && out.join("map.png").is_file());
}

#[test]
fn the_same_seed_gives_the_same_exploration_and_another_another() {
    let stage = Stage::new();
    let world = world(&stage);
    explore(&stage, &world, "one", &["--max-scans", "3"]);
    explore(&stage, &world, "two", &["--max-scans", "3", "--set", "services.simulator.threads=1"]);
    assert_same_bits(&stage.path("one"), &stage.path("two"));
    assert_eq!(summary(&stage.path("one"))["stop_reason"], "limit_reached");
    assert_eq!(summary(&stage.path("one"))["scans"], 3);
    explore(&stage, &world, "other", &["--max-scans", "3", "--seed", "2"]);
    let read = |out: &str| fs::read(stage.path(out).join("model.ply")).unwrap();
    assert!(read("one") != read("other"), "the comparison can fail");
    // Its recording gives the same map and plans without a robot.
    let recorded = stage.path("one/run.mcap").display().to_string();
    stage.run_well(&["replay", &recorded, "--quiet", "--out", "replayed"]);
    let model = |out: &str| fs::read(stage.path(out).join("trajectory.tum")).unwrap();
    assert!(model("one") == model("replayed"), "the replayed trajectory differs");
}

#[test]
fn settings_before_the_command_and_behind_it_are_refused_as_one_of_them_would_be_lost() {
    let stage = Stage::new();
    let both = ["--set", "acquisition.max_scans=2", "explore", "--set", "acquisition.run_seed=3"];
    let finished = stage.run(&both);
    assert_eq!(finished.status.code(), Some(2), "{}", finished.stderr);
    assert!(
        finished.stderr.starts_with("error: --set") && finished.stderr.contains("behind the command"),
        "{}",
        finished.stderr
    );
}

#[test]
fn what_cannot_be_explored_is_refused_by_name() {
    let stage = Stage::new();
    let refused = |arguments: &[&str], words: &[&str]| {
        let finished = stage.run(arguments);
        assert_eq!(finished.status.code(), Some(2), "{arguments:?}: {}", finished.stderr);
        assert_eq!(finished.stderr.trim_end().lines().count(), 1, "{}", finished.stderr);
        for word in words {
            assert!(finished.stderr.contains(word), "{word:?} in {}", finished.stderr);
        }
        assert!(!stage.path("mirador-out").exists(), "nothing was begun");
    };
    refused(&["explore", "moon"], &["moon", "simple", "structured"]);
    refused(&["explore", "nowhere.toml"], &["nowhere.toml"]);
    refused(&["explore", "--strategy", "lottery"], &["lottery", "coverage_tour"]);
    refused(&["explore", "--weights", "1,2"], &["--weights", "four numbers"]);
    refused(&["explore", "--weights", "0,0,0,1"], &["weights", "at least one"]);
    refused(&["explore", "--weights", "-1,0,0,1"], &["weights.information", "0 to 1"]);
    let simple = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../worlds/simple.toml")).unwrap();
    let blind = format!(
        "{simple}\n[[robot]]\nname = \"mole\"\n[[robot.sensor]]\nname = \"front\"\nkind = \"laser1d\"\nmount_m = [0, 0, 1]\nrange_m = 9\n"
    );
    fs::write(stage.path("blind.toml"), blind).unwrap();
    refused(&["explore", "blind.toml"], &["mole", "laser3d"]);
    let (free, walled) = ("[start]\nx_m = -9.0\ny_m = -10.0", "[start]\nx_m = -8.0\ny_m = -3.0");
    assert!(simple.contains(free));
    let walled = simple.replace(free, walled);
    fs::write(stage.path("walled.toml"), walled).unwrap();
    refused(&["explore", "walled.toml"], &["walled.toml", "blocked"]);
}

/// Where a run's messages of a topic say something: simulated time [s] and what `say` makes of the item.
fn told<T: Topic<Meta = Envelope>, R>(out: &Path, say: impl Fn(&T::Item) -> R) -> Vec<(f64, R)> {
    let mut told = Vec::new();
    let collect = |meta: &Envelope, items: &[T::Item]| {
        told.extend(items.iter().map(|item| (meta.header.stamp_ns as f64 * 1e-9, say(item))));
    };
    recording(out).for_each::<T>(collect).unwrap();
    told
}

#[test]
fn a_sensor_that_falls_silent_or_babbles_on_the_way_stops_the_robot_until_it_is_well_again() {
    let stage = Stage::new();
    let world = world(&stage);
    let run = |out: &str, more: &[&str]| {
        explore(&stage, &world, out, &[&["--max-scans", "2"][..], more].concat());
        let out = stage.path(out);
        assert_eq!((&summary(&out)["aligned"], &summary(&out)["given_up"]), (&2.into(), &serde_json::json!([])));
        told::<topics::RobotState, f64>(&out, |state| state.linear)
    };
    let speeds = run("well", &[]);
    let is_driving = |seconds: &&[(f64, f64)]| seconds.iter().all(|(_, speed)| *speed > 0.3);
    let from = speeds.windows(40).find(is_driving).expect("two seconds of driving")[10].0;
    let faults = [
        ("planar_scan", 0, "the front laser is silent"),
        ("planar_scan", 40, "the front laser babbles"),
        ("imu", 0, "localisation is lost"),
        ("odometry", 0, "localisation is lost"),
    ];
    for (topic, repeats, words) in faults {
        let to = from + 2.5;
        let fault = format!("{{ topic = \"{topic}\", from_s = {from}, to_s = {to}, repeats = {repeats} }}");
        let speeds = run("ill", &["--set", &format!("simulator.faults=[{fault}]")]);
        let within = |from: f64, to: f64| speeds.iter().filter(move |(time, _)| (from..to).contains(time));
        let said = told::<topics::NavigationStatus, String>(&stage.path("ill"), |status| {
            mirador_ipc_schema::text::unpack(&status.reason).to_owned()
        });
        let first = said.iter().find(|(_, reason)| reason == words).map(|(time, _)| time - from);
        assert!(first.is_some_and(|after| (0.0..1.0).contains(&after)), "{topic} {repeats}: {first:?} {said:?}");
        let stands = within(from + 1.5, to).all(|(_, speed)| speed.abs() < 0.05);
        assert!(stands, "{topic} {repeats}: {:?}", within(from, to).collect::<Vec<_>>());
        assert!(within(to, to + 3.0).any(|(_, speed)| *speed > 0.3), "{topic} {repeats}: it goes on");
    }
}
