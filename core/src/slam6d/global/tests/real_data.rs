//! Recorded sequences.

use std::time::{Duration, Instant};

use super::drifting::method;
use super::*;
use crate::registration::test_scenes::{data, read_tum, read_xyz32};
use crate::slam6d::trajectory_error;

fn median(times: &mut [Duration]) -> (Duration, Duration) {
    times.sort();
    (times[times.len() / 2], times[times.len() * 99 / 100])
}

#[test]
fn the_handheld_sequence_is_relaxed() {
    let Some(path) = data("handheld relaxed", "handheld") else { return };
    let (odometry, truth) = (read_tum(&path.join("odometry.tum")), read_tum(&path.join("poses.tum")));
    let times = std::fs::read_to_string(path.join("times.txt")).unwrap();
    let files = times.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_whitespace().next());
    let scans: Vec<Vec<Point>> = files.map(|file| read_xyz32(&path.join(file))).collect();
    let mut aligner = aligner(method(2), &GlobalConfig::default());
    let (mut pair, mut correction, mut chain) = (Vec::new(), Vec::new(), Vec::new());
    let begin = Instant::now();
    for (k, scan) in scans.iter().enumerate() {
        let start = Instant::now();
        let record = aligner.align_next(k as u64, ScanView::unordered(scan), Some(odometry[k]));
        pair.push(start.elapsed());
        chain.push(record.map_from_scanner);
        let start = Instant::now();
        let record = aligner.correct(&|| false).unwrap();
        correction.push(start.elapsed());
        for p in &record.pairs {
            println!(
                "{k}: {:?} {} overlap {:.2} of {:.2} residual {:.3} sigma {:.3} m {:.4}: {:.1} sigmas {:?}",
                p.kind,
                p.target_id,
                p.overlap,
                p.predicted_overlap,
                p.residual_m,
                p.predicted_sigma_m,
                p.predicted_sigma_rotation,
                p.sigmas,
                p.rejected
            );
        }
        println!("{k}: {} candidates, {:?} {} moved", record.candidates, record.relaxation, record.corrections.len());
    }
    let total = begin.elapsed();
    let estimate: Vec<Pose> = aligner.poses().map(|(_, pose)| *pose).collect();
    println!("as published first: {:.3?}", trajectory_error(&chain, &truth).unwrap());
    println!("relaxed: {:.3?}", trajectory_error(&estimate, &truth).unwrap());
    println!("pair {:?}, correction {:?}, total {total:?}", median(&mut pair), median(&mut correction));
    println!(
        "keyframe {} bytes of {} points, {} in all",
        aligner.keyframe_bytes(),
        aligner.keyframe_points(),
        aligner.bytes()
    );
}
