//! Point to point: the iterative closest point algorithm of Besl and McKay (1992), with the source's two changes
//! (section 3, step 3): the result stays within d_max of the start, and the best of all estimates is returned.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::correspondences::{Matcher, Pair, PairSum};
use super::information::ErrorModel;
use super::iteration::{Evidence, Minimiser, Problem};
use super::prepared::PreparedCloud;
use super::{AlignError, Alignment, Constraint, Limits, PrepareError, PreparedScan, Registration, RegistrationConfig};
use crate::geometry::{self, Pose, Twist};
use crate::scan::ScanView;

/// Points of a surface pair with whatever lies nearest on it and so resist sliding: the share of their spread by which
/// they pull a direction that only other points determine. It covers what the tests measure, with room to spare.
const PULL: f64 = 0.02;

/// Point to point: minimises the sum of squared distances of the pairs (3.4), in closed form at each step.
///
/// The normals it also computes serve only to tell which directions are constrained: distances between points look
/// certain in every direction, even along a bare wall.
#[derive(Debug, Default)]
pub struct PointToPoint {
    config: RegistrationConfig,
    matcher: Matcher<Sum>,
}

impl PointToPoint {
    /// The name in configurations.
    pub const NAME: &str = "point_to_point";

    /// The method with these settings.
    #[must_use]
    pub fn new(config: RegistrationConfig) -> Self {
        Self { config, matcher: Matcher::default() }
    }
}

impl Registration for PointToPoint {
    fn name(&self) -> &str {
        Self::NAME
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        Ok(Box::new(PreparedCloud::new(scan, &self.config)?))
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let problem = Problem::new(Self::NAME, target, source, initial_target_from_source, limits, &self.config)?;
        Ok(problem.solve(&ClosedForm, &mut self.matcher))
    }
}

/// The best rigid motion between paired points, by the singular value decomposition of their cross covariance.
struct ClosedForm;

/// The distances of a pass, squared [m^2].
struct Settings {
    gate_sq: f64,
    final_gate_sq: f64,
    overlap_sq: f64,
}

/// Moments of the paired points.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    evidence: Evidence,
    source: Vector3<f64>,
    target: Vector3<f64>,
    cross: Matrix3<f64>,
}

impl PairSum for Sum {
    type Settings = Settings;

    #[inline]
    fn add(&mut self, settings: &Settings, pair: &Pair) {
        let evidence = &mut self.evidence;
        evidence.overlapping += u32::from(pair.distance_sq < settings.overlap_sq);
        if pair.distance_sq < settings.final_gate_sq {
            evidence.judged += 1;
            evidence.cost_sum += pair.distance_sq;
        }
        if pair.distance_sq < settings.gate_sq {
            evidence.pairs += 1;
            evidence.residual_sq += pair.distance_sq;
            if pair.normal != Vector3::zeros() {
                evidence.plane.add(pair, pair.normal.dot(&(pair.source - pair.target)), 1.0);
            }
            self.source += pair.source;
            self.target += pair.target;
            self.cross += pair.target * pair.source.transpose();
        }
    }

    fn merge(&mut self, other: &Self) {
        self.evidence.merge(&other.evidence);
        self.source += other.source;
        self.target += other.target;
        self.cross += other.cross;
    }
}

impl Minimiser for ClosedForm {
    type Sum = Sum;

    fn settings(&self, config: &RegistrationConfig, gate_m: f64, final_gate_m: f64) -> Settings {
        Settings {
            gate_sq: gate_m * gate_m,
            final_gate_sq: final_gate_m * final_gate_m,
            overlap_sq: config.overlap_distance_m * config.overlap_distance_m,
        }
    }

    fn evidence(sum: &Sum) -> &Evidence {
        &sum.evidence
    }

    fn step(&self, sum: &Sum, constraint: &Constraint) -> Option<Twist> {
        let count = f64::from(sum.evidence.pairs);
        let (source, target) = (sum.source / count, sum.target / count);
        let svd = (sum.cross / count - target * source.transpose()).svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        // A reflection would fit flat scenes as well as the rotation does; the sign rules it out.
        let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
        let rotation = u * sign * v_t;
        let translation = target - rotation * source;
        let motion = Pose::from_parts(
            Translation3::from(translation),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
        );
        let step = geometry::log(&motion);
        // Exact where all six directions are known; the projection would only add rounding.
        Some(if constraint.mask() == 0b11_1111 { step } else { constraint.project(&step) })
    }

    fn unpaired_cost(&self, _config: &RegistrationConfig, final_gate_m: f64) -> f64 {
        final_gate_m * final_gate_m
    }

    fn errors(&self, sum: &Sum, share: f64, _overlap: f64) -> ErrorModel {
        // A third of the squared distance falls on any one axis.
        let variance = sum.evidence.residual_sq / (3.0 * f64::from(sum.evidence.pairs.max(1)));
        ErrorModel { variance, share, bias_m: PULL * variance.sqrt() }
    }
}
