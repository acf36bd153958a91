//! Scanners in motion: real recordings as frames of the odometry in the running graph, its keyframes in the same map as
//! scans taken standing, and what happens when it is lost or killed.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;

use mirador_core::formats::read_cloud;
use mirador_core::geometry::{Pose, Twist, pose_from_rows, rotation_angle};
use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, Hypothesis, PAIR_ACCEPTED, PAIR_LOOP,
};
use mirador_ipc_schema::{ScanId, text, topics};
use nalgebra::{Point3, Vector3};
use support::answerer::{self, BEHAVIOUR};
use support::moving;
use support::observer::{Observer, kill_9};
use support::outputs::{Model, poses, recording};
use support::{Stage, data, finish, summary};

/// Arguments of a replay in continuous mode into `out`.
fn replay(scans: &Path, out: &str, more: &[&str]) -> Vec<String> {
    let path = scans.display().to_string();
    let first = ["replay", &path, "--quiet", "--out", out, "--set", "alignment.mode=continuous"];
    first.iter().chain(more).map(|argument| (*argument).to_owned()).collect()
}

/// Every alignment of a run with its hypotheses.
fn alignments(out: &Path) -> Vec<(AlignmentMeta, Vec<Hypothesis>)> {
    let mut found = Vec::new();
    recording(out).for_each::<topics::Alignment>(|meta, items| found.push((*meta, items.to_vec()))).unwrap();
    found
}

/// The last pose that was published of every scan, corrections included.
fn last_poses(out: &Path) -> BTreeMap<u32, Pose> {
    let of = |rows: &[f64; 16]| pose_from_rows(rows).unwrap();
    let mut last: BTreeMap<u32, Pose> =
        alignments(out).iter().map(|(meta, _)| (meta.header.scan(), of(&meta.map_from_scanner))).collect();
    recording(out)
        .for_each::<topics::PoseCorrections>(|_, items| {
            last.extend(items.iter().map(|c| (ScanId::unpack(c.id).scan, of(&c.map_from_scanner))));
        })
        .unwrap();
    last
}

#[test]
fn the_first_scans_of_a_drive_are_followed_to_where_all_methods_agree() {
    let Some(scans) = data("continuous", "kitti00_first6") else { return };
    let stage = Stage::new();
    stage.run_well(&replay(&scans, "out", &[]));
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&6.into(), &6.into()), "{}", summary["poses"]);
    let found = poses(&summary);
    let motion = found[0].inverse() * found[1];
    let error = (motion.translation.vector - Vector3::new(0.689, 0.004, 0.008)).norm();
    assert!(error < 0.02, "{error} m: {motion}");
    let alignments = alignments(&out);
    let statuses: Vec<u32> = alignments.iter().map(|(meta, _)| meta.status).collect();
    assert_eq!(statuses[0], ALIGNMENT_FIRST);
    assert!(statuses[1..].iter().all(|status| *status == ALIGNMENT_ACCEPTED), "{statuses:?}");
    for (meta, hypotheses) in &alignments {
        assert_eq!(text::unpack(&meta.method), "odometry");
        assert!(hypotheses.last().unwrap().accepted == 1 && meta.overlap > 0.3, "overlap {}", meta.overlap);
        assert!(meta.status == ALIGNMENT_FIRST || meta.covariance[0] > 0.0);
    }
    let keyframes: Vec<u32> = alignments.iter().map(|(meta, _)| meta.is_keyframe).collect();
    assert!(keyframes[0] == 1 && keyframes.contains(&0), "{keyframes:?}: some frames are none");
    assert_eq!(Model::read(&out).points.len() as u64, summary["points"].as_u64().unwrap());
    let told = stage.run_well(&["explain", "out", "1"]).stdout;
    assert!(told.contains("accepted against scan 0 by odometry"), "{told}");
}

#[test]
fn a_walk_without_any_odometry_is_followed_its_loops_closed_and_every_output_agrees() {
    let Some(scans) = data("continuous", "handheld") else { return };
    let stage = Stage::new();
    stage.run_well(&replay(
        &scans,
        "out",
        &["--truth", "poses.tum", "--set", "alignment.global.correction_threshold_m=0.001"],
    ));
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&45.into(), &45.into()));
    let error = |key: &str| summary["errors"][key].as_f64().unwrap();
    assert!(error("ate_rmse_m") < 0.2 && error("max_m") < 0.3 && error("ate_rmse_deg") < 0.5, "{}", summary["errors"]);
    let (mut loops, mut corrected) = (0, 0);
    recording(&out)
        .for_each::<topics::LoopClosing>(|meta, pairs| {
            loops += pairs.iter().filter(|p| p.kind == PAIR_LOOP && p.status == PAIR_ACCEPTED).count();
            corrected += meta.corrections;
        })
        .unwrap();
    assert!(loops > 0 && corrected > 0, "{loops} loops, {corrected} corrections");
    let (expected, found) = (last_poses(&out), poses(&summary));
    for (scan, pose) in found.iter().enumerate() {
        let error = expected[&(scan as u32)].inverse() * pose;
        assert!(error.translation.vector.norm() < 1e-9 && rotation_angle(&error) < 1e-9, "scan {scan}");
    }
    assert_eq!(summary["recording_complete"], true);
    assert_eq!((&summary["lost_messages"], &summary["copied_payload_bytes"]), (&0.into(), &0.into()));
}

#[test]
fn the_answering_process() {
    answerer::answer_if_asked();
}

#[test]
fn loops_of_a_walk_are_closed_by_a_foreign_process_that_is_told_which_keyframes() {
    let Some(scans) = data("continuous", "handheld") else { return };
    let stage = Stage::new();
    let command = answerer::logging_command();
    let settings = ["alignment.registration=external", "alignment.external.deadline_ms=60000", &command];
    let settings: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    let mut arguments = replay(&scans, "out", &["--truth", "poses.tum"]);
    arguments.extend(settings.iter().map(|argument| (*argument).to_owned()));
    let mut command = stage.mirador(&arguments);
    let child = command.env(BEHAVIOUR, "honest").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let finished = finish(child);
    let out = stage.path("out");
    let log = |service: &str| fs::read_to_string(out.join(format!("logs/{service}.log"))).unwrap_or_default();
    assert_eq!(finished.status.code(), Some(0), "{}\n{}", finished.stderr, log("alignment"));
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&45.into(), &45.into()));
    assert!(summary["errors"]["ate_rmse_m"].as_f64().unwrap() < 0.2, "{}", summary["errors"]);
    let registration = &summary["registration"];
    assert!(registration["answered"].as_u64().unwrap() > 0, "{registration}");
    assert_eq!(registration["answered"], registration["questions"], "{registration}");
    // The pairs that were asked for are those that were tried.
    let mut tried = Vec::new();
    let scan = |id: u64| ScanId::unpack(id).scan;
    recording(&out)
        .for_each::<topics::LoopClosing>(|_, pairs| {
            tried.extend(pairs.iter().map(|pair| (scan(pair.target_id), scan(pair.source_id))));
        })
        .unwrap();
    let requests = answerer::requests(&log("registration"));
    let asked: Vec<(u32, u32)> = requests.iter().map(|(target, (source, ..))| (*target, *source as u32)).collect();
    assert!(!asked.is_empty() && asked.iter().all(|pair| tried.contains(pair)), "{asked:?} of {tried:?}");
    stage.assert_nothing_left();
}

/// A folder with scans of several recordings, in this order.
fn folder(stage: &Stage, files: &[std::path::PathBuf]) -> std::path::PathBuf {
    let folder = stage.path("scans");
    fs::create_dir(&folder).unwrap();
    for (number, file) in files.iter().enumerate() {
        fs::copy(file, folder.join(format!("{number:06}.xyz32.bin"))).unwrap();
    }
    folder
}

fn scan_files(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.to_string_lossy().ends_with(".xyz32.bin"));
    files.sort();
    files
}

#[test]
fn a_lost_scanner_says_so_and_is_found_again_among_the_keyframes() {
    let Some(walk) = data("continuous", "handheld") else { return };
    let Some(street) = data("continuous", "kitti00_first6") else { return };
    let stage = Stage::new();
    let (walk, street) = (scan_files(&walk), scan_files(&street));
    // Three scans of elsewhere; then a place of long before, out of reach of the odometry's own search, from a pose that
    // no keyframe has.
    let files = [&walk[..12], &walk[13..36], &street[..3], &walk[12..16]].concat();
    stage.run_well(&replay(&folder(&stage, &files), "out", &[]));
    let out = stage.path("out");
    let alignments = alignments(&out);
    let status = |scan: usize| alignments[scan].0.status;
    assert!((35..38).all(|scan| status(scan) == ALIGNMENT_REJECTED), "the scans of elsewhere");
    let reason = text::unpack(&alignments[36].0.reason);
    assert!(reason.starts_with("lost: ") && reason.contains("is needed"), "{reason}");
    let found = (38..40).find(|scan| status(*scan) == ALIGNMENT_ACCEPTED).expect("found again at once or at the next");
    let how = alignments[found].1.last().unwrap();
    assert_eq!(text::unpack(&how.origin), "relocalisation at a keyframe");
    assert!((found..42).all(|scan| status(scan) == ALIGNMENT_ACCEPTED));
    let last = last_poses(&out);
    // Scans 13 to 15 of the walk came before, as numbers 12 to 14, and come again as 39 to 41.
    for scan in 39..42 {
        let error = last[&(scan - 27)].inverse() * last[&scan];
        assert!(error.translation.vector.norm() < 0.1 && rotation_angle(&error) < 0.02, "scan {scan}: {error}");
    }
    assert!(stage.run_well(&["explain", "out", "36"]).stdout.contains("NOT ALIGNED by odometry: lost"));
}

#[test]
fn a_drive_whose_points_carry_times_is_deskewed_in_its_poses_and_in_the_model() {
    let stage = Stage::new();
    let recording = stage.path("drive.mcap");
    let truth = moving::record(&recording, 14);
    stage.run_well(&replay(&recording, "out", &[]));
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&14.into(), &14.into()), "{}", summary["poses"]);
    // The map begins at the end of the first scan.
    let map_from_world = moving::map_from_scanner(1.0).inverse();
    for (scan, pose) in poses(&summary).iter().enumerate() {
        let error = (map_from_world * moving::map_from_scanner(scan as f64 + 1.0)).inverse() * pose;
        let metres = error.translation.vector.norm();
        assert!(metres < 0.05 && rotation_angle(&error) < 0.002, "scan {scan}: {metres} m");
    }
    for (meta, _) in &alignments(&out)[1..] {
        let motion = Twist::from(meta.scan_motion);
        assert!((motion - moving::motion()).norm() < 0.03, "{motion}");
    }
    // Every point of the model is where it was hit; as it came, a point is off by up to a metre. Only the first scan,
    // whose motion nobody knew when it was published, is as it came.
    let model = read_cloud(&out.join("model.ply")).unwrap().points;
    let expected: Vec<_> = truth.iter().flatten().map(|place| map_from_world * place).collect();
    assert_eq!(model.len(), expected.len());
    let worst = model.iter().zip(&expected).skip(truth[0].len());
    let worst = worst.map(|(point, place)| (place.cast::<f32>() - Point3::new(point.x, point.y, point.z)).norm());
    let worst = worst.fold(0.0, f32::max);
    assert!(worst < 0.15, "{worst} m");
}

#[test]
fn a_killed_alignment_goes_on_in_continuous_mode_with_the_same_bits() {
    let Some(scans) = data("continuous", "handheld") else { return };
    let stage = Stage::new();
    let more = ["--max-scans", "28", "--set", "alignment.global.correction_threshold_m=0.001"];
    stage.run_well(&replay(&scans, "undisturbed", &more));
    let child =
        stage.mirador(&replay(&scans, "out", &more)).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    let mut dead = Vec::new();
    // Before the first snapshot of the odometry, and after it.
    for (witness, scans) in [("alignment", 7), ("planning", 19), ("analysis", 25)] {
        observer.until(&format!("{witness} has finished {scans} scans"), |seen| {
            let alive = seen.get("alignment").is_some_and(|h| !dead.contains(&h.pid));
            alive && seen.get(witness).is_some_and(|h| h.finished_scans >= scans)
        });
        let pid = observer.pid("alignment");
        kill_9(pid);
        dead.push(pid);
    }
    drop(observer);
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    assert_eq!(summary(&stage.path("out"))["restarts"], 3);
    for file in ["trajectory.tum", "model.ply"] {
        let [a, b] = ["undisturbed", "out"].map(|out| fs::read(stage.path(out).join(file)).unwrap());
        assert!(a == b, "{file} is another\n{}", finished.stderr);
    }
    stage.assert_nothing_left();
}

#[test]
fn a_mode_that_does_not_exist_and_a_value_out_of_range_are_refused_by_name() {
    let stage = Stage::new();
    let finished = stage.run(&["--set", "alignment.mode=sliding"]);
    assert_eq!(finished.status.code(), Some(2));
    assert!(
        finished.stderr.contains("alignment.mode=sliding") && finished.stderr.contains("`continuous`"),
        "{}",
        finished.stderr
    );
    let finished = stage.run(&["--set", "alignment.odometry.voxel_m=-1"]);
    assert_eq!(finished.status.code(), Some(2));
    assert!(finished.stderr.contains("odometry.voxel_m"), "{}", finished.stderr);
}
