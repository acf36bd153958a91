//! Point to plane: Chen and Medioni (1992), minimised by Gauss-Newton on SE(3) with robust weights.

use crate::geometry::{Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{BATCH, PairSum, Pairs};
use crate::registration::robust::Kernel;
use crate::registration::{Constraint, RegistrationConfig};

/// Surfaces that only one of the scans saw pair with whatever is near and pull all one way, so that more points share
/// one error: the standard deviation grows by the root of 1 + (this times their share)^2. Set so that the errors of
/// real steps of 2 m and of 8 m, with overlaps of 0.8 and 0.5, are about as large as the covariance says.
const PULL: f64 = 6.0;

/// A plane whose returns lie this far from it, squared [m^2], counts half: edges, leaves and grass say less.
const FLAT_VARIANCE: f32 = 4e-4;

/// Point to plane: minimises the robust sum of squared distances of the source's points to the tangent planes of
/// their partners. Converges in far fewer steps than point to point, and sampling does not bias it along surfaces.
pub(in crate::registration) struct PointToPlane;

/// The distances and scales of a pass.
pub(in crate::registration) struct Settings {
    gates: Gates,
    kernel: Kernel,
    final_scale_sq: f32,
}

/// The normal equations.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum {
    evidence: Evidence,
}

impl Sum {
    /// Adds the pairs, each judged by the residual from a plane with this normal; without a normal it does not count.
    #[inline(always)]
    pub(super) fn add_planes(
        &mut self,
        settings: &Settings,
        pairs: &Pairs<'_>,
        normals: &[[f32; BATCH]; 3],
        residuals: &[f32; BATCH],
    ) {
        let evidence = &mut self.evidence;
        let mut weights = [0.0; BATCH];
        for k in 0..pairs.count {
            let distance_sq = pairs.distance_sq[k];
            evidence.overlapping += u32::from(distance_sq < settings.gates.overlap_sq);
            if normals[0][k] == 0.0 && normals[1][k] == 0.0 && normals[2][k] == 0.0 {
                continue;
            }
            let residual_sq = residuals[k] * residuals[k];
            if distance_sq < settings.gates.judged_sq {
                evidence.judged += 1;
                evidence.cost_sum += f64::from(residual_sq.min(settings.final_scale_sq));
            }
            if distance_sq < settings.gates.pair_sq && evidence.takes(&settings.gates, residual_sq) {
                let flat = FLAT_VARIANCE / (FLAT_VARIANCE + pairs.variance[k]);
                weights[k] = settings.kernel.weight(residual_sq) * flat;
            }
        }
        evidence.plane.add(pairs, normals, residuals, &weights);
    }
}

impl PairSum for Sum {
    type Settings = Settings;

    #[inline(always)]
    fn add(&mut self, settings: &Settings, pairs: &Pairs<'_>) {
        self.add_planes(settings, pairs, &pairs.normal, &pairs.residual);
    }

    fn merge(&mut self, other: &Self) {
        self.evidence.merge(&other.evidence);
    }
}

impl Minimiser for PointToPlane {
    type Sum = Sum;
    type Approach = Self;
    const NAME: &'static str = "point_to_plane";

    fn settings(config: &RegistrationConfig, gates: &Gates) -> Settings {
        Settings {
            gates: *gates,
            kernel: Kernel::of_pass(config, gates),
            final_scale_sq: (config.robust_scale_m * config.robust_scale_m) as f32,
        }
    }

    fn evidence(sum: &Sum) -> &Evidence {
        &sum.evidence
    }

    fn finish(sum: &mut Sum, target_from_source: &Pose) {
        sum.evidence.plane.equations.turn(target_from_source);
    }

    fn step(sum: &Sum, _: &Pose, constraint: &Constraint, damping: f64) -> Option<Twist> {
        sum.evidence.plane.equations.step(constraint, damping)
    }

    fn unpaired_cost(config: &RegistrationConfig, _final_gate_m: f64) -> f64 {
        config.robust_scale_m * config.robust_scale_m
    }

    fn errors(sum: &Sum, share: f64, overlap: f64) -> ErrorModel {
        errors_of(&sum.evidence, share, overlap)
    }
}

/// How the distances from the planes err; `share` points have one error in common, `overlap` have a partner.
pub(super) fn errors_of(evidence: &Evidence, share: f64, overlap: f64) -> ErrorModel {
    let plane = &evidence.plane;
    let variance = plane.residual_sq / plane.weight.max(1.0);
    let pull = PULL * (1.0 - overlap);
    ErrorModel { variance, share: share * (1.0 + pull * pull), bias_m: 0.0 }
}
