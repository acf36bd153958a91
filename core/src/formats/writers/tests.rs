use super::super::{read_cloud, read_poses};
use super::*;
use crate::{geometry::Pose, scan::Grid};
use nalgebra::Vector3;
use std::{fs, path::Path};

fn some_points(count: u32) -> Vec<OutPoint> {
    let point = |i: u32| OutPoint {
        position: [f64::from(i) * 0.5, -1.0, 2.0],
        quality: 0.25,
        scan: 70_000 + i,
        intensity: i as u16,
        is_aligned: i.is_multiple_of(2),
    };
    (0..count).map(point).collect()
}

/// Every cloud writer, at its own name in the folder.
fn writers(folder: &Path) -> Vec<(&'static str, Box<dyn CloudWriter>)> {
    let at = |name: &str| folder.join(name);
    vec![
        ("a.ply", Box::new(PlyWriter::create(&at("a.ply"), &PlyOptions::default()).unwrap())),
        ("a.pcd", Box::new(PcdWriter::create(&at("a.pcd"), &PcdOptions::default()).unwrap())),
        ("a.las", Box::new(LasWriter::create(&at("a.las"), [0.0; 3]).unwrap())),
        ("a.laz", Box::new(LasWriter::create(&at("a.laz"), [0.0; 3]).unwrap())),
        ("a.xyz32.bin", Box::new(Xyz32Writer::create(&at("a.xyz32.bin")).unwrap())),
    ]
}

#[test]
fn what_is_written_in_pieces_is_read_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let points = some_points(1000);
    for (name, mut writer) in writers(folder.path()) {
        for piece in points.chunks(77) {
            writer.write(piece).unwrap();
        }
        assert!(!folder.path().join(name).exists(), "{name} has its name before it is complete");
        assert_eq!(writer.finish().unwrap(), 1000, "{name}");
        let cloud = read_cloud(&folder.path().join(name)).unwrap();
        assert_eq!(cloud.points.len(), 1000, "{name}");
        for (written, read) in points.iter().zip(&cloud.points) {
            let off = read.position() - nalgebra::Point3::from(written.position);
            assert!(off.norm() < 1e-4, "{name}: {off}");
            assert_eq!(read.intensity, if name == "a.xyz32.bin" { 0 } else { written.intensity }, "{name}");
        }
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 5);
}

#[test]
fn a_writer_that_is_dropped_leaves_nothing_and_keeps_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.ply"), "old").unwrap();
    for (_, mut writer) in writers(folder.path()) {
        writer.write(&some_points(10)).unwrap();
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    assert_eq!(fs::read_to_string(folder.path().join("a.ply")).unwrap(), "old");
}

#[test]
fn the_header_of_a_ply_names_every_property_and_keeps_the_comments() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let options = PlyOptions { is_double: true, comments: vec!["scan one".into(), "two\nlines".into()] };
    let mut writer = Box::new(PlyWriter::create(&path, &options).unwrap());
    writer.write(&some_points(3)).unwrap();
    writer.finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = String::from_utf8(bytes[..end].to_vec()).unwrap();
    for line in [
        "comment scan one",
        "comment two lines",
        "element vertex 3",
        "property double x",
        "property float quality",
        "property uint scan",
        "property ushort intensity",
        "property uchar aligned",
    ] {
        assert!(header.lines().any(|l| l == line), "{line} is missing in {header}");
    }
    // Three doubles, float, uint, ushort and uchar, little-endian.
    let record = 24 + 4 + 4 + 2 + 1;
    assert_eq!(bytes.len() - end, 3 * record);
    let second = &bytes[end + record..end + 2 * record];
    assert_eq!(second[..8], 0.5_f64.to_le_bytes());
    assert_eq!(second[24..28], 0.25_f32.to_le_bytes());
    assert_eq!(second[28..32], 70_001_u32.to_le_bytes());
    assert_eq!(second[32..35], [1, 0, 0]);
}

#[test]
fn a_pcd_keeps_its_grid_and_refuses_points_that_do_not_fill_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pcd");
    let options = PcdOptions { is_double: false, grid: Some(Grid { rows: 5, cols: 2 }) };
    for (count, is_full) in [(9, false), (10, true)] {
        let mut writer = Box::new(PcdWriter::create(&path, &options).unwrap());
        writer.write(&some_points(count)).unwrap();
        assert_eq!(writer.finish().is_ok(), is_full);
        assert_eq!(path.exists(), is_full);
    }
    assert_eq!(read_cloud(&path).unwrap().grid, options.grid);
}

#[test]
fn a_las_far_away_keeps_tenths_of_a_millimetre_and_refuses_what_it_cannot_reach() {
    let folder = tempfile::tempdir().unwrap();
    let origin = [500_000.0, 5_800_000.0, 0.0];
    let point = |x: f64| OutPoint { position: [x, 5_800_000.123_4, 3.0], ..some_points(1)[0] };
    for name in ["a.las", "a.laz"] {
        let path = folder.path().join(name);
        let mut writer = Box::new(LasWriter::create(&path, origin).unwrap());
        writer.write(&[point(500_000.987_6)]).unwrap();
        assert!(writer.write(&[point(0.0)]).is_err());
        drop(writer);
        let mut writer = Box::new(LasWriter::create(&path, origin).unwrap());
        writer.write(&[point(500_000.987_6)]).unwrap();
        assert_eq!(writer.finish().unwrap(), 1);
        let cloud = read_cloud(&path).unwrap();
        let found = cloud.points[0].position().coords + Vector3::from(cloud.origin);
        assert!((found - Vector3::new(500_000.987_6, 5_800_000.123_4, 3.0)).norm() < 1e-4, "{found}");
    }
}

#[test]
fn a_trajectory_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tum");
    let poses = [0.1, 0.2, 3.0].map(|a| Pose::new(Vector3::new(a, 2.0, -3.0), Vector3::new(a, -0.2, 0.3)));
    let mut writer = TumWriter::create(&path).unwrap();
    for (i, pose) in poses.iter().enumerate() {
        writer.write(1_630_577_758.25 + i as f64, pose).unwrap();
    }
    assert_eq!(writer.finish().unwrap(), 3);
    for (i, (read, written)) in read_poses(&path).unwrap().iter().zip(&poses).enumerate() {
        assert_eq!(read.stamp_s, Some(1_630_577_758.25 + i as f64));
        let off = read.map_from_scanner.to_homogeneous() - written.to_homogeneous();
        assert!(off.norm() < 1e-8, "{off}");
    }
}
