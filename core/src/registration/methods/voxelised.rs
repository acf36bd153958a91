//! Voxelised generalised ICP (Koide, Yokozuka, Oishi, Banno 2021): as GICP, but a source point's partner is the mean of
//! the coarse voxel it falls into, with the mean of the covariances there. No neighbour decides the pull.

use super::generalised::Generalised;
use super::metric::{Metrics, Settings, Sum as MetricSum};
use super::point_to_plane::PointToPlane;
use crate::geometry::{Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{PairSum, Pairs};
use crate::registration::symmetric3::{FLATNESS, inverse, quadratic, surface_covariance};
use crate::registration::{Constraint, RegistrationConfig};

/// Voxelised GICP, over cubes of four voxels.
pub(in crate::registration) struct Voxelised;

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
            let Some(cell) = pairs.cell(k) else { continue };
            let (mut covariance, own) = (cell.surface, surface_covariance(pairs.source_normal_of(k)));
            for entry in 0..6 {
                covariance[entry] += own[entry];
            }
            let metric = inverse(covariance, 2.0 * FLATNESS);
            let mut offset = [0.0; 3];
            for axis in 0..3 {
                offset[axis] = pairs.moved[axis][k] - cell.mean[axis];
            }
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

impl Minimiser for Voxelised {
    type Sum = Sum;
    type Approach = PointToPlane;
    const NAME: &'static str = "vgicp";

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
