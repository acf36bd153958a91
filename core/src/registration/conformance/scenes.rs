//! Places made of rectangles, and scans of them.

use nalgebra::Point3;

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
