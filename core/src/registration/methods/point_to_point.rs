//! Point to point: the iterative closest point algorithm of Besl and McKay (1992), with the source's two changes
//! (section 3, step 3): the result stays within d_max of the start, and the best of all estimates is returned.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::point_to_plane::PointToPlane;
use crate::geometry::{self, Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{BATCH, PairSum, Pairs};
use crate::registration::{Constraint, RegistrationConfig};

/// Points of a surface pair with whatever lies nearest on it and so resist sliding: the share of their spread by which
/// they pull a direction that only other points determine. It covers what the tests measure, with room to spare.
const PULL: f64 = 0.02;

/// Point to point: minimises the sum of squared distances of the pairs (3.4), in closed form at each step.
///
/// The planes serve only to tell which directions are constrained: distances between points look certain in every
/// direction, even along a bare wall.
pub(in crate::registration) struct PointToPoint;

/// Moments of the paired points, in the target's frame.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum {
    evidence: Evidence,
    /// Pairs that were not trimmed.
    pulling: u32,
    source: Vector3<f64>,
    target: Vector3<f64>,
    cross: Matrix3<f64>,
}

impl PairSum for Sum {
    type Settings = Gates;

    #[inline(always)]
    fn add(&mut self, gates: &Gates, pairs: &Pairs<'_>) {
        let mut weights = [0.0; BATCH];
        for k in 0..pairs.count {
            let distance_sq = pairs.distance_sq[k];
            self.evidence.overlapping += u32::from(distance_sq < gates.overlap_sq);
            if distance_sq < gates.judged_sq {
                self.evidence.judged += 1;
                self.evidence.cost_sum += f64::from(distance_sq);
            }
            if distance_sq < gates.pair_sq && self.evidence.takes(gates, distance_sq) {
                self.pulling += 1;
                weights[k] = if pairs.has_plane(k) { 1.0 } else { 0.0 };
                let (source, target) = (pairs.moved_point(k), pairs.partner_point(k));
                self.source += source;
                self.target += target;
                self.cross += target * source.transpose();
            }
        }
        self.evidence.plane.add(pairs, &pairs.normal, &pairs.residual, &weights);
    }

    fn merge(&mut self, other: &Self) {
        self.evidence.merge(&other.evidence);
        self.pulling += other.pulling;
        self.source += other.source;
        self.target += other.target;
        self.cross += other.cross;
    }
}

impl Minimiser for PointToPoint {
    type Sum = Sum;
    /// From afar points say little about where their surfaces are; planes lead there in a few steps.
    type Approach = PointToPlane;
    const NAME: &'static str = "point_to_point";
    const IS_ROBUST: bool = false;
    const TOLERANCE_SHARE: f64 = 0.25;

    fn settings(_: &RegistrationConfig, gates: &Gates) -> Gates {
        *gates
    }

    fn evidence(sum: &Sum) -> &Evidence {
        &sum.evidence
    }

    fn finish(sum: &mut Sum, target_from_source: &Pose) {
        sum.evidence.plane.equations.turn(target_from_source);
    }

    /// The best rigid motion between the paired points, by the singular value decomposition of their cross covariance
    /// (Arun, Huang, Blostein 1987). It is exact, so there is nothing to damp.
    fn step(sum: &Sum, target_from_source: &Pose, constraint: &Constraint, _damping: f64) -> Option<Twist> {
        let count = f64::from(sum.pulling.max(1));
        let (source, target) = (sum.source / count, sum.target / count);
        let svd = (sum.cross / count - target * source.transpose()).svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        // A reflection would fit flat scenes as well as the rotation does; the sign rules it out.
        let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
        let rotation = u * sign * v_t;
        let motion = Pose::from_parts(
            Translation3::from(target - rotation * source),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
        );
        let step = geometry::log(&(target_from_source.inverse() * motion * target_from_source));
        // Exact where all six directions are known; the projection would only add rounding.
        Some(if constraint.mask() == 0b11_1111 { step } else { constraint.project(&step) })
    }

    fn unpaired_cost(_: &RegistrationConfig, judged_m: f64) -> f64 {
        judged_m * judged_m
    }

    fn errors(sum: &Sum, share: f64, _overlap: f64) -> ErrorModel {
        // A third of the squared distance falls on any one axis.
        let variance = sum.evidence.residual_sq / (3.0 * f64::from(sum.evidence.pairs.max(1)));
        ErrorModel { variance, share, bias_m: PULL * variance.sqrt() }
    }
}
