//! Analytic scans for tests: rays cast on planes and boxes, by a head that turns about z or pitches.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};

use crate::scan::{Grid, Point, ScanView};

/// An owned scan.
#[derive(Debug, Clone)]
pub(crate) struct TestScan {
    pub(crate) points: Vec<Point>,
    pub(crate) grid: Grid,
}

impl TestScan {
    pub(crate) fn view(&self) -> ScanView<'_> {
        ScanView::ordered(&self.points, self.grid).unwrap()
    }

    /// The same scan with rows for columns.
    pub(crate) fn transposed(&self) -> Self {
        let Grid { rows, cols } = self.grid;
        let points = (0..rows * cols).map(|i| self.points[(i % rows) * cols + i / rows]).collect();
        Self { points, grid: Grid { rows: cols, cols: rows } }
    }
}

/// A surface of the scene.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// The points p with n.p = offset, n a unit vector.
    Plane { normal: Vector3<f64>, offset: f64 },
    /// An axis-aligned box.
    Block { from: Vector3<f64>, to: Vector3<f64> },
}

/// Level ground below the scanner.
pub(crate) fn ground(height: f64) -> Shape {
    Shape::Plane { normal: Vector3::z(), offset: -height }
}

fn cast_one(shape: &Shape, ray: &Vector3<f64>) -> Option<f64> {
    match shape {
        Shape::Plane { normal, offset } => Some(offset / normal.dot(ray)).filter(|t| *t > 0.0 && t.is_finite()),
        Shape::Block { from, to } => {
            let (mut near, mut far) = (0.0f64, f64::INFINITY);
            for axis in 0..3 {
                let (a, b) = (from[axis] / ray[axis], to[axis] / ray[axis]);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            (near > 0.0 && near <= far).then_some(near)
        }
    }
}

/// Casts one ray from the origin; beyond 50 m there is no return. Noise is along the ray.
fn cast(scene: &[Shape], ray: Vector3<f64>, noise: f64) -> Point {
    let hit = scene.iter().filter_map(|shape| cast_one(shape, &ray)).fold(f64::INFINITY, f64::min);
    if hit > 50.0 {
        return Point::EMPTY;
    }
    let p = ray * (hit + noise);
    Point::new(p.x as f32, p.y as f32, p.z as f32)
}

fn scan(scene: &[Shape], grid: Grid, sigma_m: f64, seed: u64, ray: impl Fn(usize, usize) -> Vector3<f64>) -> TestScan {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, sigma_m).unwrap();
    let points =
        (0..grid.cells()).map(|i| cast(scene, ray(i / grid.cols, i % grid.cols), normal.sample(&mut rng))).collect();
    TestScan { points, grid }
}

/// A vertical sweep on a head that turns a full circle about z: rows are sweeps, columns elevations from -60 deg on.
pub(crate) fn turning(scene: &[Shape], step_deg: f64, top_deg: f64, sigma_m: f64, seed: u64) -> TestScan {
    let grid = Grid { rows: (360.0 / step_deg).round() as usize, cols: ((top_deg + 60.0) / step_deg) as usize + 1 };
    scan(scene, grid, sigma_m, seed, |row, col| {
        let (az, el) = ((row as f64 * step_deg).to_radians(), (col as f64 * step_deg - 60.0).to_radians());
        Vector3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin())
    })
}

/// A planar sweep of 180 deg from right to left on a head that pitches about y from -60 deg to `top_deg`.
pub(crate) fn pitching(scene: &[Shape], step_deg: f64, top_deg: f64, sigma_m: f64, seed: u64) -> TestScan {
    let grid = Grid { rows: ((top_deg + 60.0) / step_deg) as usize + 1, cols: (180.0 / step_deg) as usize + 1 };
    scan(scene, grid, sigma_m, seed, |row, col| {
        let (pitch, beam) = ((row as f64 * step_deg - 60.0).to_radians(), (col as f64 * step_deg - 90.0).to_radians());
        Vector3::new(beam.cos() * pitch.cos(), beam.sin(), beam.cos() * pitch.sin())
    })
}

/// The folder of recorded scans, or `None` after saying that the test is skipped.
pub(crate) fn data_folder(test: &str) -> Option<std::path::PathBuf> {
    crate::test_data::data(test, "")
}

/// The first scan of the pitching indoor laser: 226 sweeps of 360 beams, centimetres, left-handed.
pub(crate) fn pitching_recording(test: &str) -> Option<TestScan> {
    let text = std::fs::read_to_string(data_folder(test)?.join("3dtk_dat/scan000.3d")).unwrap();
    let points: Vec<Point> = text
        .lines()
        .map(|line| {
            let v: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
            let p = Vector3::new(v[2] / 100.0, -v[0] / 100.0, v[1] / 100.0);
            if p.norm() > 32.7 || p.norm() < 0.25 {
                return Point::EMPTY;
            }
            Point::new(p.x as f32, p.y as f32, p.z as f32)
        })
        .collect();
    assert_eq!(points.len(), 226 * 360);
    Some(TestScan { points, grid: Grid { rows: 226, cols: 360 } })
}

/// The first scan of the handheld recording: 30k points without an order.
pub(crate) fn handheld_recording(test: &str) -> Option<Vec<Point>> {
    let bytes = std::fs::read(data_folder(test)?.join("handheld/scan000.xyz32.bin")).unwrap();
    let value = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    Some((0..bytes.len() / 12).map(|i| Point::new(value(12 * i), value(12 * i + 4), value(12 * i + 8))).collect())
}
