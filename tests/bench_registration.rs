//! `mirador bench registration` as users run it, small. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;

use mirador_core::geometry::{Pose, rotation_angle, rows_from_pose};
use mirador_core::registration::{Limits, RegistrationConfig, Registry};
use mirador_core::scan::{Point, ScanView};
use mirador_core::simulation::{CompiledScene, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene};
use serde_json::Value;
use support::Stage;

/// Writes a pair of small scans of the scene `simple`, 0.6 m and 3 degrees apart, with the true pose.
fn write_pair(stage: &Stage) -> Pair {
    let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let config = ScannerConfig { beams: 136, beam_step_deg: 2.0, sweeps: 180, ..ScannerConfig::default() };
    let scanner = Scanner::new(config).unwrap();
    let pose = |x: f64, yaw: f64| scene.level_scanner_pose(&ScanPose { x, y: -10.0, yaw }, 1.0).unwrap();
    let poses: [Pose; 2] = [pose(-9.0, 0.3), pose(-8.4, 0.35)];
    fs::create_dir(stage.path("pair")).unwrap();
    let mut scans = Vec::new();
    for (k, name) in ["target", "source"].into_iter().enumerate() {
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        scanner.scan(&scene, &poses[k], ScanSeed { seed: 1, scan: k as u64 }, 1, &mut points, None).unwrap();
        let bytes: Vec<u8> = points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes).collect();
        fs::write(stage.path(&format!("pair/{name}.xyz32.bin")), bytes).unwrap();
        scans.push(points.into_iter().filter(Point::is_return).collect());
    }
    let rows = rows_from_pose(&(poses[0].inverse() * poses[1]));
    let numbers: Vec<String> = rows.iter().map(ToString::to_string).collect();
    fs::write(stage.path("pair/target_from_source.txt"), numbers.join(" ")).unwrap();
    Pair { scans, truth: poses[0].inverse() * poses[1] }
}

/// Target and source, returns only, and the pose between them.
struct Pair {
    scans: Vec<Vec<Point>>,
    truth: Pose,
}

/// The errors of a method called directly: translation [m] and rotation [deg].
fn errors_of(method: &str, pair: &Pair) -> (f64, f64) {
    let mut registration = Registry::default().create(method, &RegistrationConfig::default()).unwrap();
    let [target, source] = [0, 1].map(|k| registration.prepare(ScanView::unordered(&pair.scans[k])).unwrap());
    let result = registration.align(&*target, &*source, &Pose::identity(), &Limits::default()).unwrap();
    let error = pair.truth.inverse() * result.target_from_source;
    (error.translation.vector.norm(), rotation_angle(&error).to_degrees())
}

/// Every method of ours at one and two threads, from a small pair to the rows in the file.
#[test]
fn every_method_has_its_rows_with_time_and_error() {
    let stage = Stage::new();
    let pair = write_pair(&stage);
    let finished = stage.run_well(&[
        "bench",
        "registration",
        "--data",
        "pair",
        "--cases",
        "pair",
        "--repetitions",
        "1",
        "--no-peers",
        "--json",
        "r.json",
    ]);
    assert!(finished.stderr.contains("pair pair: "), "progress: {}", finished.stderr);
    let report: Value = serde_json::from_str(&fs::read_to_string(stage.path("r.json")).unwrap()).unwrap();
    assert_eq!(report["bench"], "registration");
    assert!(report["machine"]["cores"].as_u64().unwrap() >= 1);
    let rows = report["rows"].as_array().unwrap();
    let registry = Registry::default();
    assert_eq!(rows.len(), 2 * registry.names().count(), "without peers there is nothing to compare with");
    for method in registry.names() {
        assert!(finished.stdout.contains(method), "{}", finished.stdout);
        for threads in [1, 2] {
            let of = |row: &&Value| row["params"]["method"] == method && row["params"]["threads"] == threads;
            let row = rows.iter().find(of).unwrap();
            assert_eq!((&row["name"], &row["unit"], &row["n"]), (&"pair".into(), &"ms".into(), &1.into()));
            assert_eq!((&row["params"]["data"], &row["params"]["peer"]), (&"pair".into(), &false.into()));
            assert_eq!(row["provenance"], "measured");
            let number = |key: &str| row[key].as_f64().unwrap();
            let (metres, degrees) = errors_of(method, &pair);
            assert!((number("translation_error_m") - metres).abs() < 1e-9, "{metres}: {row}");
            assert!((number("rotation_error_deg") - degrees).abs() < 1e-7, "{degrees}: {row}");
            // Point to point slides on open ground, whose rings move along with the scanner; planes do not.
            assert!(method != "point_to_plane" || (metres < 0.05 && degrees < 0.5), "{row}");
            assert!(number("iterations") >= 1.0 && number("overlap") > 0.5, "{row}");
            let phases = ["prepare_target", "prepare_source", "align"];
            let sum: f64 = phases.iter().map(|phase| row["parts"][phase].as_f64().unwrap()).sum();
            assert!((sum - number("p50")).abs() < 1e-6, "the parts are all there is: {row}");
        }
    }
}

/// Four small scans of the scene `simple` on a line, 0.6 m apart, with their poses.
fn write_data_set(stage: &Stage) {
    let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let config = ScannerConfig { beams: 136, beam_step_deg: 2.0, sweeps: 180, ..ScannerConfig::default() };
    let scanner = Scanner::new(config).unwrap();
    fs::create_dir(stage.path("drive")).unwrap();
    let mut lines = String::new();
    for k in 0..4_u32 {
        let place = ScanPose { x: -9.0 + 0.6 * f64::from(k), y: -10.0, yaw: 0.3 };
        let pose = scene.level_scanner_pose(&place, 1.0).unwrap();
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        scanner.scan(&scene, &pose, ScanSeed { seed: 1, scan: k.into() }, 1, &mut points, None).unwrap();
        let returns = points.iter().filter(|p| p.is_return()).flat_map(|p| [p.x, p.y, p.z]);
        let bytes: Vec<u8> = returns.flat_map(f32::to_le_bytes).collect();
        fs::write(stage.path(&format!("drive/scan{k}.xyz32.bin")), bytes).unwrap();
        let (t, q) = (pose.translation, pose.rotation.coords);
        lines += &format!("{k} {} {} {} {} {} {} {}\n", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    fs::write(stage.path("drive/poses.tum"), lines).unwrap();
}

#[test]
fn all_pairs_of_a_folder_of_scans_are_compared_in_table_file_and_page() {
    let stage = Stage::new();
    write_data_set(&stage);
    let methods = ["point_to_plane", "gicp"];
    let arguments = ["bench", "registration", "--data", "drive", "--methods", "point_to_plane,gicp"];
    let more = ["--max-distance", "1.5", "--json", "r.json", "--html", "r.html"];
    let finished = stage.run_well(&[&arguments[..], &more].concat());
    assert!(finished.stderr.contains("4 scans, 5 pairs"), "0.6 and 1.2 m apart: {}", finished.stderr);
    let report: Value = serde_json::from_str(&fs::read_to_string(stage.path("r.json")).unwrap()).unwrap();
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), methods.len());
    for (row, method) in rows.iter().zip(methods) {
        assert_eq!(
            (&row["name"], &row["params"]["method"], &row["n"]),
            (&"all_pairs".into(), &method.into(), &5.into())
        );
        // Planes hold on uneven ground beside a house.
        assert!(row["success_rate"].as_f64().unwrap() >= 0.8, "{row}");
        let each = row["each"].as_array().unwrap();
        assert!(each.len() == 5 && each.iter().all(|a| a["source"].as_u64() > a["target"].as_u64()), "{row}");
        assert!(finished.stdout.contains(method) && !finished.stdout.contains("each"), "{}", finished.stdout);
    }
    let page = fs::read_to_string(stage.path("r.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 4, "four plots");
    assert!(methods.iter().all(|method| page.contains(method)) && !page.contains("NaN"));
}

#[test]
fn a_folder_of_scans_without_truth_or_near_pairs_says_what_would_help() {
    let stage = Stage::new();
    write_data_set(&stage);
    let refused = |option: &[&str]| {
        let finished =
            stage.run(&[&["bench", "registration", "--data", "drive", "--methods", "gicp"], option].concat());
        assert_eq!(finished.status.code(), Some(2), "{option:?}: {}", finished.stderr);
        finished.stderr
    };
    assert!(refused(&["--max-distance", "0.1"]).contains("--max-distance"));
    assert!(refused(&["--truth", "nowhere.tum"]).contains("nowhere.tum"));
    assert!(refused(&["--success-m", "0"]).contains("success-m"));
    assert!(refused(&["--repetitions", "3"]).contains("--repetitions"));
    fs::write(stage.path("drive/short.tum"), "0 0 0 0 0 0 0 1\n").unwrap();
    assert!(refused(&["--truth", "short.tum"]).contains("1 poses for 4 scans"));
    fs::remove_file(stage.path("drive/poses.tum")).unwrap();
    let without = refused(&[]);
    assert!(without.contains("truth") && without.contains("poses.tum"), "{without}");
}

#[test]
fn a_python_without_peers_leaves_them_out_and_says_so() {
    let stage = Stage::new();
    write_pair(&stage);
    let arguments = ["bench", "registration", "--data", "pair", "--cases", "pair", "--repetitions", "1"];
    let named = ["--methods", "point_to_plane", "--python", "/no/such/python"];
    let finished = stage.run_well(&[&arguments[..], &named].concat());
    assert!(finished.stderr.contains("small_gicp is left out"), "{}", finished.stderr);
    assert!(finished.stderr.contains("/no/such/python"), "{}", finished.stderr);
    assert!(!finished.stdout.contains("point_to_point"), "{}", finished.stdout);
}

#[test]
fn wrong_options_are_refused_with_what_would_be_right() {
    let stage = Stage::new();
    let refused = |option: &[&str]| {
        let finished = stage.run(&[&["bench", "registration", "--no-peers"], option].concat());
        assert_eq!(finished.status.code(), Some(2), "{option:?}: {}", finished.stderr);
        finished.stderr
    };
    assert!(refused(&["--methods", "pears"]).contains("point_to_plane"));
    assert!(refused(&["--cases", "pears"]).contains("pair, sequence"));
    assert!(refused(&["--repetitions", "0"]).contains("repetitions"));
    assert!(refused(&["--data", "no-such-folder"]).contains("no-such-folder"));
}
