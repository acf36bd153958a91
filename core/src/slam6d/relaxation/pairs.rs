//! The point pairs of two scans and what they say about the motion between them.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::RelaxationConfig;
use crate::geometry::Pose;
use crate::registration::PreparedCloud;
use crate::registration::PreparedScan;

/// Two scans that see the same surfaces.
#[derive(Debug, Clone)]
pub(super) struct ScanPair {
    /// The scan whose planes are used.
    pub target: usize,
    /// The scan whose points are used.
    pub source: usize,
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
        Self { target, source, sum: PairSum::default() }
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
        let gate_sq = (round.gate_m * round.gate_m) as f32;
        let mut sum = PairSum::default();
        let mut met = 0_u32;
        // Each pair of scans begins at another point, so that all points have their say in some pair.
        let first = (self.target + self.source) % config.stride;
        let points = source.points().iter().skip(first).step_by(config.stride);
        for point in points {
            let local = Vector3::from(point.map(f64::from));
            let moved = rotation * local + translation;
            let Some((index, _)) = target.nearest([moved.x as f32, moved.y as f32, moved.z as f32], gate_sq) else {
                continue;
            };
            met += 1;
            let Some((normal, offset)) = target.plane(index as usize) else { continue };
            let normal = Vector3::from(normal.map(f64::from));
            let residual = normal.dot(&moved) - f64::from(offset);
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
            for (row, value) in j.iter().enumerate().take(column + 1) {
                self.hessian[(row, column)] += weighted * value;
            }
        }
        self.cost += (residual * residual).min(config.robust_scale_m * config.robust_scale_m);
        self.points += 1;
    }
}
