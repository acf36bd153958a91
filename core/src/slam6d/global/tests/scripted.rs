//! A registration method that knows the truth and errs as told: what loop closing does can be tested apart from what
//! registration does.

use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use crate::geometry::{Covariance, Pose, Twist, exp};
use crate::registration::{AlignError, Alignment, Constraint, Limits, PrepareError, PreparedScan, Registration};
use crate::scan::{Point, ScanView};

/// Standard deviations of a pair [m, rad].
const SIGMA_M: f64 = 0.02;
const SIGMA_ROTATION: f64 = 0.012;
/// Scans see each other within this distance [m].
const RANGE_M: f64 = 8.0;
/// A start farther off than this is not recovered from [m].
const BASIN_M: f64 = 4.0;
/// The first point of a scan tells which one it is: so much along x for each [m].
const MARK_M: f32 = 0.01;

/// What happens in a survey.
pub struct Script {
    /// Where the scanner truly was.
    pub truth: Vec<Pose>,
    /// Pairs that look alike though they are not: what registration then finds, by target and source.
    pub alike: BTreeMap<(usize, usize), Pose>,
    pub seed: u64,
}

impl Script {
    /// `count` scans on a circle, the last laps over the first.
    pub fn circle(count: usize, radius_m: f64, laps: f64, seed: u64) -> Self {
        let pose = |k: usize| {
            let angle = k as f64 / count as f64 * laps * std::f64::consts::TAU;
            let place = Vector3::new(radius_m * angle.sin(), radius_m * (1.0 - angle.cos()), 0.0);
            Pose::new(place, Vector3::z() * angle)
        };
        let truth = (0..count).map(|k| pose(0).inverse() * pose(k)).collect();
        Self { truth, alike: BTreeMap::new(), seed }
    }

    /// What the scanner sees: its mark, and posts on a grid within its range.
    pub fn scan(&self, k: usize) -> Vec<Point> {
        let scanner_from_map = self.truth[k].inverse();
        let here = self.truth[k].translation.vector;
        let mut points = vec![Point::new(MARK_M * k as f32, 0.0, 0.0)];
        let (low, high) = (here.add_scalar(-RANGE_M), here.add_scalar(RANGE_M));
        let cells = |low: f64, high: f64| (low / 1.3).ceil() as i64..=(high / 1.3).floor() as i64;
        for x in cells(low.x, high.x) {
            for y in cells(low.y, high.y) {
                let p = scanner_from_map * Point3::new(1.3 * x as f64, 1.3 * y as f64, 0.3);
                if p.coords.norm() < RANGE_M {
                    points.push(Point::new(p.x as f32, p.y as f32, p.z as f32));
                }
            }
        }
        points
    }

    /// Three normal numbers for positions, three for angles, the same for the same pair.
    fn noise(&self, target: usize, source: usize) -> Twist {
        let mut state = self.seed ^ ((target as u64) << 32 | source as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut uniform = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        normal();
        Twist::from_fn(|k, _| normal() * if k < 3 { SIGMA_M } else { SIGMA_ROTATION })
    }
}

/// The method.
pub struct Scripted(pub Arc<Script>);

struct Seen {
    scan: usize,
    points: Vec<[f32; 3]>,
}

impl PreparedScan for Seen {
    fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    fn bytes(&self) -> usize {
        size_of_val(&*self.points)
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

impl Registration for Scripted {
    fn name(&self) -> &str {
        "scripted"
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        let points: Vec<[f32; 3]> = scan.points.iter().map(|p| [p.x, p.y, p.z]).collect();
        Ok(Box::new(Seen { scan: (points[0][0] / MARK_M).round() as usize, points }))
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        start: &Pose,
        _limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let scan = |seen: &dyn PreparedScan| seen.as_any().downcast_ref::<Seen>().unwrap().scan;
        let (i, j) = (scan(target), scan(source));
        let truth = self.0.truth[i].inverse() * self.0.truth[j];
        let alike = self.0.alike.get(&(i, j));
        let sees = truth.translation.vector.norm() < RANGE_M
            && (start.translation.vector - truth.translation.vector).norm() < BASIN_M;
        let (found, overlap) = match alike {
            Some(pose) => (*pose, 0.9),
            None if sees => (truth * exp(&self.0.noise(i, j)), 0.8),
            None => (*start, 0.1),
        };
        let mut covariance = Covariance::identity() * SIGMA_M.powi(2);
        covariance.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(SIGMA_ROTATION.powi(2));
        Ok(Alignment {
            target_from_source: found,
            covariance,
            overlap,
            overlap_distance_m: 0.3,
            residual_rms_m: 0.02,
            cost: 1e-3,
            iterations: 5,
            converged: true,
            limit_reached: false,
            constraint: Constraint { eigenvalues: [0.3; 6], ..Constraint::none(0.01) },
        })
    }
}
