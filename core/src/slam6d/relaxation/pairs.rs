//! The point pairs of two scans and what they say about the motion between them.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::RelaxationConfig;
use crate::geometry::Pose;
use crate::registration::PreparedCloud;
use crate::registration::PreparedScan;

/// No partner found so far.
const NO_PARTNER: u32 = u32::MAX;

/// Two scans that see the same surfaces.
#[derive(Debug, Clone)]
pub(super) struct ScanPair {
    /// The scan whose planes are used.
    pub target: usize,
    /// The scan whose points are used.
    pub source: usize,
    /// The partners found last, of each point that looks for one: they bound the next search.
    partners: Vec<u32>,
    /// What the pairs of points say.
    pub sum: PairSum,
}

/// The normal equations of the distances to the target's planes, by a perturbation of the source's pose on the right.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PairSum {
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
    /// Sum of the cut-off squared distances [m^2] and the points that have one.
    pub cost: f64,
    pub points: u32,
    /// The share of the points that have a partner.
    pub overlap: f64,
}

/// What is the same for all pairs of a round.
pub(super) struct Round {
    pub gate_m: f64,
    pub scale_m: f64,
}

impl ScanPair {
    pub fn new(target: usize, source: usize) -> Self {
        Self { target, source, partners: Vec::new(), sum: PairSum::default() }
    }

    /// Finds partners anew and sums over them.
    pub fn find(
        &mut self,
        target: &PreparedCloud,
        source: &PreparedCloud,
        target_from_source: &Pose,
        round: &Round,
        config: &RelaxationConfig,
    ) {
        let rotation: Matrix3<f64> = target_from_source.rotation.to_rotation_matrix().into_inner();
        let translation = target_from_source.translation.vector;
        let asking = source.points().len().div_ceil(config.stride);
        self.partners.resize(asking, NO_PARTNER);
        let gate_sq = (round.gate_m * round.gate_m) as f32;
        let mut sum = PairSum::default();
        let mut met = 0_u32;
        // Each pair of scans begins at another point, so that all points have their say in some pair.
        let first = (self.target + self.source) % config.stride;
        let points = source.points().iter().skip(first).step_by(config.stride);
        for (point, partner) in points.zip(&mut self.partners) {
            let local = Vector3::from(point.map(f64::from));
            let moved = rotation * local + translation;
            let Some(index) = nearest(target, &moved, partner, gate_sq) else { continue };
            met += 1;
            let normal = Vector3::from(target.normals()[index].map(f64::from));
            if normal == Vector3::zeros() {
                continue;
            }
            let residual = normal.dot(&(moved - Vector3::from(target.points()[index].map(f64::from))));
            sum.add(&local, &rotation.tr_mul(&normal), residual, round, config);
        }
        sum.overlap = f64::from(met) / asking as f64;
        sum.hessian.fill_lower_triangle_with_upper_triangle();
        self.sum = sum;
    }
}

impl PairSum {
    #[inline]
    fn add(
        &mut self,
        point: &Vector3<f64>,
        normal: &Vector3<f64>,
        residual: f64,
        round: &Round,
        config: &RelaxationConfig,
    ) {
        let weight = config.robust_kernel.weight(residual, round.scale_m);
        let turning = point.cross(normal);
        let j = [normal.x, normal.y, normal.z, turning.x, turning.y, turning.z];
        for column in 0..6 {
            let weighted = weight * j[column];
            self.gradient[column] += weighted * residual;
            for row in 0..=column {
                self.hessian[(row, column)] += weighted * j[row];
            }
        }
        self.cost += (residual * residual).min(config.robust_scale_m * config.robust_scale_m);
        self.points += 1;
    }
}

/// The index of the target's point nearest to `moved`, if one is within the gate. The partner of the last round bounds
/// the search.
#[inline]
fn nearest(target: &PreparedCloud, moved: &Vector3<f64>, partner: &mut u32, gate_sq: f32) -> Option<usize> {
    let query = [moved.x as f32, moved.y as f32, moved.z as f32];
    let mut bound_sq = gate_sq;
    let mut found = None;
    if let Some(last) = target.points().get(*partner as usize) {
        let offset: [f32; 3] = std::array::from_fn(|k| query[k] - last[k]);
        let distance_sq = offset.iter().map(|value| value * value).sum::<f32>();
        if distance_sq < bound_sq {
            bound_sq = distance_sq;
            found = Some(*partner);
        }
    }
    if let Some((closer, _)) = target.tree().nearest(query, bound_sq) {
        found = Some(closer);
    }
    *partner = found.unwrap_or(NO_PARTNER);
    found.map(|index| index as usize)
}
