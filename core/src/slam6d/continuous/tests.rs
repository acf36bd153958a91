//! Continuous alignment of recorded and of simple scenes.

use nalgebra::Vector3;

use super::*;
use crate::geometry::{Pose, rotation_angle};
use crate::odometry::{FrameTime, KeyframeConfig, OdometryConfig};
use crate::registration::test_scenes::{YARD, data, read_tum, read_xyz32, scan_of};
use crate::registration::{Registration, RegistrationConfig, Registry};
use crate::scan::{Point, ScanView};
use crate::slam6d::global::{CorrectionRecord, GlobalConfig, Journalled, PairKind};
use crate::slam6d::{AlignmentStatus, HypothesisName, Rejection, SequentialConfig, trajectory_error};

fn method(threads: usize) -> Box<dyn Registration> {
    let config = RegistrationConfig { threads, ..RegistrationConfig::default() };
    Registry::default().create("gicp", &config).unwrap()
}

fn config(threads: usize) -> ContinuousConfig {
    let mut config = ContinuousConfig::default();
    (config.odometry.threads, config.relocalisation.search.threads) = (threads, threads);
    config
}

fn aligner(threads: usize, config: ContinuousConfig, mut global: GlobalConfig) -> ContinuousAligner {
    global.coarse.threads = threads;
    ContinuousAligner::new(method(threads), SequentialConfig::default(), global, config).unwrap()
}

/// The recorded scans of a folder, in the order of their names.
fn recorded(name: &str) -> Option<Vec<Vec<Point>>> {
    let folder = data("continuous alignment", name)?;
    let mut files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.to_string_lossy().ends_with(".xyz32.bin"));
    files.sort();
    Some(files.iter().map(|file| read_xyz32(file)).collect())
}

fn walk() -> Option<(Vec<Vec<Point>>, Vec<Pose>)> {
    let scans = recorded("handheld")?;
    Some((scans, read_tum(&data("continuous alignment", "handheld")?.join("poses.tum"))))
}

#[test]
fn a_walk_without_any_prior_ends_in_a_map_with_closed_loops() {
    let Some((scans, truth)) = walk() else { return };
    let mut aligner = aligner(2, config(2), GlobalConfig::default());
    let (mut published, mut poses) = (Vec::new(), vec![Pose::identity(); scans.len()]);
    let (mut keyframes, mut loops) = (0, 0);
    for (k, scan) in scans.iter().enumerate() {
        let frame = aligner.align_next(k as u64, ScanView::unordered(scan), None, None);
        assert!(frame.record.is_accepted(), "{k}: {:?}", frame.record.status);
        keyframes += usize::from(frame.is_keyframe);
        published.push(frame.record.map_from_scanner);
        poses[k] = frame.record.map_from_scanner;
        while aligner.is_correction_due() {
            let correction = aligner.correct(&|| false).unwrap();
            loops += correction.pairs.iter().filter(|p| p.kind == PairKind::Loop && p.rejected.is_none()).count();
            for corrected in correction.corrections {
                poses[corrected.scan_id as usize] = corrected.after;
            }
        }
    }
    let [before, after] = [&published, &poses].map(|poses| trajectory_error(poses, &truth).unwrap());
    println!("{keyframes} keyframes, {loops} loops; as published {before:.3?}, corrected {after:.3?}");
    assert!(before.ate_rmse_m < 0.3 && after.ate_rmse_m < 0.15 && after.max_m < 0.3, "{before:?} {after:?}");
    assert!(loops > 5, "{loops}");
}

#[test]
fn after_scans_of_another_place_the_scanner_is_found_again_among_the_keyframes() {
    let Some((scans, truth)) = walk() else { return };
    let Some(elsewhere) = recorded("kitti00_first6") else { return };
    let mut aligner = aligner(2, config(2), GlobalConfig::default());
    let mut id = 0;
    let mut step = |scan: &[Point]| {
        let frame = aligner.align_next(id, ScanView::unordered(scan), None, None);
        id += 1;
        while aligner.correct(&|| false).is_some() {}
        (frame, aligner.lost_frames())
    };
    // Without scan 12, at which the scanner will be found again.
    for scan in scans[..12].iter().chain(&scans[13..36]) {
        assert!(step(scan).0.record.is_accepted());
    }
    for scan in &elsewhere[..3] {
        let (frame, lost) = step(scan);
        let AlignmentStatus::NotAligned(reason) = &frame.record.status else { panic!("{:?}", frame.record.status) };
        assert!(matches!(reason, Rejection::Lost { .. }) && reason.to_string().starts_with("lost: "), "{reason}");
        assert!(lost > 0 && frame.record.target_id.is_some() && !frame.is_keyframe);
    }
    // Carried to where the walk was before, 21 m away and out of reach of the odometry's own search.
    let mut found = Vec::new();
    for k in 12..16 {
        let (frame, lost) = step(&scans[k]);
        let wanted = truth[0].inverse() * truth[k];
        let error = wanted.inverse() * frame.record.map_from_scanner;
        println!("{k}: {:?} {:.3} m, lost {lost}", frame.record.status, error.translation.vector.norm());
        if frame.record.is_accepted() {
            assert!(error.translation.vector.norm() < 0.3 && rotation_angle(&error) < 0.03, "{k}: {error}");
            found.push(frame);
        }
    }
    assert!(found.len() >= 3, "found again at the first or the second scan");
    let first = &found[0].record;
    assert_eq!(first.hypotheses.last().unwrap().name, HypothesisName::Relocalisation);
    assert!(found[0].is_keyframe && first.target_id.is_some() && first.pair_covariance.is_some());
}

fn yard_config(threads: usize) -> ContinuousConfig {
    let odometry =
        OdometryConfig { threads, voxel_m: 0.6, max_range_m: 30.0, max_voxels: 4000, ..OdometryConfig::default() };
    let keyframes = KeyframeConfig { distance_m: 0.8, overlap: 0.0, thinning_m: 0.25, ..KeyframeConfig::default() };
    let mut all = ContinuousConfig { odometry, keyframes, ..config(threads) };
    all.relocalisation.keyframes_per_frame = 1;
    all
}

/// Around in the yard, so that the same places are seen again; some frames are of nowhere, so that the search and the
/// relocalisation take part.
fn yard(count: u32) -> Vec<Vec<Point>> {
    let pose = |k: u32| {
        let angle = 0.12 * f64::from(k);
        Pose::new(Vector3::new(2.0 * angle.sin(), 2.0 - 2.0 * angle.cos(), 0.0), Vector3::z() * angle)
    };
    let scan = |k: u32| {
        let points = scan_of(&YARD, &pose(k), 25.0, u64::from(k) + 1);
        if (21..25).contains(&k) {
            return points
                .iter()
                .enumerate()
                .map(|(n, p)| Point::new(p.y + (n % 13) as f32, 0.7 * p.x, p.z * 3.0))
                .collect();
        }
        points
    };
    (0..count).map(scan).collect()
}

fn time(k: usize) -> Option<FrameTime> {
    Some(FrameTime { end_s: 0.1 * k as f64, duration_s: 0.1 })
}

type Outcome = (Vec<ContinuousFrame>, Vec<CorrectionRecord>, Vec<Pose>);

fn go_on(aligner: &mut ContinuousAligner, scans: &[Vec<Point>], range: std::ops::Range<usize>) -> Outcome {
    let (mut frames, mut corrections) = (Vec::new(), Vec::new());
    for k in range {
        frames.push(aligner.align_next(k as u64, ScanView::unordered(&scans[k]), time(k), None));
        corrections.extend(aligner.correct(&|| false));
    }
    (frames, corrections, aligner.map().poses().map(|(_, pose)| *pose).collect())
}

fn corrected_often() -> GlobalConfig {
    GlobalConfig { correction_threshold_m: 1e-6, ..GlobalConfig::default() }
}

#[test]
fn frames_between_keyframes_move_along_with_theirs() {
    let scans = yard(40);
    let mut aligner = aligner(2, yard_config(2), corrected_often());
    let (frames, corrections, _) = go_on(&mut aligner, &scans, 0..scans.len());
    assert!(frames.iter().any(|f| f.is_keyframe) && frames.iter().any(|f| !f.is_keyframe && f.record.is_accepted()));
    let keyframe_of = |id: u64| -> u64 {
        let frame = &frames[id as usize];
        if frame.is_keyframe { id } else { frame.record.target_id.unwrap() }
    };
    let mut followed = 0;
    for correction in &corrections {
        for moved in correction.corrections.iter().filter(|c| keyframe_of(c.scan_id) != c.scan_id) {
            let own = correction.corrections.iter().find(|c| c.scan_id == keyframe_of(moved.scan_id)).unwrap();
            let [before, after] = [own.before.inverse() * moved.before, own.after.inverse() * moved.after];
            assert!((before.inverse() * after).translation.vector.norm() < 1e-9, "frame {}", moved.scan_id);
            followed += 1;
        }
    }
    assert!(followed > 10, "{followed}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scans = yard(29);
    let outcome =
        |threads| go_on(&mut aligner(threads, yard_config(threads), corrected_often()), &scans, 0..scans.len());
    let one = outcome(1);
    assert!(one.0.iter().any(|f| !f.record.is_accepted()), "no frame was lost");
    assert_eq!(outcome(3), one);
}

/// Through JSON-like text and back, as a process writes it.
fn written<T: serde::Serialize + serde::de::DeserializeOwned>(value: &T) -> T {
    toml::from_str(&toml::to_string(value).unwrap()).unwrap()
}

#[test]
fn a_restored_aligner_goes_on_with_the_same_bits() {
    let scans = yard(31);
    for at in [2, 18, 23, 27] {
        let mut undisturbed = aligner(2, yard_config(2), corrected_often());
        go_on(&mut undisturbed, &scans, 0..at);
        let expected = go_on(&mut undisturbed, &scans, at..scans.len());
        let mut killed = aligner(2, yard_config(2), corrected_often());
        killed.keep_journal();
        let mut snapshot = None;
        for k in 0..at {
            go_on(&mut killed, &scans, k..k + 1);
            snapshot = killed.take_snapshot().or(snapshot);
        }
        let journal = killed.take_journal().into_iter();
        let journal: Vec<Journalled> =
            journal.map(|j| Journalled { entry: written(&j.entry), keyframe: j.keyframe }).collect();
        let state: ContinuousState = written(killed.state());
        let mut global = corrected_often();
        global.coarse.threads = 2;
        let (sequential, config) = (SequentialConfig::default(), yard_config(2));
        let mut restored =
            ContinuousAligner::restore(method(2), sequential, global, config, state, snapshot.as_deref(), journal)
                .unwrap();
        let again = restored.frames_since_snapshot().to_vec();
        assert!(again.len() <= 16, "{} frames to go through again", again.len());
        for input in again {
            let k = input.scan_id as usize;
            restored.repeat(&input, ScanView::unordered(&scans[k]), time(k));
        }
        let found = go_on(&mut restored, &scans, at..scans.len());
        assert!(found == expected, "after {at} scans");
    }
}
