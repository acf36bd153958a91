//! Which earlier scans a scan is registered with.
//!
//! A pair is a candidate when, by the predicted poses and their relative uncertainty, the scans may be within reach of
//! each other. The number of pairs tried is bounded, so that the time per scan does not grow with the map.

use nalgebra::Vector3;

use super::keyframe::Keyframe;
use super::positions::Positions;
use super::uncertainty::{Uncertainty, largest_sigmas};
use super::{GlobalConfig, PairKind};
use crate::geometry::{Covariance, Pose};

/// Most loop candidates whose overlap is predicted, the nearest.
const MOST_PREDICTED: usize = 48;
/// Loops tried for one scan are with scans that lie at least so many scans apart: neighbours tell the same.
const LOOP_SPACING: usize = 3;

/// A pair to be tried.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    pub kind: PairKind,
    /// Node of the earlier scan.
    pub target: usize,
    /// Node of the later scan.
    pub source: usize,
    /// `target_from_source` by the poses as known.
    pub predicted: Pose,
    /// Its covariance.
    pub covariance: Covariance,
    pub sigma_m: f64,
    pub sigma_rotation: f64,
    pub overlap: f64,
    /// The prediction may lie outside the basin of registration.
    pub needs_coarse: bool,
    /// By which candidates are ranked.
    score: f64,
}

/// What candidates are chosen from.
pub(super) struct Known<'a> {
    pub config: &'a GlobalConfig,
    pub poses: &'a [Pose],
    pub keyframes: &'a [Keyframe],
    pub positions: &'a Positions,
    pub uncertainty: &'a Uncertainty,
}

impl Known<'_> {
    /// The pairs to try for `source`, which was aligned to `aligned_to` already; and the number of scans within reach.
    pub fn candidates(&self, source: usize, aligned_to: Option<usize>) -> (usize, Vec<Candidate>) {
        let config = self.config;
        let (Some(map_from_source), Some(keyframe)) = (self.poses.get(source), self.keyframes.get(source)) else {
            return (0, Vec::new());
        };
        let place: Vector3<f64> = map_from_source.translation.vector;
        let mut near = self.positions.within(&place, config.max_reach_m + config.max_uncertainty_m);
        near.retain(|target| *target < source && Some(*target) != aligned_to);
        let covariances = self.uncertainty.relative_to(source, map_from_source, &near);
        let mut reachable: Vec<(f64, Candidate)> = Vec::new();
        for (target, covariance) in near.into_iter().zip(covariances) {
            let predicted = self.poses[target].inverse() * map_from_source;
            let distance = predicted.translation.vector.norm();
            let (sigma_m, sigma_rotation) = largest_sigmas(&covariance);
            let (gate_m, gate_rotation) = (config.gate_sigmas * sigma_m, config.gate_sigmas * sigma_rotation);
            let ranges = 0.5 * (keyframe.range_m() + self.keyframes[target].range_m());
            let reach = (config.reach * ranges).min(config.max_reach_m);
            if distance - gate_m > reach || gate_m > config.max_uncertainty_m {
                continue;
            }
            let is_loop = source - target >= config.loop_scans;
            let kind = if is_loop { PairKind::Loop } else { PairKind::Overlap };
            let needs_coarse = gate_m > config.basin_m || gate_rotation > config.basin_rotation;
            // Without a pose to predict the overlap at, the nearer is the likelier.
            let score = 0.5 * (1.0 - distance / (reach + gate_m).max(1e-9));
            reachable.push((
                distance,
                Candidate {
                    kind,
                    target,
                    source,
                    predicted,
                    covariance,
                    sigma_m,
                    sigma_rotation,
                    overlap: 0.0,
                    needs_coarse,
                    score,
                },
            ));
        }
        let considered = reachable.len();
        reachable.sort_by(|(a, x), (b, y)| a.total_cmp(b).then(x.target.cmp(&y.target)));
        let (overlaps, loops): (Vec<_>, Vec<_>) =
            reachable.into_iter().map(|(_, candidate)| candidate).partition(|c| c.kind == PairKind::Overlap);
        let mut chosen = self.choose_overlaps(overlaps);
        chosen.extend(self.choose_loops(loops));
        (considered, chosen)
    }

    fn predict_overlap(&self, candidate: &mut Candidate) {
        let (target, source) = (&self.keyframes[candidate.target], &self.keyframes[candidate.source]);
        candidate.overlap = source.footprint().overlap_with(target.footprint(), &candidate.predicted);
    }

    /// Of the scans shortly before, some that reach from the farthest back to the nearest: a long pair carries over
    /// many short ones what they have lost.
    fn choose_overlaps(&self, mut candidates: Vec<Candidate>) -> Vec<Candidate> {
        candidates.retain_mut(|candidate| {
            self.predict_overlap(candidate);
            !candidate.needs_coarse && candidate.overlap >= self.config.min_predicted_overlap
        });
        candidates.sort_by_key(|candidate| candidate.target);
        let (count, wanted) = (candidates.len(), self.config.overlaps_per_scan);
        if count <= wanted {
            return candidates;
        }
        (0..wanted).map(|k| candidates[k * (count - 1) / (wanted - 1).max(1)].clone()).collect()
    }

    /// The loops that most likely close.
    fn choose_loops(&self, mut candidates: Vec<Candidate>) -> Vec<Candidate> {
        candidates.truncate(MOST_PREDICTED);
        candidates.retain_mut(|candidate| {
            self.predict_overlap(candidate);
            if !candidate.needs_coarse {
                candidate.score = candidate.overlap;
            }
            candidate.needs_coarse || candidate.overlap >= self.config.min_predicted_overlap
        });
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.target.cmp(&b.target)));
        let mut chosen: Vec<Candidate> = Vec::new();
        let mut coarse = 0;
        for candidate in candidates {
            let is_apart = chosen.iter().all(|other| candidate.target.abs_diff(other.target) >= LOOP_SPACING);
            let is_affordable = !candidate.needs_coarse || coarse < self.config.coarse_per_scan;
            if chosen.len() < self.config.loops_per_scan && is_apart && is_affordable {
                coarse += usize::from(candidate.needs_coarse);
                chosen.push(candidate);
            }
        }
        chosen
    }
}
