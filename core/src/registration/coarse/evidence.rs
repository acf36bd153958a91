//! What speaks for and against a pose.

use nalgebra::{Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::range_image::length;
use super::{CoarseScan, sampling};
use crate::geometry::Pose;

/// A partner is looked for within so many cells.
const PAIR_CELLS: f64 = 1.0;
/// A matched point lies no farther from its partner's plane than so many cells.
const PLANE_CELLS: f64 = 0.35;
/// Without a plane, a matched point lies no farther from its partner than so many cells.
const POINT_CELLS: f64 = 0.5;
/// Normals of a matched pair differ by no more (cosine).
const LEAST_COSINE: f64 = 0.7;
/// A contradicted point stands this many cells in front of what was seen behind it,
const FREE_CELLS: f32 = 1.0;
/// and this share of its range, for thinning has moved both.
const FREE_SHARE: f32 = 0.03;
/// Points nearer to a scanner than this say nothing about what it saw [m].
const NEAREST_M: f32 = 1.0;
/// Directions with fewer points than this do not count as structure.
const LEAST_OF_A_DIRECTION: u32 = 6;

/// How well two scans agree under a pose, judged by nothing that found it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Evidence {
    /// The source's points laid over the target.
    pub forward: Agreement,
    /// The target's points laid over the source.
    pub backward: Agreement,
    /// Root mean square distance of matched points from the planes they lie on, both ways [m].
    pub residual_rms_m: f64,
    /// The least eigenvalue of the normalised Hessian of the matched points, as
    /// [`crate::registration::Constraint`] defines it: what holds the pose in its least certain direction.
    pub least_eigenvalue: f64,
}

/// How the points of one scan fit the other.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Agreement {
    /// Points laid over.
    pub points: u32,
    /// Of these, points that lie on a surface of the other scan that faces the same way.
    pub matched: u32,
    /// Points that stand where the other scan's rays passed.
    pub contradicted: u32,
    /// The mean over the directions that surfaces face of their share of matched points.
    pub structure: f64,
}

impl Agreement {
    /// The share of matched points.
    #[must_use]
    pub fn overlap(&self) -> f64 {
        f64::from(self.matched) / f64::from(self.points.max(1))
    }

    /// The share of contradicted points among the matched and contradicted.
    #[must_use]
    pub fn contradiction(&self) -> f64 {
        f64::from(self.contradicted) / f64::from((self.matched + self.contradicted).max(1))
    }
}

impl Evidence {
    /// Weighs a pose of two scans; `cell_m` is the one they were reduced with.
    #[must_use]
    pub fn new(target: &CoarseScan, source: &CoarseScan, target_from_source: &Pose, cell_m: f64) -> Self {
        let mut planes = Planes::default();
        let forward = lay_over(target, source, target_from_source, cell_m, &mut planes);
        let hessian = planes.hessian;
        let length_sq = planes.length_sq / f64::from(planes.pairs.max(1));
        let weight = f64::from(planes.pairs.max(1));
        let backward = lay_over(source, target, &target_from_source.inverse(), cell_m, &mut planes);
        Self {
            forward,
            backward,
            residual_rms_m: (planes.residual_sq / f64::from(planes.pairs.max(1))).sqrt(),
            least_eigenvalue: least_eigenvalue(&(hessian / weight), length_sq.sqrt()),
        }
    }

    /// From 0 to 1: structure matched both ways, less what is contradicted. It ranks poses of one pair of scans.
    #[must_use]
    pub fn score(&self) -> f64 {
        let one = |a: &Agreement| a.structure * (1.0 - a.contradiction()).powi(4);
        (one(&self.forward) * one(&self.backward)).sqrt()
    }
}

/// Sums over pairs with planes.
#[derive(Default)]
struct Planes {
    pairs: u32,
    residual_sq: f64,
    length_sq: f64,
    hessian: Matrix6<f64>,
}

impl Planes {
    fn add(&mut self, point: &Vector3<f64>, normal: &Vector3<f64>, residual: f64) {
        let lever = point.cross(normal);
        let row = Vector6::new(normal.x, normal.y, normal.z, lever.x, lever.y, lever.z);
        self.pairs += 1;
        self.residual_sq += residual * residual;
        self.length_sq += point.norm_squared();
        self.hessian += row * row.transpose();
    }
}

/// The least eigenvalue of D H D, D = diag(1, 1, 1, 1/L, 1/L, 1/L).
fn least_eigenvalue(hessian: &Matrix6<f64>, length_m: f64) -> f64 {
    let inverse = 1.0 / length_m.max(1e-3);
    let scale = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, inverse, inverse, inverse));
    (scale * hessian * scale).symmetric_eigenvalues().min().max(0.0)
}

/// Lays the points of `moving` over `fixed`.
fn lay_over(
    fixed: &CoarseScan,
    moving: &CoarseScan,
    fixed_from_moving: &Pose,
    cell_m: f64,
    planes: &mut Planes,
) -> Agreement {
    let rotation = fixed_from_moving.rotation.to_rotation_matrix().into_inner();
    let bound_sq = (PAIR_CELLS * cell_m).powi(2) as f32;
    let mut agreement = Agreement { points: moving.points().len() as u32, ..Agreement::default() };
    let mut directions = [[0_u32; 2]; sampling::BINS];
    for ((point, normal), bin) in moving.points().iter().zip(moving.normals()).zip(moving.bins()) {
        let p = Vector3::from(point.map(f64::from));
        let moved = rotation * p + fixed_from_moving.translation.vector;
        let at = [moved.x as f32, moved.y as f32, moved.z as f32];
        let matched = fixed.tree().nearest(at, bound_sq).is_some_and(|(near, distance_sq)| {
            let own = Vector3::from(normal.map(f64::from));
            let other = rotation.tr_mul(&Vector3::from(fixed.normals()[near as usize].map(f64::from)));
            if own == Vector3::zeros() || other == Vector3::zeros() {
                return f64::from(distance_sq) < (POINT_CELLS * cell_m).powi(2);
            }
            let partner = Vector3::from(fixed.points()[near as usize].map(f64::from));
            let residual = other.dot(&rotation.tr_mul(&(moved - partner)));
            let fits = own.dot(&other) > LEAST_COSINE && residual.abs() < PLANE_CELLS * cell_m;
            if fits {
                planes.add(&p, &other, residual);
            }
            fits
        });
        let direction = &mut directions[usize::from(*bin)];
        direction[0] += 1;
        if matched {
            agreement.matched += 1;
            direction[1] += 1;
        } else if is_contradicted(fixed, at, cell_m as f32) {
            agreement.contradicted += 1;
        }
    }
    agreement.structure = structure(&directions);
    agreement
}

/// Whether the scan's rays passed where the point stands.
fn is_contradicted(fixed: &CoarseScan, at: [f32; 3], cell_m: f32) -> bool {
    let range = length(at);
    range > NEAREST_M
        && fixed.ranges().free_range(at).is_some_and(|free| range < free - FREE_CELLS * cell_m - FREE_SHARE * free)
}

/// The mean share of matched points over the directions that have enough.
fn structure(directions: &[[u32; 2]]) -> f64 {
    let shares = directions.iter().filter(|[points, _]| *points >= LEAST_OF_A_DIRECTION);
    let (sum, count) = shares.fold((0.0, 0.0), |(sum, count), [points, matched]| {
        (sum + f64::from(*matched) / f64::from(*points), count + 1.0)
    });
    if count > 0.0 { sum / count } else { 0.0 }
}
