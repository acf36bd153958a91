//! Recorded sequences.

use std::path::Path;
use std::time::Instant;

use crate::geometry::{Pose, rotation_angle};
use crate::odometry::{FrameRecord, Odometry, OdometryConfig};
use crate::registration::test_scenes::{data, read_tum, read_xyz32};
use crate::scan::{Point, ScanView};

fn scans(folder: &Path) -> Vec<Vec<Point>> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.to_string_lossy().ends_with(".xyz32.bin"));
    files.sort();
    files.iter().map(|file| read_xyz32(file)).collect()
}

fn run(config: &OdometryConfig, scans: &[Vec<Point>]) -> (Vec<FrameRecord>, Vec<f64>) {
    let mut odometry = Odometry::new(config.clone()).unwrap();
    let mut records = Vec::new();
    let mut times = Vec::new();
    for scan in scans {
        let begin = Instant::now();
        records.push(odometry.register_frame(ScanView::unordered(scan), None, None));
        times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    println!("{} bytes, {} points in the map", odometry.bytes(), odometry.map_points().count());
    (records, times)
}

fn print(k: usize, record: &FrameRecord, ms: f64) {
    println!(
        "{k} {:?} {:?} t {:.3?} score {:.3} overlap {:.3} rms {:.4} it {} {} sigma {:.2} points {} searched {} {ms:.2} ms, ev {:.3?} sd {:.4?}",
        record.status,
        record.start,
        record.map_from_scanner.translation.vector.as_slice(),
        record.score,
        record.overlap,
        record.residual_rms_m,
        record.iterations,
        record.converged,
        record.threshold_m,
        record.points,
        record.searched,
        record.constraint.eigenvalues,
        record.covariance.diagonal().map(f64::sqrt).as_slice(),
    );
}

#[test]
fn kitti() {
    let Some(folder) = data("kitti", "kitti00_first6") else { return };
    let scans = scans(&folder);
    for voxel_m in voxels() {
        for threads in [1, 2] {
            let config = OdometryConfig { threads, voxel_m, ..OdometryConfig::default() };
            let runs: Vec<_> = (0..7).map(|_| run(&config, &scans)).collect();
            for k in 0..scans.len() {
                let mut ms: Vec<_> = runs.iter().map(|r| r.1[k]).collect();
                ms.sort_by(f64::total_cmp);
                print(k, &runs[0].0[k], ms[3]);
            }
        }
    }
}

#[test]
fn handheld() {
    let Some(folder) = data("handheld", "handheld") else { return };
    let scans = scans(&folder);
    let truth = read_tum(&folder.join("poses.tum"));
    for voxel_m in voxels() {
        let config = OdometryConfig { threads: 1, voxel_m, max_range_m: 60.0, ..OdometryConfig::default() };
        let (records, ms) = run(&config, &scans);
        let mut sum = (0.0, 0.0, 0.0_f64);
        for (k, record) in records.iter().enumerate() {
            let wanted: Pose = truth[0].inverse() * truth[k];
            let error = wanted.inverse() * record.map_from_scanner;
            let (m, deg) = (error.translation.vector.norm(), rotation_angle(&error).to_degrees());
            print(k, record, ms[k]);
            println!("      error {m:.3} m {deg:.2} deg");
            sum = (sum.0 + m * m, sum.1 + deg * deg, sum.2.max(m));
        }
        let n = records.len() as f64;
        println!("voxel {voxel_m}: rmse {:.3} m max {:.3} {:.2} deg, {:.1} ms a scan", (sum.0 / n).sqrt(), sum.2, (sum.1 / n).sqrt(), ms.iter().sum::<f64>() / n);
    }
}

fn voxels() -> Vec<f64> {
    std::env::var("VOX").unwrap_or("1.0".into()).split(',').map(|v| v.parse().unwrap()).collect()
}
