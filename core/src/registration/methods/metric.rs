//! What GICP, its voxelised form and the normal distributions transform have in common: pairs judged by a 3x3 metric,
//! the inverse of a covariance, `d^T M d` with d the way from the partner to the moved source point.

use crate::geometry::{Pose, Twist};
use crate::registration::Constraint;
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::{ErrorModel, NormalEquations};
use crate::registration::pairs::{BATCH, LANES, Pairs};
use crate::registration::robust::Kernel;
use crate::registration::symmetric3::Symmetric3;

/// A batch of residuals with their metrics and weights, side by side.
pub(super) struct Metrics {
    pub offset: [[f32; BATCH]; 3],
    pub metric: [[f32; BATCH]; 6],
    pub weight: [f32; BATCH],
}

/// The distances and scales of a pass.
pub(in crate::registration) struct Settings {
    pub gates: Gates,
    pub kernel: Kernel,
    pub final_scale_sq: f32,
}

/// The normal equations, with the evidence of point to plane beside them.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum {
    pub evidence: Evidence,
    pub equations: NormalEquations,
}

impl Default for Metrics {
    fn default() -> Self {
        Self { offset: [[0.0; BATCH]; 3], metric: [[0.0; BATCH]; 6], weight: [0.0; BATCH] }
    }
}

impl Metrics {
    /// The residual of pair k.
    #[inline(always)]
    pub fn set(&mut self, k: usize, offset: [f32; 3], metric: Symmetric3, weight: f32) {
        for axis in 0..3 {
            self.offset[axis][k] = offset[axis];
        }
        for entry in 0..6 {
            self.metric[entry][k] = metric[entry];
        }
        self.weight[k] = weight;
    }
}

impl Sum {
    /// Adds the part every method reports, and tells which pairs are near enough to pull.
    #[inline(always)]
    pub fn add_evidence(&mut self, settings: &Settings, pairs: &Pairs<'_>) {
        let mut weights = [0.0; BATCH];
        for k in 0..pairs.count {
            self.evidence.overlapping += u32::from(pairs.distance_sq[k] < settings.gates.overlap_sq);
            if pairs.has_plane(k) && pairs.distance_sq[k] < settings.gates.pair_sq {
                weights[k] = settings.kernel.weight(pairs.residual[k] * pairs.residual[k]);
            }
        }
        self.evidence.plane.add(pairs, &pairs.normal, &pairs.residual, &weights);
    }

    /// Adds `J^T M J` and `J^T M d` of every pair, J = [1, -[arm]x].
    #[inline(always)]
    pub fn add_metrics(&mut self, pairs: &Pairs<'_>, metrics: &Metrics) {
        let mut hessian = [[0.0_f32; LANES]; 21];
        let mut gradient = [[0.0_f32; LANES]; 6];
        for first in (0..pairs.count).step_by(LANES) {
            let lanes = |values: &[f32; BATCH]| {
                let mut out = [0.0_f32; LANES];
                out.copy_from_slice(&values[first..first + LANES]);
                out
            };
            let a = [lanes(&pairs.arm[0]), lanes(&pairs.arm[1]), lanes(&pairs.arm[2])];
            let d = [lanes(&metrics.offset[0]), lanes(&metrics.offset[1]), lanes(&metrics.offset[2])];
            let w = lanes(&metrics.weight);
            let m: [[f32; LANES]; 6] = [
                lanes(&metrics.metric[0]),
                lanes(&metrics.metric[1]),
                lanes(&metrics.metric[2]),
                lanes(&metrics.metric[3]),
                lanes(&metrics.metric[4]),
                lanes(&metrics.metric[5]),
            ];
            for k in 0..LANES {
                let metric = [[m[0][k], m[1][k], m[2][k]], [m[1][k], m[3][k], m[4][k]], [m[2][k], m[4][k], m[5][k]]];
                let (x, y, z) = (a[0][k], a[1][k], a[2][k]);
                // Columns of J: the three axes, then the axes turned about the arm.
                let columns =
                    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
                let mut entry = 0;
                for row in 0..6 {
                    let mut weighted = [0.0; 3];
                    for axis in 0..3 {
                        let c = columns[row];
                        weighted[axis] =
                            w[k] * (c[0] * metric[0][axis] + c[1] * metric[1][axis] + c[2] * metric[2][axis]);
                    }
                    let along = |v: [f32; 3]| weighted[0] * v[0] + weighted[1] * v[1] + weighted[2] * v[2];
                    gradient[row][k] += along([d[0][k], d[1][k], d[2][k]]);
                    for column in &columns[row..] {
                        hessian[entry][k] += along(*column);
                        entry += 1;
                    }
                }
            }
        }
        self.equations.add_lanes(&hessian, &gradient);
    }

    /// Adds the sum of another block.
    pub fn merge(&mut self, other: &Self) {
        self.evidence.merge(&other.evidence);
        self.equations.merge(&other.equations);
    }

    /// Turns the sums from the target's axes to the source's.
    pub fn finish(&mut self, target_from_source: &Pose) {
        self.evidence.plane.equations.turn(target_from_source);
        self.equations.turn(target_from_source);
    }

    /// The Gauss-Newton step.
    pub fn step(&self, constraint: &Constraint, damping: f64) -> Option<Twist> {
        self.equations.step(constraint, damping)
    }

    /// How the pairs err: as by point to plane, whose evidence this is.
    pub fn errors(&self, share: f64, overlap: f64) -> ErrorModel {
        super::point_to_plane::errors_of(&self.evidence, share, overlap)
    }
}
