//! Symmetric point to plane (Rusinkiewicz 2019): each pair is judged by both of its tangent planes, so that a pair on a
//! curved surface fits wherever on the curve its points lie.

use super::point_to_plane::{PointToPlane, Settings, Sum as PlaneSum};
use crate::geometry::{Pose, Twist};
use crate::registration::evidence::{Evidence, Gates};
use crate::registration::information::ErrorModel;
use crate::registration::iteration::Minimiser;
use crate::registration::pairs::{BATCH, PairSum, Pairs};
use crate::registration::{Constraint, RegistrationConfig};

/// Normals that differ by more than this do not lie on one surface: the cosine.
const LEAST_AGREEMENT: f32 = 0.5;

/// Symmetric point to plane: the residual is the mean of the source point's distance from the partner's plane and the
/// partner's distance from the source point's plane.
pub(in crate::registration) struct Symmetric;

/// The normal equations.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::registration) struct Sum(PlaneSum);

impl PairSum for Sum {
    type Settings = Settings;
    const USES_SOURCE_PLANES: bool = true;

    #[inline(always)]
    fn add(&mut self, settings: &Settings, pairs: &Pairs<'_>) {
        let mut normals = [[0.0; BATCH]; 3];
        let mut residuals = [0.0; BATCH];
        for k in 0..pairs.count {
            let (mut agreement, mut behind) = (0.0, 0.0);
            for axis in 0..3 {
                let own = pairs.source_normal[axis][k];
                agreement += own * pairs.normal[axis][k];
                behind += own * (pairs.moved[axis][k] - pairs.partner[axis][k]);
                normals[axis][k] = 0.5 * (pairs.normal[axis][k] + own);
            }
            // The source point lies off its own plane, too; what counts is the partner's distance from it.
            residuals[k] = 0.5 * (pairs.residual[k] + behind - pairs.source_residual[k]);
            if agreement < LEAST_AGREEMENT {
                for axis in &mut normals {
                    axis[k] = 0.0;
                }
            }
        }
        self.0.add_planes(settings, pairs, &normals, &residuals);
    }

    fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }
}

impl Minimiser for Symmetric {
    type Sum = Sum;
    type Approach = PointToPlane;
    const NAME: &'static str = "symmetric_point_to_plane";

    fn settings(config: &RegistrationConfig, gates: &Gates) -> Settings {
        PointToPlane::settings(config, gates)
    }

    fn evidence(sum: &Sum) -> &Evidence {
        PointToPlane::evidence(&sum.0)
    }

    fn finish(sum: &mut Sum, target_from_source: &Pose) {
        PointToPlane::finish(&mut sum.0, target_from_source);
    }

    fn step(sum: &Sum, target_from_source: &Pose, constraint: &Constraint, damping: f64) -> Option<Twist> {
        PointToPlane::step(&sum.0, target_from_source, constraint, damping)
    }

    fn unpaired_cost(config: &RegistrationConfig, judged_m: f64) -> f64 {
        PointToPlane::unpaired_cost(config, judged_m)
    }

    fn errors(sum: &Sum, share: f64, overlap: f64) -> ErrorModel {
        PointToPlane::errors(&sum.0, share, overlap)
    }
}
