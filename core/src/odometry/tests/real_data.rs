//! Recorded sequences.

use std::path::Path;

use crate::geometry::{Pose, rotation_angle};
use crate::odometry::{FrameRecord, FrameStatus, Odometry, OdometryConfig};
use crate::registration::test_scenes::{data, read_tum, read_xyz32};
use crate::scan::{Point, ScanView};

fn scans(folder: &Path) -> Vec<Vec<Point>> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.to_string_lossy().ends_with(".xyz32.bin"));
    files.sort();
    files.iter().map(|file| read_xyz32(file)).collect()
}

fn run(config: &OdometryConfig, scans: &[Vec<Point>]) -> Vec<FrameRecord> {
    let mut odometry = Odometry::new(config.clone()).unwrap();
    scans.iter().map(|scan| odometry.register_frame(ScanView::unordered(scan), None, None)).collect()
}

#[test]
fn six_automotive_scans_are_followed_to_where_all_methods_agree() {
    let Some(folder) = data("six automotive scans", "kitti00_first6") else { return };
    let records = run(&OdometryConfig { threads: 2, ..OdometryConfig::default() }, &scans(&folder));
    assert_eq!(records.len(), 6);
    for record in &records[1..] {
        assert_eq!((record.status, record.searched, record.converged), (FrameStatus::Tracked, 0, true), "{record:?}");
    }
    // What small_gicp, Open3D, PCL and libpointmatcher find for the first pair.
    let t = records[1].map_from_scanner.translation.vector;
    assert!((t - nalgebra::Vector3::new(0.689, 0.004, 0.008)).norm() < 0.02, "{t}");
}

/// Root mean square and greatest error [m], root mean square error [deg], over 45 scans of a walk, 1.7 m apart with
/// turns of up to 136 degrees between two scans.
fn walk(config: &OdometryConfig) -> Option<(f64, f64, f64)> {
    let folder = data("a walk without odometry", "handheld")?;
    let truth = read_tum(&folder.join("poses.tum"));
    let records = run(config, &scans(&folder));
    assert_eq!(records.len(), truth.len());
    let (mut metres_sq, mut worst, mut degrees_sq) = (0.0, 0.0_f64, 0.0);
    for (record, truth_k) in records.iter().zip(&truth) {
        assert!(record.status.is_tracked(), "{record:?}");
        let wanted: Pose = truth[0].inverse() * truth_k;
        let error = wanted.inverse() * record.map_from_scanner;
        let metres = error.translation.vector.norm();
        metres_sq += metres * metres;
        degrees_sq += rotation_angle(&error).to_degrees().powi(2);
        worst = worst.max(metres);
    }
    let n = records.len() as f64;
    let answer = ((metres_sq / n).sqrt(), worst, (degrees_sq / n).sqrt());
    println!("voxel {} m: {answer:.3?}", config.voxel_m);
    Some(answer)
}

#[test]
fn a_walk_with_great_steps_and_turns_is_followed_without_odometry() {
    for voxel_m in [0.8, 1.0, 1.2] {
        let config = OdometryConfig { threads: 2, voxel_m, max_range_m: 60.0, ..OdometryConfig::default() };
        let Some((rmse_m, worst_m, rmse_deg)) = walk(&config) else { return };
        assert!(rmse_m < 0.3 && worst_m < 0.5 && rmse_deg < 0.5, "{voxel_m}: {rmse_m} m {worst_m} m {rmse_deg} deg");
    }
}
