//! Recorded sequences.

use std::time::{Duration, Instant};

use super::drifting::method;
use super::*;
use crate::registration::test_scenes::{data, read_tum, read_xyz32};
use crate::slam6d::trajectory_error;

/// The median and the 99th of a hundred.
fn quantiles(times: &mut [Duration]) -> (Duration, Duration) {
    times.sort();
    (times[times.len() / 2], times[times.len() * 99 / 100])
}

#[test]
fn the_handheld_sequence_is_relaxed_within_its_bounds() {
    let Some(path) = data("handheld relaxed", "handheld") else { return };
    let (odometry, truth) = (read_tum(&path.join("odometry.tum")), read_tum(&path.join("poses.tum")));
    let times = std::fs::read_to_string(path.join("times.txt")).unwrap();
    let files = times.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_whitespace().next());
    let scans: Vec<Vec<Point>> = files.map(|file| read_xyz32(&path.join(file))).collect();
    let mut aligner = aligner(method(2), &GlobalConfig::default());
    let (mut pair, mut correction, mut chain, mut tried) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let begin = Instant::now();
    for (k, scan) in scans.iter().enumerate() {
        let start = Instant::now();
        let record = aligner.align_next(k as u64, ScanView::unordered(scan), Some(odometry[k]));
        pair.push(start.elapsed());
        chain.push(record.map_from_scanner);
        let start = Instant::now();
        let record = aligner.correct(&|| false).unwrap();
        correction.push(start.elapsed());
        tried.extend(record.pairs);
    }
    let total = begin.elapsed();
    let estimate: Vec<Pose> = aligner.poses().map(|(_, pose)| *pose).collect();
    let [before, after] = [&chain, &estimate].map(|poses| trajectory_error(poses, &truth).unwrap());
    println!("handheld: as published first {before:.3?}, relaxed {after:.3?}");
    println!(
        "  pair {:?}, correction {:?} (p50, p99), total {total:?}",
        quantiles(&mut pair),
        quantiles(&mut correction)
    );
    println!("  {} bytes of {} points a keyframe", aligner.keyframe_bytes(), aligner.keyframe_points());
    for pair in tried.iter().filter(|pair| pair.rejected.is_some()) {
        println!("  {} with {}: {}", pair.source_id, pair.target_id, pair.rejected.as_ref().unwrap());
    }
    let accepted = |kind| tried.iter().filter(|pair| pair.kind == kind && pair.rejected.is_none()).count();
    assert!(accepted(PairKind::Overlap) > 100 && accepted(PairKind::Loop) > 10);
    assert!(after.ate_rmse_m <= 0.12 && after.ate_rmse_deg <= 0.2, "{after:?}");
    assert!(aligner.keyframe_bytes() < 10 * aligner.keyframe_points());
}
