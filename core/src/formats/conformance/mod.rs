//! One suite for every format: what is written is read back, in order, from plain and gzipped files, and damage is an
//! error and nothing else.

mod convert;
mod encoders;
mod malformed;
mod real_data;

use super::*;
use crate::scan::Point;
use encoders::{CASES, Case, Keeps};
use flate2::{Compression, write::GzEncoder};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// A file with this content in a folder that lives as long as the test.
fn file_with(folder: &Path, name: &str, content: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, content).unwrap();
    path
}

fn gzipped(content: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

/// Points on a spiral, none like another, in exact steps of 1/64 m so that every format holds them.
fn spiral(count: usize) -> Vec<Point> {
    let step = |v: f64| ((v * 64.0).round() / 64.0) as f32;
    let point = |i: usize| {
        let t = i as f64 * 0.1;
        let (x, y, z) = (step(t.cos() * (2.0 + t)), step(t.sin() * (2.0 + t)), step(0.25 * t - 1.0));
        Point { x, y, z, intensity: (i * 37 % 60_000) as u16, time: 0 }
    };
    (0..count).map(point).collect()
}

/// The spiral with an empty cell in every third place, the first among them.
fn with_empty_cells(count: usize) -> Vec<Point> {
    let mut points = spiral(count);
    points.iter_mut().step_by(3).for_each(|point| *point = Point::EMPTY);
    points
}

fn assert_same(case: &Case, expected: &[Point], found: &[Point]) {
    assert_eq!(expected.len(), found.len(), "{}", case.name);
    for (i, (e, f)) in expected.iter().zip(found).enumerate() {
        assert_eq!(e.is_return(), f.is_return(), "{}: cell {i}", case.name);
        if e.is_return() {
            let off = (e.vector() - f.vector()).norm();
            assert!(off <= case.tolerance_m, "{}: point {i} is {off} m off: {e:?} {f:?}", case.name);
            let intensity = if case.keeps.contains(&Keeps::Intensity) { e.intensity } else { 0 };
            assert_eq!(intensity, f.intensity, "{}: point {i}", case.name);
        }
    }
}

#[test]
fn a_cloud_is_read_back_in_order_from_plain_and_gzipped_files() {
    let folder = tempfile::tempdir().unwrap();
    for count in [1, 2, 1000, CHUNK_POINTS + 3] {
        let points = spiral(count);
        for case in CASES {
            let content = (case.encode)(&points);
            let plain = file_with(folder.path(), case.name, &content);
            let packed = file_with(folder.path(), &format!("{}.gz", case.name), &gzipped(&content));
            for path in [plain, packed] {
                let cloud = read_cloud(&path).unwrap();
                assert_same(case, &points, &cloud.points);
                assert_eq!(cloud.origin, [0.0; 3]);
                assert_eq!(cloud.grid, None);
                assert_eq!(count_points(&path).unwrap(), count, "{}", path.display());
            }
        }
    }
}

#[test]
fn empty_cells_stay_in_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let points = with_empty_cells(50);
    for case in CASES.iter().filter(|case| case.keeps.contains(&Keeps::EmptyCells)) {
        let path = file_with(folder.path(), case.name, &(case.encode)(&points));
        let cloud = read_cloud(&path).unwrap();
        assert_same(case, &points, &cloud.points);
        assert_eq!(count_points(&path).unwrap(), 50, "{}", case.name);
    }
}

#[test]
fn a_cloud_without_returns_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    for case in CASES {
        let none = file_with(folder.path(), case.name, &(case.encode)(&[]));
        for error in [read_cloud(&none).unwrap_err(), count_points(&none).unwrap_err()] {
            assert!(matches!(error, FormatError::Empty { .. }), "{}: {error}", case.name);
        }
        if case.keeps.contains(&Keeps::EmptyCells) {
            let only_empty = file_with(folder.path(), case.name, &(case.encode)(&[Point::EMPTY; 20]));
            assert!(matches!(read_cloud(&only_empty), Err(FormatError::Empty { .. })), "{}", case.name);
        }
    }
}

#[test]
fn the_hint_is_exact_or_a_bound_and_chunks_stay_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let count = 5 * CHUNK_POINTS + 7;
    let points = spiral(count);
    for case in CASES {
        let path = file_with(folder.path(), case.name, &(case.encode)(&points));
        let mut reader = open_cloud(&path).unwrap();
        match reader.point_count_hint() {
            CountHint::Exact(exact) => assert_eq!(exact, count, "{}", case.name),
            CountHint::AtMost(bound) => assert!(bound >= count, "{}", case.name),
        }
        let (mut chunk, mut total) = (Vec::new(), 0);
        while reader.next_chunk(&mut chunk).unwrap() > 0 {
            total += chunk.len();
            assert!(chunk.len() <= CHUNK_POINTS && chunk.capacity() <= 2 * CHUNK_POINTS, "{}", case.name);
        }
        assert_eq!(total, count, "{}", case.name);
        assert_eq!(reader.next_chunk(&mut chunk).unwrap(), 0, "{}: the end stays the end", case.name);
    }
}

#[test]
fn a_cloud_far_from_its_origin_keeps_its_millimetres() {
    let folder = tempfile::tempdir().unwrap();
    let far = [[500_000.25, 5_800_000.125, 60.5], [500_001.5, 5_800_002.0, 61.0625]];
    let text: String = far.iter().map(|p| format!("{},{},{}\n", p[0], p[1], p[2])).collect();
    let mut double = b"ply\nformat binary_little_endian 1.0\nelement vertex 2\n".to_vec();
    double.extend(b"property double x\nproperty double y\nproperty double z\nend_header\n");
    far.iter().flatten().for_each(|c| double.extend(f64::to_le_bytes(*c)));
    let csv = file_with(folder.path(), "far.csv", text.as_bytes());
    let ply = file_with(folder.path(), "far.ply", &double);
    let las = folder.path().join("far.las");
    convert(&csv, &las, None, &mut |_| {}).unwrap();
    for path in [csv, ply, las] {
        let cloud = read_cloud(&path).unwrap();
        for (point, expected) in cloud.points.iter().zip(far) {
            let found = [0, 1, 2].map(|i| point.position()[i] + cloud.origin[i]);
            for i in 0..3 {
                assert!((found[i] - expected[i]).abs() < 1e-4, "{}: {found:?}", path.display());
            }
        }
    }
}
