//! Coarse alignment of a pair that prediction cannot start, and the judgement of a pose by evidence of its own.

use std::sync::Arc;

use nalgebra::Vector3;

use super::candidates::Candidate;
use super::keyframe::Keyframe;
use super::{GlobalConfig, PairRejection};
use crate::geometry::Pose;
use crate::registration::ConfigError;
use crate::registration::coarse::{CoarseAligner, CoarseScan, SearchRange, Verdict};

/// Scans reduced for coarse alignment that are kept, the last used first.
const MOST_KEPT: usize = 24;
/// The angles that a search covers at the most [rad].
const MOST_YAW: f64 = 0.8;
const MOST_TILT: f64 = 0.1;
/// The height that a search covers at the least and at the most [m].
const HEIGHT_M: [f64; 2] = [0.5, 3.0];

/// Searches for poses and judges them.
pub(super) struct Verification {
    aligner: CoarseAligner,
    spacing_m: f64,
    gate_sigmas: f64,
    scans: Vec<(usize, Arc<CoarseScan>)>,
}

impl Verification {
    /// For keyframes whose points lie about `spacing_m` apart.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: &GlobalConfig, spacing_m: f64) -> Result<Self, ConfigError> {
        let aligner = CoarseAligner::new(config.coarse.clone())?;
        Ok(Self { aligner, spacing_m, gate_sigmas: config.gate_sigmas, scans: Vec::with_capacity(MOST_KEPT) })
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        self.scans.iter().map(|(_, scan)| scan.bytes()).sum()
    }

    /// The pose that registration may begin at, within the prediction's gate; `up` is the vertical seen from the source.
    ///
    /// # Errors
    /// [`PairRejection::Coarse`] when no hypothesis stands out.
    pub fn search(
        &mut self,
        keyframes: &[Keyframe],
        candidate: &Candidate,
        up: Vector3<f64>,
    ) -> Result<Pose, PairRejection> {
        let (target, source) = self.scans_of(keyframes, candidate);
        let gate_m = self.gate_sigmas * candidate.sigma_m;
        let gate_rotation = self.gate_sigmas * candidate.sigma_rotation;
        let range = SearchRange {
            translation_m: gate_m,
            height_m: gate_m.clamp(HEIGHT_M[0], HEIGHT_M[1]),
            yaw: gate_rotation.min(MOST_YAW),
            tilt: gate_rotation.min(MOST_TILT),
            vertical: up.into(),
        };
        let reject = |reason: String| PairRejection::Coarse { reason };
        let found =
            self.aligner.align(&target, &source, &candidate.predicted, &range).map_err(|e| reject(e.to_string()))?;
        let best = found.best().ok_or_else(|| reject("nothing overlaps".to_owned()))?;
        let (margin, required) = (found.margin(0), self.aligner.config().trust.least_margin);
        if margin < required {
            return Err(reject(format!("another pose explains the scans nearly as well: ahead by {margin:.3}")));
        }
        Ok(best.target_from_source)
    }

    /// Judges the pose that registration found for a loop.
    ///
    /// # Errors
    /// [`PairRejection::Contradiction`] with the reason not to trust it.
    pub fn verify(
        &mut self,
        keyframes: &[Keyframe],
        candidate: &Candidate,
        target_from_source: &Pose,
    ) -> Result<(), PairRejection> {
        let (target, source) = self.scans_of(keyframes, candidate);
        let Verdict { doubt, .. } = self.aligner.verify(&target, &source, target_from_source);
        doubt.map_or(Ok(()), |doubt| Err(PairRejection::Contradiction { reason: doubt.to_string() }))
    }

    fn scans_of(&mut self, keyframes: &[Keyframe], candidate: &Candidate) -> (Arc<CoarseScan>, Arc<CoarseScan>) {
        let source = self.get(candidate.source, keyframes);
        (self.get(candidate.target, keyframes), source)
    }

    /// A keyframe reduced for coarse alignment. What it is does not depend on whether it was kept or is made now.
    fn get(&mut self, node: usize, keyframes: &[Keyframe]) -> Arc<CoarseScan> {
        let known = self.scans.iter().position(|(of, _)| *of == node);
        let entry = match known {
            Some(at) => self.scans.remove(at),
            None => {
                let points = keyframes.get(node).map(Keyframe::points).unwrap_or_default();
                (node, Arc::new(self.aligner.prepare(&points, self.spacing_m)))
            }
        };
        self.scans.truncate(MOST_KEPT - 1);
        let scan = Arc::clone(&entry.1);
        self.scans.insert(0, entry);
        scan
    }
}
