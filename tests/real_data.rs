//! Recorded scans of real sensors through the whole graph, and what comes out of it.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::io::BufReader;
use std::path::Path;

use mirador_core::formats::{read_cloud, read_poses};
use mirador_core::geometry::rotation_angle;
use mirador_ipc_schema::topics;
use nalgebra::Vector3;
use serde_json::Value;
use support::outputs::{Model, poses, recording};
use support::{Stage, data, summary};

/// Every output is there and says the same as the summary.
fn check_outputs(out: &Path, summary: &Value) {
    check_model(out, summary);
    check_trajectory(out, summary);
    check_map(out);
    check_report(out, summary);
    check_recording(out, summary);
    for stage in ["surface", "alignment", "analysis", "map", "planning", "end_to_end"] {
        assert_eq!(summary["latency_ms"][stage]["n"], summary["scans"], "{stage}");
    }
    assert_eq!((&summary["copied_payload_bytes"], &summary["lost_messages"]), (&0.into(), &0.into()));
    assert_eq!((&summary["undelivered_messages"], &summary["restarts"]), (&0.into(), &0.into()));
    assert_eq!(summary["recording_complete"], true);
    assert_eq!(summary["stop_reason"], "input_ended");
    assert!(summary["stop_reason_text"].as_str().unwrap().contains("all scans"), "{}", summary["stop_reason_text"]);
    for key in ["last_decision", "last_decision_text"] {
        assert!(summary[key].as_str().is_some_and(|words| !words.is_empty()), "{key}: {}", summary[key]);
    }
}

fn check_model(out: &Path, summary: &Value) {
    let points = summary["points"].as_u64().unwrap() as usize;
    let cloud = read_cloud(&out.join("model.ply")).unwrap();
    assert_eq!(cloud.points.len(), points, "points of the model and of the summary");
    assert!(cloud.points.iter().all(mirador_core::scan::Point::is_return));
    let model = Model::read(out);
    assert_eq!(model.points.len(), points);
    let scored = model.points.iter().filter(|p| p.quality >= 0.0).count();
    assert!(model.points.iter().all(|p| p.quality == -1.0 || (0.0..=1.0).contains(&p.quality)));
    assert!(scored * 10 > points * 8, "{scored} of {points} points are scored");
    assert!(model.points.iter().all(|p| p.aligned <= 1 && u64::from(p.scan) < summary["scans"].as_u64().unwrap()));
}

fn check_trajectory(out: &Path, summary: &Value) {
    let path = out.join("trajectory.tum");
    let expected = poses(summary);
    let read = read_poses(&path).unwrap();
    assert_eq!(read.len(), expected.len());
    for (k, (line, pose)) in read.iter().zip(&expected).enumerate() {
        let error = pose.inverse() * line.map_from_scanner;
        assert!(error.translation.vector.norm() < 1e-6 && rotation_angle(&error) < 1e-6, "pose {k}: {error:?}");
        let stamp = summary["poses"][k]["stamp_ns"].as_f64().unwrap() * 1e-9;
        assert!((line.stamp_s.unwrap() - stamp).abs() < 1e-6, "time of pose {k}");
    }
}

fn check_map(out: &Path) {
    let file = fs::File::open(out.join("map.png")).unwrap();
    let mut reader = png::Decoder::new(BufReader::new(file)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert!(info.width > 50 && info.height > 50, "{} x {}", info.width, info.height);
    let first = pixels[0];
    assert!(pixels.iter().any(|byte| *byte != first), "a picture of one colour shows nothing");
}

fn check_report(out: &Path, summary: &Value) {
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    for outside in ["src=\"http", "src=\"//", "src='", "href=", "<script", "<link", "<iframe", "@import", "url("] {
        assert!(!page.contains(outside), "the report refers to something outside: {outside}");
    }
    assert!(page.contains("src=\"data:image/png;base64,"));
    assert!(page.contains("input_ended") && page.contains(summary["last_decision"].as_str().unwrap()));
}

fn check_recording(out: &Path, summary: &Value) {
    let mut reader = recording(out);
    let scans = summary["scans"].as_u64().unwrap() as usize;
    assert!(reader.is_complete());
    assert_eq!(reader.scan_index(), (0..scans as u32).collect::<Vec<_>>());
    let counts = [
        ("scan", reader.count::<topics::Scan>()),
        ("alignment", reader.count::<topics::Alignment>()),
        ("scored_scan", reader.count::<topics::ScoredScan>()),
        ("zones", reader.count::<topics::Zones>()),
        ("view_plan", reader.count::<topics::ViewPlan>()),
        ("path", reader.count::<topics::Path>()),
    ];
    for (topic, count) in counts {
        assert_eq!(count, scans, "{topic}");
    }
    assert!(reader.count::<topics::InformationMap>() >= 1);
    assert_eq!(reader.count::<topics::Clock>(), scans + 1, "one a scan and one for the end");
    assert!(reader.count::<topics::ServiceHealth>() >= 5);
    let mut scored = Vec::new();
    reader.for_each_meta::<topics::ScoredScan>(|_, items| scored.push(items)).unwrap();
    let mut cells = Vec::new();
    reader.for_each_meta::<topics::Scan>(|_, items| cells.push(items)).unwrap();
    assert_eq!(scored, cells, "a score for every cell");
}

fn check_explain(stage: &Stage, out: &str, scans: u32) {
    let all = stage.run_well(&["explain", out]).stdout;
    for scan in 0..scans {
        assert!(all.contains(&format!("Scan {scan}\n")), "scan {scan}");
    }
    assert!(all.contains("the first scan, it defines the map") && all.contains("Plan: strategy"), "{all}");
    assert!(all.contains(&format!("The input ended after {scans} scans")), "{all}");
    let one = stage.run_well(&["explain", out, "1"]).stdout;
    assert!(one.starts_with("Scan 1\n") && !one.contains("Scan 0") && !one.contains("Scan 2"), "{one}");
    assert!(one.contains("accepted against scan 0 by gicp") && one.contains("hypothesis 0"), "{one}");
    let missing = stage.run(&["explain", out, "999"]);
    assert!(!missing.status.success() && missing.stdout.is_empty());
    let said = missing.stderr.trim_end();
    assert!(said.lines().count() == 1 && said.contains("no scan 999"), "{said}");
    assert!(said.contains(&format!("{scans} scans from 0 to {}", scans - 1)), "{said}");
}

#[test]
fn the_ordered_scans_of_3dtk_align_where_3dtk_aligns_them() {
    let Some(scans) = data("real_data", "3dtk_dat") else { return };
    let stage = Stage::new();
    stage.run_well(&["replay", &scans.display().to_string(), "--grid", "226x360", "--out", "out"]);
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&3.into(), &3.into()));
    assert!(summary["errors"].is_null() && summary["coverage"].is_null(), "there is no truth");

    // 3DTK's own result for the same scans, from (x right, y up, z ahead) in centimetres to ours.
    let from_3dtk = |[x, y, z]: [f64; 3]| Vector3::new(z, -x, y) / 100.0;
    let expected = [[3.03871, -3.45086, 143.647], [-1.56494, -16.3606, 317.526]].map(from_3dtk);
    let found = poses(&summary);
    for (pose, expected) in found[1..].iter().zip(expected) {
        let relative = found[0].inverse() * pose;
        let error = (relative.translation.vector - expected).norm();
        assert!(error < 0.3, "{error} m: {relative:?}");
    }

    // A code at 32.77 m where nothing came back, and returns from the robot itself.
    let mut reader = recording(&out);
    let mut seen = 0;
    reader
        .for_each::<topics::Scan>(|meta, points| {
            assert_eq!((meta.rows, meta.cols, points.len()), (226, 360, 226 * 360));
            assert_eq!(meta.returns + meta.out_of_range, 226 * 360);
            assert!((3_000..3_600).contains(&meta.out_of_range), "{}", meta.out_of_range);
            let ranges = points.iter().filter(|p| p.x.is_finite()).map(|p| p.x.hypot(p.y).hypot(p.z));
            let (least, most) = ranges.fold((f32::MAX, 0.0_f32), |(a, b), r| (a.min(r), b.max(r)));
            assert!(least >= 0.25 && most < 32.7, "{least} to {most} m");
            seen += u64::from(meta.returns);
        })
        .unwrap();
    assert_eq!(summary["points"].as_u64(), Some(seen));
    check_outputs(&out, &summary);
    check_explain(&stage, "out", 3);
}

#[test]
fn a_walk_with_a_handheld_scanner_follows_its_true_path() {
    let Some(scans) = data("real_data", "handheld") else { return };
    let stage = Stage::new();
    let path = scans.display().to_string();
    stage.run_well(&["replay", &path, "--poses", "odometry.tum", "--truth", "poses.tum", "--out", "out"]);
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&45.into(), &45.into()));
    let error = |key: &str| summary["errors"][key].as_f64().unwrap();
    assert!(error("ate_rmse_m") <= 0.15 && error("ate_rmse_deg") <= 0.7, "{}", summary["errors"]);
    assert_eq!(summary["errors"]["n"], 45);
    assert!(summary["coverage"].is_null(), "nobody knows what could be reached");
    let distance = summary["distance_m"].as_f64().unwrap();
    assert!((60.0..90.0).contains(&distance), "{distance} m of 74 m");
    check_outputs(&out, &summary);
    check_explain(&stage, "out", 45);
}

#[test]
fn a_single_file_is_a_run_of_one_scan() {
    let Some(file) = data("real_data", "3dtk_dat/scan001.3d") else { return };
    let stage = Stage::new();
    stage.run_well(&["replay", &file.display().to_string(), "--grid", "226x360", "--out", "out"]);
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&1.into(), &1.into()));
    assert_eq!(summary["poses"][0]["status"], "first");
    check_outputs(&out, &summary);
}

/// A folder of the stage with some of the data's files.
fn folder_of(stage: &Stage, from: &Path, files: &[&str]) -> String {
    let folder = stage.path("scans");
    fs::create_dir(&folder).unwrap();
    for file in files {
        fs::copy(from.join(file), folder.join(file)).unwrap();
    }
    folder.display().to_string()
}

/// Runs two scans through, all of which align, and gives the distance between them [m].
fn pair(stage: &Stage, arguments: &[&str]) -> f64 {
    stage.run_well(&[&["replay"], arguments, &["--out", "out"]].concat());
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&2.into(), &2.into()), "{}", summary["poses"]);
    check_outputs(&out, &summary);
    let found = poses(&summary);
    (found[0].inverse() * found[1]).translation.vector.norm()
}

#[test]
fn a_pair_of_packed_vtk_files_runs_through() {
    let Some(folder) = data("real_data", "libpointmatcher") else { return };
    let stage = Stage::new();
    let scans = folder_of(&stage, &folder, &["cloud_0.vtk.gz", "cloud_1.vtk.gz"]);
    let found = pair(&stage, &[&scans]);
    assert!((0.3..0.9).contains(&found), "{found} m");
}

#[test]
fn a_pair_of_packed_csv_files_aligns_as_its_authors_say() {
    let Some(folder) = data("real_data", "libpointmatcher") else { return };
    let stage = Stage::new();
    let scans = folder_of(&stage, &folder, &["car_cloud400.csv.gz", "car_cloud401.csv.gz", "carCloudList.csv"]);
    let truth: f64 = Vector3::new(0.0614127, 0.191433, -0.0338571).norm();
    let found = pair(&stage, &[&scans]);
    assert!((found - truth).abs() < 0.1, "{found} m, {truth} m by its authors");
}

#[test]
fn a_pair_of_ply_files_aligns_as_its_authors_say() {
    let Some(folder) = data("real_data", "small_gicp") else { return };
    let stage = Stage::new();
    // Target first: the other one is aligned to it.
    let scans = stage.path("scans");
    fs::create_dir(&scans).unwrap();
    fs::copy(folder.join("target.ply"), scans.join("0.ply")).unwrap();
    fs::copy(folder.join("source.ply"), scans.join("1.ply")).unwrap();
    let truth: f64 = Vector3::new(0.488882, 0.121214, -0.0253342).norm();
    let found = pair(&stage, &[&scans.display().to_string()]);
    assert!((found - truth).abs() < 0.1, "{found} m, {truth} m by its authors");
}

#[test]
fn the_first_scans_of_a_drive_align_without_any_prior() {
    let Some(folder) = data("real_data", "kitti00_first6") else { return };
    let stage = Stage::new();
    let found = pair(&stage, &[&folder.display().to_string(), "--max-scans", "2"]);
    assert!((found - 0.689).abs() < 0.1, "{found} m, 0.689 m by every method");
}

#[test]
fn a_run_in_real_time_begins_when_everyone_is_there_and_ends_when_everyone_has_finished() {
    let Some(scans) = data("real_data", "handheld") else { return };
    let stage = Stage::new();
    let path = scans.display().to_string();
    // Two seconds between scans: 0.2 s a scan is time enough.
    stage.run_well(&["replay", &path, "--poses", "odometry.tum", "--max-scans", "10", "--speed", "10", "--out", "out"]);
    let summary = summary(&stage.path("out"));
    assert_eq!((&summary["scans"], &summary["aligned"]), (&10.into(), &10.into()));
    assert_eq!(summary["stop_reason"], "input_ended");
    for stage_name in ["surface", "alignment", "analysis", "map", "planning", "end_to_end"] {
        assert_eq!(summary["latency_ms"][stage_name]["n"], 10, "{stage_name}");
    }
}

#[test]
fn scans_that_come_faster_than_they_can_be_worked_on_wait_and_are_not_lost() {
    let Some(scans) = data("real_data", "handheld") else { return };
    let stage = Stage::new();
    let path = scans.display().to_string();
    let replay = ["replay", &path, "--poses", "odometry.tum", "--max-scans", "15", "--speed", "1000", "--out", "out"];
    stage.run_well(&replay);
    let summary = summary(&stage.path("out"));
    assert_eq!((&summary["scans"], &summary["aligned"]), (&15.into(), &15.into()));
    assert_eq!(summary["latency_ms"]["end_to_end"]["n"], 15);
    // Acquisition may miss reports of health, which only ever repeat themselves.
    for service in summary["services"].as_array().unwrap().iter().filter(|s| s["name"] != "acquisition") {
        assert_eq!(service["lost_messages"], 0, "{service}");
    }
}
