//! Synthetic scenes and real scans for the tests of this module and of `slam6d`.

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};

use crate::geometry::Pose;
use crate::scan::Point;

/// A wall or floor: corner, two edges.
pub type Rectangle = ([f64; 3], [f64; 3], [f64; 3]);

/// A yard of 16 m x 12 m with a house corner, a box, a ramp and a pillar: surfaces face every way.
pub const YARD: [Rectangle; 9] = [
    ([-8.0, -6.0, -1.0], [16.0, 0.0, 0.0], [0.0, 12.0, 0.0]),
    ([-8.0, -6.0, -1.0], [16.0, 0.0, 0.0], [0.0, 0.0, 4.0]),
    ([8.0, -6.0, -1.0], [0.0, 12.0, 0.0], [0.0, 0.0, 5.0]),
    ([-8.0, 6.0, -1.0], [7.0, 0.0, 0.0], [0.0, 0.0, 3.0]),
    ([-1.0, 6.0, -1.0], [2.0, -2.0, 0.0], [0.0, 0.0, 3.0]),
    ([2.0, 2.0, -1.0], [1.5, 0.0, 0.0], [0.0, 0.0, 1.5]),
    ([2.0, 2.0, -1.0], [0.0, 1.5, 0.0], [0.0, 0.0, 1.5]),
    ([2.0, 2.0, 0.5], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0]),
    ([-6.0, -4.0, -1.0], [3.0, 0.0, 1.0], [0.0, 2.5, 0.0]),
];

/// A corridor along x, 60 m long, seen from its middle: floor and two walls, no ends.
pub const CORRIDOR: [Rectangle; 3] = [
    ([-30.0, -2.0, -1.0], [60.0, 0.0, 0.0], [0.0, 4.0, 0.0]),
    ([-30.0, -2.0, -1.0], [60.0, 0.0, 0.0], [0.0, 0.0, 3.0]),
    ([-30.0, 2.0, -1.0], [60.0, 0.0, 0.0], [0.0, 0.0, 3.0]),
];

/// A bare floor.
pub const FLOOR: [Rectangle; 1] = [([-12.0, -12.0, -1.0], [24.0, 0.0, 0.0], [0.0, 24.0, 0.0])];

/// Points drawn evenly over the rectangles (`per_square_metre`), within 1 cm of them, and seen from `map_from_scanner`
/// out to 15 m. Different seeds draw different points of the same scene.
pub fn scan_of(scene: &[Rectangle], map_from_scanner: &Pose, per_square_metre: f64, seed: u64) -> Vec<Point> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let scanner_from_map = map_from_scanner.inverse();
    let mut points = Vec::new();
    for (corner, u, v) in scene {
        let (corner, u, v) = (Point3::from(*corner), nalgebra::Vector3::from(*u), nalgebra::Vector3::from(*v));
        let normal = u.cross(&v).normalize();
        for _ in 0..(u.cross(&v).norm() * per_square_metre) as usize {
            let noise = normal * (uniform() - 0.5) * 0.02;
            let p = scanner_from_map * (corner + u * uniform() + v * uniform() + noise);
            if p.coords.norm() < 15.0 {
                points.push(Point::new(p.x as f32, p.y as f32, p.z as f32));
            }
        }
    }
    points
}

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
