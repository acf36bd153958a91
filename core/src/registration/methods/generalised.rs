//! Generalised ICP (Segal, Haehnel, Thrun 2009): plane to plane, by the sum of both points' covariances.

use super::metric::{Metrics, Settings, Sum as MetricSum};
use super::point_to_plane::PointToPlane;
use crate::geometry::{Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{PairSum, Pairs};
use crate::registration::robust::Kernel;
use crate::registration::symmetric3::{FLATNESS, inverse, quadratic, surface_covariance};
use crate::registration::{Constraint, RegistrationConfig};

/// Generalised ICP: the residual of a pair is its offset, judged by the inverse of the sum of the two points'
/// covariances, each of which is thin along the normal of its surface. Scaled so that along a common normal the metric
/// is 1 and costs are squared metres.
pub(in crate::registration) struct Generalised;

/// The normal equations.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum(MetricSum);

impl PairSum for Sum {
    type Settings = Settings;
    const USES_SOURCE_PLANES: bool = true;

    #[inline(always)]
    fn add(&mut self, settings: &Settings, pairs: &Pairs<'_>) {
        self.0.add_evidence(settings, pairs);
        let mut metrics = Metrics::default();
        for k in 0..pairs.count {
            let (there, here) = (pairs.normal_of(k), pairs.source_normal_of(k));
            let (mut covariance, own) = (surface_covariance(there), surface_covariance(here));
            for entry in 0..6 {
                covariance[entry] += own[entry];
            }
            let metric = inverse(covariance, 2.0 * FLATNESS);
            let offset = pairs.offset(k);
            let cost = quadratic(&metric, offset);
            let evidence = &mut self.0.evidence;
            if pairs.distance_sq[k] < settings.gates.judged_sq {
                evidence.judged += 1;
                evidence.cost_sum += f64::from(cost.min(settings.final_scale_sq));
            }
            if pairs.distance_sq[k] < settings.gates.pair_sq && evidence.takes(&settings.gates, cost) {
                metrics.set(k, offset, metric, settings.kernel.weight(cost));
            }
        }
        self.0.add_metrics(pairs, &metrics);
    }

    fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }
}

impl Minimiser for Generalised {
    type Sum = Sum;
    type Approach = PointToPlane;
    const NAME: &'static str = "gicp";

    fn settings(config: &RegistrationConfig, gates: &Gates) -> Settings {
        Settings {
            gates: *gates,
            kernel: Kernel::of_pass(config, gates),
            final_scale_sq: (config.robust_scale_m * config.robust_scale_m) as f32,
        }
    }

    fn evidence(sum: &Sum) -> &Evidence {
        &sum.0.evidence
    }

    fn finish(sum: &mut Sum, target_from_source: &Pose) {
        sum.0.finish(target_from_source);
    }

    fn step(sum: &Sum, _: &Pose, constraint: &Constraint, damping: f64) -> Option<Twist> {
        sum.0.step(constraint, damping)
    }

    fn unpaired_cost(config: &RegistrationConfig, _judged_m: f64) -> f64 {
        config.robust_scale_m * config.robust_scale_m
    }

    fn errors(sum: &Sum, share: f64, overlap: f64) -> ErrorModel {
        sum.0.errors(share, overlap)
    }
}
