//! The search, its hypotheses and their ranking.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::occupancy::Occupancy;
use super::search::{self, Found, Maximum};
use super::{CoarseConfig, CoarseScan, Evidence, Method, SearchRange, Verdict, depth_by_depth, polish};
use crate::geometry::{self, Pose};
use crate::registration::ConfigError;
use crate::threads;

/// Two polished poses nearer than this and turned by less than `SAME_TURN` are one hypothesis [m].
const SAME_SHIFT_M: f64 = 1.0;
/// See `SAME_SHIFT_M` [rad].
const SAME_TURN: f64 = 0.1;

/// A pose that the search proposes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CoarseHypothesis {
    /// The pose, good to a few centimetres where it is right.
    pub target_from_source: Pose,
    /// How many of the cubes overlap on the lattice, weighted, as a share of the most there can be.
    pub cube_overlap: f64,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// [`Evidence::score`].
    pub score: f64,
}

/// The result of a coarse search.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CoarseAlignment {
    /// Different poses, the best score first; none when nothing overlaps.
    pub hypotheses: Vec<CoarseHypothesis>,
    /// How often the source's cubes were laid over the target's.
    pub evaluations: usize,
    /// The search ended by `max_evaluations`: a better maximum may have been missed.
    pub cut_short: bool,
}

impl CoarseAlignment {
    /// The best hypothesis.
    #[must_use]
    pub fn best(&self) -> Option<&CoarseHypothesis> {
        self.hypotheses.first()
    }

    /// By how much of its own score the hypothesis of this rank beats the best other one, up to 1 when there is no
    /// other; negative when it is not the best.
    #[must_use]
    pub fn margin(&self, rank: usize) -> f64 {
        self.hypotheses.get(rank).map_or(0.0, |own| self.margin_of(rank, own.score))
    }

    /// The same once refinement has given the hypothesis the score `own`.
    pub(super) fn margin_of(&self, rank: usize, own: f64) -> f64 {
        let others = self.hypotheses.iter().enumerate().filter(|(k, _)| *k != rank);
        let other = others.map(|(_, other)| other.score).fold(0.0, f64::max);
        if own > 0.0 { (own - other) / own } else { 0.0 }
    }
}

/// Why a question makes no sense.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CoarseError {
    /// The initial pose holds a value that is not finite.
    #[error("the initial pose holds a value that is not finite")]
    StartNotFinite,
    /// A setting is out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Coarse alignment of scans, and the judge of poses that anyone found.
///
/// It keeps the cubes of the target it was last asked about, so that many sources against one target (a new scan
/// against those it may close a loop with) cost them once.
#[derive(Debug)]
pub struct CoarseAligner {
    config: CoarseConfig,
    target: Option<(u64, Occupancy)>,
}

impl CoarseAligner {
    /// An aligner with these settings.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: CoarseConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self { config, target: None })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &CoarseConfig {
        &self.config
    }

    /// Reduces the points of a keyframe [m, scanner frame], thinned to one in `spacing_m`.
    #[must_use]
    pub fn prepare(&self, points: &[[f32; 3]], spacing_m: f64) -> CoarseScan {
        CoarseScan::new(points, spacing_m, &self.config)
    }

    /// The poses about `initial_target_from_source` under which the scans overlap most.
    ///
    /// # Errors
    /// [`CoarseError`]: the range is no range or the pose not finite.
    pub fn align(
        &mut self,
        target: &CoarseScan,
        source: &CoarseScan,
        initial_target_from_source: &Pose,
        range: &SearchRange,
    ) -> Result<CoarseAlignment, CoarseError> {
        range.validate()?;
        if !geometry::rows_from_pose(initial_target_from_source).iter().all(|v| v.is_finite()) {
            return Err(CoarseError::StartNotFinite);
        }
        let mut initial = *initial_target_from_source;
        initial.rotation.renormalize();
        let found = self.search(target, source, &initial, range);
        let hypotheses = self.hypotheses(target, source, &found.maxima);
        Ok(CoarseAlignment { hypotheses, evaluations: found.evaluations, cut_short: found.cut_short })
    }

    /// Judges a pose that any method found, by evidence of its own.
    #[must_use]
    pub fn verify(&self, target: &CoarseScan, source: &CoarseScan, target_from_source: &Pose) -> Verdict {
        let finite = geometry::rows_from_pose(target_from_source).iter().all(|v| v.is_finite());
        let evidence = if finite {
            Evidence::new(target, source, target_from_source, self.config.cell_m)
        } else {
            Evidence::default()
        };
        Verdict::of(evidence, &self.config.trust)
    }

    /// Maxima of the cubes' overlap.
    fn search(&mut self, target: &CoarseScan, source: &CoarseScan, initial: &Pose, range: &SearchRange) -> Found {
        if self.config.method == Method::DepthByDepth {
            return depth_by_depth::depth_by_depth(target, source, initial, range, &self.config);
        }
        let fingerprint = target.fingerprint();
        let kept = self.target.take().filter(|(kept, _)| *kept == fingerprint);
        let (_, grid) = self
            .target
            .insert(kept.unwrap_or_else(|| (fingerprint, Occupancy::new(target.points(), self.config.cell_m))));
        search::branch_and_bound(grid, source, initial, range, &self.config)
    }

    /// The maxima moved to where surfaces meet, judged, and ranked.
    pub(super) fn hypotheses(
        &self,
        target: &CoarseScan,
        source: &CoarseScan,
        maxima: &[Maximum],
    ) -> Vec<CoarseHypothesis> {
        let cell_m = self.config.cell_m;
        let mut polished: Vec<Option<CoarseHypothesis>> = vec![None; maxima.len()];
        threads::for_each(polished.iter_mut().zip(maxima), self.config.threads, |(out, maximum)| {
            let pose = polish::polish(target, source, &maximum.target_from_source, cell_m);
            let evidence = Evidence::new(target, source, &pose, cell_m);
            *out = Some(CoarseHypothesis {
                target_from_source: pose,
                cube_overlap: maximum.overlap,
                score: evidence.score(),
                evidence,
            });
        });
        let mut ranked: Vec<CoarseHypothesis> = polished.into_iter().flatten().collect();
        ranked.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut different: Vec<CoarseHypothesis> = Vec::with_capacity(ranked.len());
        for hypothesis in ranked {
            if !different.iter().any(|kept| is_same(&kept.target_from_source, &hypothesis.target_from_source)) {
                different.push(hypothesis);
            }
        }
        different
    }
}

/// Whether two poses are one hypothesis.
fn is_same(a: &Pose, b: &Pose) -> bool {
    let shift: Vector3<f64> = a.translation.vector - b.translation.vector;
    shift.norm() < SAME_SHIFT_M && a.rotation.angle_to(&b.rotation) < SAME_TURN
}
