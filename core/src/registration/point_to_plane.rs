//! Point to plane: Chen and Medioni (1992), minimised by Gauss-Newton on SE(3) with robust weights.

use nalgebra::Vector3;

use super::correspondences::{Matcher, Pair, PairSum};
use super::information::ErrorModel;
use super::iteration::{Evidence, Minimiser, Problem};
use super::prepared::PreparedCloud;
use super::{
    AlignError, Alignment, Constraint, Limits, PrepareError, PreparedScan, Registration, RegistrationConfig,
    RobustKernel,
};
use crate::geometry::{Pose, Twist};
use crate::scan::ScanView;

/// Surfaces that only one of the scans saw pair with whatever is near and pull all one way, so that more points share
/// one error: the standard deviation grows by the root of 1 + (this times their share)^2. Set so that the errors of
/// real steps of 2 m and of 8 m, with overlaps of 0.8 and 0.5, are about as large as the covariance says.
const PULL: f64 = 6.0;

/// Point to plane: minimises the robust sum of squared distances of the source's points to the tangent planes of
/// their partners. Converges in far fewer steps than point to point, and sampling does not bias it along surfaces.
#[derive(Debug, Default)]
pub struct PointToPlane {
    config: RegistrationConfig,
    matcher: Matcher<Sum>,
}

impl PointToPlane {
    /// The name in configurations.
    pub const NAME: &str = "point_to_plane";

    /// The method with these settings.
    #[must_use]
    pub fn new(config: RegistrationConfig) -> Self {
        Self { config, matcher: Matcher::default() }
    }
}

impl Registration for PointToPlane {
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
        Ok(problem.solve(&GaussNewton, &mut self.matcher))
    }
}

/// One Gauss-Newton step of iteratively reweighted least squares.
struct GaussNewton;

/// The distances and scales of a pass.
struct Settings {
    gate_sq: f64,
    final_gate_sq: f64,
    overlap_sq: f64,
    kernel: RobustKernel,
    scale: f64,
    final_scale_sq: f64,
}

/// The normal equations.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    evidence: Evidence,
}

impl PairSum for Sum {
    type Settings = Settings;

    #[inline]
    fn add(&mut self, settings: &Settings, pair: &Pair) {
        let evidence = &mut self.evidence;
        evidence.overlapping += u32::from(pair.distance_sq < settings.overlap_sq);
        if pair.normal == Vector3::zeros() {
            return;
        }
        let residual = pair.normal.dot(&(pair.source - pair.target));
        if pair.distance_sq < settings.final_gate_sq {
            evidence.judged += 1;
            evidence.cost_sum += (residual * residual).min(settings.final_scale_sq);
        }
        if pair.distance_sq < settings.gate_sq {
            evidence.pairs += 1;
            evidence.residual_sq += residual * residual;
            evidence.plane.add(pair, residual, settings.kernel.weight(residual, settings.scale));
        }
    }

    fn merge(&mut self, other: &Self) {
        self.evidence.merge(&other.evidence);
    }
}

impl Minimiser for GaussNewton {
    type Sum = Sum;

    fn settings(&self, config: &RegistrationConfig, gate_m: f64, final_gate_m: f64) -> Settings {
        Settings {
            gate_sq: gate_m * gate_m,
            final_gate_sq: final_gate_m * final_gate_m,
            overlap_sq: config.overlap_distance_m * config.overlap_distance_m,
            kernel: config.robust_kernel,
            // While pairs may be far apart, so may residuals that are right.
            scale: config.robust_scale_m * gate_m / final_gate_m,
            final_scale_sq: config.robust_scale_m * config.robust_scale_m,
        }
    }

    fn evidence(sum: &Sum) -> &Evidence {
        &sum.evidence
    }

    fn step(&self, sum: &Sum, constraint: &Constraint) -> Option<Twist> {
        Some(sum.evidence.plane.step(constraint))
    }

    fn unpaired_cost(&self, config: &RegistrationConfig, _final_gate_m: f64) -> f64 {
        config.robust_scale_m * config.robust_scale_m
    }

    fn errors(&self, sum: &Sum, share: f64, overlap: f64) -> ErrorModel {
        let plane = &sum.evidence.plane;
        let variance = plane.residual_sq / plane.weight.max(1.0);
        let pull = PULL * (1.0 - overlap);
        ErrorModel { variance, share: share * (1.0 + pull * pull), bias_m: 0.0 }
    }
}
