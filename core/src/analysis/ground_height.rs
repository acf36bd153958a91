//! How high the scanner stands over the ground under the robot, where no mount is known.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::config::ScoreConfig;
use crate::scan::{Point, ScanView};
use crate::surface::Surface;

/// Where a scanner height is from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GroundHeightOrigin {
    /// The config says so.
    Configured,
    /// Estimated from the scan.
    Estimated,
    /// Neither: the config's assumption. Scores may be off by the error of this height.
    Assumed,
}

/// The height of the scanner over the ground under the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundHeight {
    /// The height [m].
    pub scanner_height_m: f64,
    /// Where it is from.
    pub origin: GroundHeightOrigin,
}

impl GroundHeight {
    /// The configured height if there is one, else the scan's estimate, else the config's assumption.
    #[must_use]
    pub fn resolve(
        config: &ScoreConfig,
        scan: ScanView<'_>,
        surface: &Surface,
        level_from_scanner: &UnitQuaternion<f64>,
    ) -> Self {
        if let Some(scanner_height_m) = config.scanner_height_m {
            return Self { scanner_height_m, origin: GroundHeightOrigin::Configured };
        }
        match estimate_ground_height(scan, surface, level_from_scanner) {
            Some(scanner_height_m) => Self { scanner_height_m, origin: GroundHeightOrigin::Estimated },
            None => Self { scanner_height_m: config.assumed_scanner_height_m, origin: GroundHeightOrigin::Assumed },
        }
    }
}

/// Horizontal distances within which ground is looked for, one after the other [m]: nearer is better, since slopes and
/// steps spoil what is farther away.
const RADII: [f32; 3] = [2.5, 5.0, 10.0];

/// Points whose normal is steeper than this (25 deg) are no ground.
const COS_SLOPE_MAX: f32 = 0.906;

/// Bins of the height histogram [m] and their number: depths of 0 to 6.4 m below the scanner.
const BIN: f32 = 0.05;
const BINS: usize = 128;

/// A level counts as ground when it holds this share of the largest one's surface, and it is the lowest such level.
const LEVEL_SHARE: f32 = 0.3;

/// The least surface and number of points an estimate rests on [m^2].
const AREA_MIN: f32 = 0.1;
const POINTS_MIN: usize = 30;

/// One point's weight is at most this share of the surface, so that no long grazing triangle decides alone [m^2].
const AREA_CAP: f32 = 0.02;

/// About so many points of the scan are looked at, evenly chosen.
const SAMPLES: usize = 20_000;

/// Points within this of the fitted plane refine it [m].
const INLIER_MAX: f32 = 0.15;

/// Rounds of refinement: each lets the plane grow over a slope.
const ROUNDS: usize = 6;

/// The height of the scanner over the ground under it [m], or `None` when too little level surface lies close by.
///
/// The heights of all near-horizontal points close to the scanner, each with its share of the surface, make a histogram.
/// The lowest level that holds a fair share of the surface is the start (a table is larger than the floor only rarely,
/// and a reflection below the floor is small). A plane is then fitted to what lies near that level, again and again, so
/// that on a slope the height under the scanner is found, not that of the slope's foot.
#[must_use]
pub fn estimate_ground_height(
    scan: ScanView<'_>,
    surface: &Surface,
    level_from_scanner: &UnitQuaternion<f64>,
) -> Option<f64> {
    let rotation: Matrix3<f32> = level_from_scanner.to_rotation_matrix().into_inner().cast();
    let stride = sampling_stride(&scan);
    let mut ground = Candidates::default();
    RADII.iter().find_map(|radius| {
        ground.gather(scan, surface, &rotation, stride, radius * radius);
        let level = ground.lowest_level()?;
        let height = -ground.refine(level);
        (height.is_finite() && height > 0.0).then_some(height)
    })
}

/// The step between the points looked at: coprime to the columns, so that no column is left out.
fn sampling_stride(scan: &ScanView<'_>) -> usize {
    let cols = scan.grid.map_or(1, |grid| grid.cols.max(1));
    let common = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let least = scan.points.len().div_ceil(SAMPLES).max(1);
    (least..).find(|stride| common(*stride, cols) == 1).unwrap_or(1)
}

/// The points among which ground is looked for.
#[derive(Default)]
struct Candidates {
    /// Level positions [m] and weights [m^2].
    points: Vec<(Vector3<f32>, f32)>,
}

impl Candidates {
    /// Replaces the points by those of the scan that lie within a horizontal distance, below the scanner and level.
    fn gather(&mut self, scan: ScanView<'_>, surface: &Surface, rotation: &Matrix3<f32>, stride: usize, radius2: f32) {
        self.points.clear();
        let (points, shapes) = (scan.points, surface.points());
        // Most points are sky or far away: one that has no link with another has no surface either, which is told without
        // looking at its shape.
        let links = surface.links();
        let has_links = surface.topology().is_some() && links.len() == points.len();
        let m = rotation;
        for k in (0..points.len().min(shapes.len())).step_by(stride) {
            if has_links && links[k] == 0 {
                continue;
            }
            // Written out, as nalgebra's products are not inlined here.
            let Point { x, y, z, .. } = points[k];
            let p = Vector3::new(
                m.m11 * x + m.m12 * y + m.m13 * z,
                m.m21 * x + m.m22 * y + m.m23 * z,
                m.m31 * x + m.m32 * y + m.m33 * z,
            );
            if p.z >= 0.0 || p.x * p.x + p.y * p.y > radius2 {
                continue;
            }
            let shape = &shapes[k];
            let [x, y, z] = shape.normal;
            let normal_z = m.m31 * x + m.m32 * y + m.m33 * z;
            if shape.is_valid() && normal_z >= COS_SLOPE_MAX {
                self.points.push((p, shape.area.min(AREA_CAP)));
            }
        }
    }

    /// The height of the lowest level with a fair share of the surface [m].
    fn lowest_level(&self) -> Option<f64> {
        let (mut histogram, mut points, mut area) = ([0.0f32; BINS], 0usize, 0.0f32);
        for &(p, weight) in &self.points {
            if let Some(bin) = histogram.get_mut((-p.z / BIN) as usize) {
                *bin += weight;
                points += 1;
                area += weight;
            }
        }
        if points < POINTS_MIN || area < AREA_MIN {
            return None;
        }
        // Noise spreads a level over its bins' borders: three bins together are one level.
        let level = |i: usize| histogram[i.saturating_sub(1)..(i + 2).min(BINS)].iter().sum::<f32>();
        let largest = (0..BINS).map(level).fold(0.0, f32::max);
        let is_peak = |i: usize| {
            let here = level(i);
            here >= LEVEL_SHARE * largest && (i == 0 || level(i - 1) <= here) && (i + 1 >= BINS || level(i + 1) < here)
        };
        (0..BINS).rev().find(|i| is_peak(*i)).map(|i| -(i as f64 + 0.5) * f64::from(BIN))
    }

    /// The height under the scanner of the plane through the ground near `level` [m].
    fn refine(&self, level: f64) -> f64 {
        let mut plane = Vector3::new(level, 0.0, 0.0);
        for _ in 0..ROUNDS {
            // Written out, as nalgebra's products are not inlined here.
            let (mut sums, mut right) = ([[0.0; 3]; 3], Vector3::<f64>::zeros());
            for (p, weight) in &self.points {
                let (x, y, z) = (f64::from(p.x), f64::from(p.y), f64::from(p.z));
                let is_near = (z - (plane.x + x * plane.y + y * plane.z)).abs() <= f64::from(INLIER_MAX);
                if !is_near {
                    continue;
                }
                let (weight, row) = (f64::from(*weight), [1.0, x, y]);
                for i in 0..3 {
                    for k in 0..3 {
                        sums[k][i] += weight * row[i] * row[k];
                    }
                    right[i] += weight * z * row[i];
                }
            }
            let mut normal_matrix = Matrix3::from(sums);
            // Damped tilt (1 cm^2 of surface at 1 m): a single line of points cannot turn the plane.
            normal_matrix[(1, 1)] += 1e-4;
            normal_matrix[(2, 2)] += 1e-4;
            let Some(next) = normal_matrix.try_inverse().map(|inverse| inverse * right) else { break };
            plane = next;
        }
        plane[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::test_scans::{Shape, TestScan, ground, handheld_recording, pitching_recording, turning};
    use crate::surface::{SurfaceBuilder, SurfaceConfig};

    fn estimate(scan: ScanView<'_>) -> Option<f64> {
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
        estimate_ground_height(scan, surface, &UnitQuaternion::identity())
    }

    fn near(scan: &TestScan, height: f64, tolerance: f64) {
        let found = estimate(scan.view()).unwrap();
        assert!((found - height).abs() < tolerance, "{found} instead of {height}");
    }

    #[test]
    fn the_height_over_flat_ground_is_found_within_a_centimetre() {
        for height in [0.3, 1.0, 1.8] {
            near(&turning(&[ground(height)], 1.0, 10.0, 0.01, 11), height, 0.01);
        }
    }

    #[test]
    fn on_a_slope_it_is_the_height_under_the_scanner() {
        for slope_deg in [8.0f64, 15.0] {
            let (sin, cos) = slope_deg.to_radians().sin_cos();
            let slope = Shape::Plane { normal: Vector3::new(-sin, 0.0, cos), offset: -cos };
            near(&turning(&[slope], 1.0, 30.0, 0.01, 12), 1.0, 0.03);
        }
    }

    #[test]
    fn a_table_beside_the_scanner_is_not_the_ground() {
        let table = Shape::Block { from: Vector3::new(0.8, -1.0, -1.2), to: Vector3::new(2.0, 1.0, -0.5) };
        near(&turning(&[ground(1.2), table], 1.0, 10.0, 0.005, 13), 1.2, 0.01);
    }

    #[test]
    fn a_tilted_scanner_is_levelled_first() {
        let tilt = UnitQuaternion::from_euler_angles(0.1, -0.15, 0.7);
        let down = tilt.inverse() * Vector3::z();
        let scan = turning(&[Shape::Plane { normal: down, offset: -1.0 }], 1.0, 10.0, 0.005, 14);
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
        let found = estimate_ground_height(scan.view(), surface, &tilt).unwrap();
        assert!((found - 1.0).abs() < 0.01, "{found}");
    }

    #[test]
    fn without_ground_there_is_no_estimate_and_the_assumption_is_flagged() {
        let wall = [Shape::Plane { normal: Vector3::x(), offset: 3.0 }];
        let scan = turning(&wall, 1.0, 10.0, 0.0, 15);
        assert_eq!(estimate(scan.view()), None);
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
        let resolve =
            |config: &ScoreConfig| GroundHeight::resolve(config, scan.view(), surface, &UnitQuaternion::identity());
        let assumed = GroundHeight { scanner_height_m: 1.0, origin: GroundHeightOrigin::Assumed };
        assert_eq!(resolve(&ScoreConfig::default()), assumed);
        let configured = ScoreConfig { scanner_height_m: Some(0.7), ..ScoreConfig::default() };
        assert_eq!(resolve(&configured).origin, GroundHeightOrigin::Configured);
    }

    #[test]
    fn recorded_scans_have_a_plausible_ground() {
        let name = "recorded_scans_have_a_plausible_ground";
        if let Some(scan) = pitching_recording(name) {
            let height = estimate(scan.view()).unwrap();
            println!("pitching head: {height:.3} m");
            assert!((0.2..1.5).contains(&height));
        }
        if let Some(points) = handheld_recording(name) {
            let height = estimate(ScanView::unordered(&points)).unwrap();
            println!("handheld: {height:.3} m");
            assert!((0.8..2.2).contains(&height));
        }
    }
}
