//! The normal distributions transform in 3D (Biber and Strasser 2003; Magnusson 2009): the target is a grid of normal
//! distributions, and a source point scores by the density where it falls.

use super::generalised::Generalised;
use super::metric::{Metrics, Settings, Sum as MetricSum};
use super::point_to_plane::PointToPlane;
use crate::geometry::{Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{PairSum, Pairs};
use crate::registration::symmetric3::quadratic;
use crate::registration::{Constraint, RegistrationConfig};

/// The normal distributions transform, point to distribution, over cubes of four voxels.
pub(in crate::registration) struct NormalDistributions;

/// The normal equations.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum(MetricSum);

impl PairSum for Sum {
    type Settings = Settings;

    #[inline(always)]
    fn add(&mut self, settings: &Settings, pairs: &Pairs<'_>) {
        self.0.add_evidence(settings, pairs);
        let mut metrics = Metrics::default();
        for k in 0..pairs.count {
            let Some(cell) = pairs.cell(k) else { continue };
            let mut offset = [0.0; 3];
            for axis in 0..3 {
                offset[axis] = pairs.moved[axis][k] - cell.mean[axis];
            }
            // The mixture with a uniform density (Magnusson 2009, 6.2) leaves far points almost without pull.
            let mahalanobis = quadratic(&cell.information, offset);
            let density = (-0.5 * mahalanobis).exp();
            let evidence = &mut self.0.evidence;
            if pairs.distance_sq[k] < settings.gates.judged_sq {
                evidence.judged += 1;
                evidence.cost_sum += f64::from((1.0 - density) * settings.final_scale_sq);
            }
            let residual_sq = pairs.residual[k] * pairs.residual[k];
            if pairs.distance_sq[k] < settings.gates.pair_sq && evidence.takes(&settings.gates, residual_sq) {
                metrics.set(k, offset, cell.information, density);
            }
        }
        self.0.add_metrics(pairs, &metrics);
    }

    fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }
}

impl Minimiser for NormalDistributions {
    type Sum = Sum;
    type Approach = PointToPlane;
    const NAME: &'static str = "ndt";
    const IS_ROBUST: bool = false;
    /// Distributions resist sliding along themselves until the points have moved to the next: steps are short.
    const TOLERANCE_SHARE: f64 = 0.1;

    fn settings(config: &RegistrationConfig, gates: &Gates) -> Settings {
        Generalised::settings(config, gates)
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

    fn unpaired_cost(config: &RegistrationConfig, judged_m: f64) -> f64 {
        Generalised::unpaired_cost(config, judged_m)
    }

    fn errors(sum: &Sum, share: f64, overlap: f64) -> ErrorModel {
        sum.0.errors(share, overlap)
    }
}
