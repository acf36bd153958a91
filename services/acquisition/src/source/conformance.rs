//! What every source promises, checked on each of them.

use std::path::PathBuf;

use mirador_core::geometry::pose_from_rows;
use mirador_core::scan::Point;
use mirador_core::simulation::ScannerConfig;

use super::{Source, open_source};
use crate::{AcquisitionConfig, SourceKind};

fn small_scene() -> AcquisitionConfig {
    let scanner = ScannerConfig { beams: 91, beam_step_deg: 2.0, sweeps: 60, ..ScannerConfig::default() };
    AcquisitionConfig { scanner, max_scans: 3, ..AcquisitionConfig::default() }
}

/// A folder of three files of different size, with poses.
fn small_files() -> (tempfile::TempDir, AcquisitionConfig) {
    let folder = tempfile::tempdir().unwrap();
    for (scan, points) in [40_u8, 25, 60].into_iter().enumerate() {
        let bytes: Vec<u8> =
            (0..points).flat_map(|i| [f32::from(i) + 1.0, scan as f32, 0.5]).flat_map(f32::to_le_bytes).collect();
        std::fs::write(folder.path().join(format!("scan{scan}.xyz32.bin")), bytes).unwrap();
    }
    let poses = folder.path().join("odometry.tum");
    let lines: String = (0..3).map(|i| format!("{}.5 {i} 0 0 0 0 0 1\n", i * 10)).collect();
    std::fs::write(&poses, lines).unwrap();
    let config = AcquisitionConfig {
        source: SourceKind::Replay,
        path: folder.path().into(),
        poses: Some(poses),
        ..AcquisitionConfig::default()
    };
    (folder, config)
}

fn read(source: &mut dyn Source, index: usize) -> Vec<u8> {
    let mut points = vec![Point::EMPTY; source.info(index).unwrap().cells];
    source.write(index, &mut points).unwrap();
    bytemuck::cast_slice(&points).to_vec()
}

fn conforms(source: &mut dyn Source) {
    assert!(source.scans() > 0 && !source.describe().is_empty());
    let sizes: Vec<usize> = (0..source.scans()).map(|i| source.info(i).unwrap().cells).collect();
    assert_eq!(source.largest_scan(), *sizes.iter().max().unwrap());
    assert!(source.info(source.scans()).is_none());
    let stamps: Vec<i64> = (0..source.scans()).map(|i| source.info(i).unwrap().stamp_ns).collect();
    assert!(stamps.is_sorted());
    // In any order and any number of times the same bits.
    let first: Vec<Vec<u8>> = (0..source.scans()).map(|i| read(source, i)).collect();
    for index in (0..source.scans()).rev() {
        assert_eq!(read(source, index), first[index], "scan {index} changed");
    }
    let scans = source.scans();
    assert!(source.write(scans, &mut []).is_err());
}

#[test]
fn the_scene_conforms() {
    conforms(open_source(&small_scene(), 2).unwrap().as_mut());
}

#[test]
fn files_conform() {
    let (_folder, config) = small_files();
    conforms(open_source(&config, 1).unwrap().as_mut());
}

#[test]
fn a_capture_conforms() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.pcap");
    std::fs::write(&path, capture()).unwrap();
    let config = AcquisitionConfig { source: SourceKind::Replay, path, ..AcquisitionConfig::default() };
    conforms(open_source(&config, 1).unwrap().as_mut());
}

/// A capture of a VLP-16 that turns three times in a round room.
fn capture() -> Vec<u8> {
    let mut out = Vec::new();
    // The classic header, little-endian, microseconds; raw IP packets.
    out.extend(0xa1b2_c3d4_u32.to_le_bytes());
    out.extend([2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 0, 0, 101, 0, 0, 0]);
    for k in 0..240_u32 {
        let mut payload = Vec::new();
        for block in 0..12 {
            payload.extend([0xff, 0xee]);
            payload.extend(((40 * (12 * k + block) % 36_000) as u16).to_le_bytes());
            payload.extend([0xc4, 0x09, 7].repeat(32));
        }
        payload.extend([0, 0, 0, 0, 0x37, 0x22]);
        let (udp, ip) = (payload.len() as u16 + 8, payload.len() as u16 + 28);
        let mut packet = vec![0x45, 0];
        packet.extend(ip.to_be_bytes());
        packet.extend([0, 0, 0, 0, 64, 17, 0, 0, 10, 0, 0, 1, 10, 0, 0, 2, 9, 64, 9, 64]);
        packet.extend(udp.to_be_bytes());
        packet.extend([0, 0]);
        packet.extend(&payload);
        for word in [k / 754, 1327 * (k % 754), packet.len() as u32, packet.len() as u32] {
            out.extend(word.to_le_bytes());
        }
        out.extend(packet);
    }
    out
}

#[test]
fn files_take_time_and_prior_from_their_poses() {
    let (_folder, config) = small_files();
    let source = open_source(&config, 1).unwrap();
    let info = source.info(2).unwrap();
    assert_eq!(info.stamp_ns, 20_500_000_000);
    assert!((info.prior.unwrap().map_from_scanner[3] - 2.0).abs() < 1e-12);
}

#[test]
fn a_number_of_poses_that_is_not_that_of_the_scans_is_an_error_with_both() {
    let (folder, config) = small_files();
    std::fs::write(folder.path().join("odometry.tum"), "0 0 0 0 0 0 0 1\n").unwrap();
    let message = open_source(&config, 1).err().unwrap().to_string();
    assert!(message.contains("1 poses for 3 scans"), "{message}");
}

#[test]
fn a_grid_that_does_not_fit_is_an_error_with_the_numbers() {
    let (_folder, config) = small_files();
    let config = AcquisitionConfig { grid: Some("5x5".into()), ..config };
    let message = open_source(&config, 1).err().unwrap().to_string();
    assert!(message.contains("5x5") && message.contains("40 points"), "{message}");
}

#[test]
fn a_missing_path_and_an_unknown_scene_are_errors_that_name_them() {
    let missing = AcquisitionConfig {
        source: SourceKind::Replay,
        path: PathBuf::from("no/such/folder"),
        ..AcquisitionConfig::default()
    };
    assert!(open_source(&missing, 1).err().unwrap().to_string().contains("no/such/folder"));
    let unknown = AcquisitionConfig { scene: "atlantis".into(), ..AcquisitionConfig::default() };
    let message = open_source(&unknown, 1).err().unwrap().to_string();
    assert!(message.contains("atlantis") && message.contains("simple"), "{message}");
}

#[test]
fn the_odometry_of_a_scene_drifts_and_begins_at_the_truth() {
    let config = AcquisitionConfig { odometry_noise: 0.05, ..small_scene() };
    let truth = super::true_poses(&config).unwrap();
    let source = open_source(&config, 1).unwrap();
    let error = |i: usize| {
        let prior = pose_from_rows(&source.info(i).unwrap().prior.unwrap().map_from_scanner).unwrap();
        (prior.translation.vector - truth[i].translation.vector).norm()
    };
    assert!(error(0) < 1e-12);
    assert!(error(2) > 0.01 && error(2) < 5.0);
}
