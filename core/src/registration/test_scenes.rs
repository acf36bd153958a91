//! Real scans for the tests of this module and of `slam6d`, beside the scenes of the conformance suite.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::geometry::Pose;
use crate::scan::Point;

pub use super::conformance::scenes::*;

pub(crate) use crate::test_data::data;

/// Little-endian f32 triples.
pub fn read_xyz32(path: &std::path::Path) -> Vec<Point> {
    let bytes = std::fs::read(path).unwrap();
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    bytes.chunks_exact(12).map(|b| Point::new(value(b), value(&b[4..]), value(&b[8..]))).collect()
}

/// The poses of a `.tum` file.
pub fn read_tum(path: &std::path::Path) -> Vec<Pose> {
    let text = std::fs::read_to_string(path).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.map(|line| {
        let v: Vec<f64> = line.split_whitespace().map(|t| t.parse().unwrap()).collect();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(v[7], v[4], v[5], v[6]));
        Pose::from_parts(Translation3::new(v[1], v[2], v[3]), rotation)
    })
    .collect()
}

/// A row-major 4x4 matrix in a text file.
pub fn read_pose(path: &std::path::Path) -> Pose {
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<f64> = text.split_whitespace().map(|t| t.parse().unwrap()).collect();
    crate::geometry::pose_from_rows(&rows.try_into().unwrap()).unwrap()
}
