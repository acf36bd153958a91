//! One pair of scans: from the predicted pose to a measurement, or to the reason why there is none.

use std::sync::Arc;

use super::candidates::Candidate;
use super::journal::MeasuredPair;
use super::keyframe::Keyframe;
use super::verification::Verification;
use super::{GlobalConfig, PairKind, PairRecord, PairRejection, PairStart};
use crate::geometry::{Covariance, Pose, log};
use crate::registration::{AlignError, Alignment, Limits, PairIds, PreparedScan, Registration};
use crate::slam6d::prior::{doubt_weak_directions, is_unsure};
use crate::slam6d::{AcceptanceConfig, Rejection, SequentialConfig};

/// Pairs are looked for at least this far at the start, however certain the prediction is [m].
const LEAST_PAIR_DISTANCE_M: f64 = 0.75;

/// Keyframes ready for registration, the last used first.
pub(super) struct Ready {
    of: Vec<(usize, Arc<dyn PreparedScan>)>,
    most: usize,
}

impl Ready {
    pub fn new(most: usize) -> Self {
        Self { of: Vec::with_capacity(most), most }
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        self.of.iter().map(|(_, prepared)| prepared.bytes()).sum()
    }

    /// A keyframe, prepared. What it is does not depend on whether it was kept or is made now.
    pub fn get(
        &mut self,
        node: usize,
        keyframe: &Keyframe,
        registration: &dyn Registration,
    ) -> Result<Arc<dyn PreparedScan>, PairRejection> {
        let known = self.of.iter().position(|(of, _)| *of == node);
        let entry = match known {
            Some(at) => self.of.remove(at),
            None => {
                let prepared = keyframe.prepare(registration);
                (node, Arc::from(prepared.map_err(|e| PairRejection::Prepare { reason: e.to_string() })?))
            }
        };
        self.of.truncate(self.most.saturating_sub(1));
        let prepared = Arc::clone(&entry.1);
        self.of.insert(0, entry);
        Ok(prepared)
    }
}

/// What a pair is measured with.
pub(super) struct Measuring<'a> {
    pub config: &'a GlobalConfig,
    pub sequential: &'a SequentialConfig,
    pub keyframes: &'a [Keyframe],
    pub scan_ids: &'a [u64],
    pub registration: &'a mut dyn Registration,
    pub ready: &'a mut Ready,
    pub verification: &'a mut Verification,
    /// Says which way is up for the source.
    pub map_from_source: Pose,
    /// Asked before every piece of work; `true` ends the measuring, which is begun anew later.
    pub interrupted: &'a dyn Fn() -> bool,
}

/// Why there is no measurement.
enum NoPair {
    /// The pair was judged.
    Rejected(PairRejection),
    /// There was no time to.
    Interrupted,
}

impl From<PairRejection> for NoPair {
    fn from(rejection: PairRejection) -> Self {
        Self::Rejected(rejection)
    }
}

impl Measuring<'_> {
    /// Tries a pair; `None` when it was interrupted. What was prepared until then stays ready.
    pub fn measure(&mut self, candidate: &Candidate) -> Option<(PairRecord, Option<MeasuredPair>)> {
        let mut record = PairRecord {
            kind: candidate.kind,
            target_id: self.scan_ids[candidate.target],
            source_id: self.scan_ids[candidate.source],
            predicted: candidate.predicted,
            predicted_sigma_m: candidate.sigma_m,
            predicted_sigma_rotation: candidate.sigma_rotation,
            predicted_overlap: candidate.overlap,
            start: PairStart::Prediction,
            found: candidate.predicted,
            overlap: 0.0,
            residual_m: 0.0,
            iterations: 0,
            sigmas: 0.0,
            rejected: None,
        };
        let result = match self.attempt(candidate, candidate.predicted, &mut record) {
            // Uncertainties are upper bounds: often the prediction is better than they say, and the search is spared.
            Err(NoPair::Rejected(_)) if candidate.needs_coarse => self.attempt_after_search(candidate, &mut record),
            result => result,
        };
        match result {
            Ok(pair) => Some((record, Some(pair))),
            Err(NoPair::Rejected(rejection)) => {
                record.rejected = Some(rejection);
                Some((record, None))
            }
            Err(NoPair::Interrupted) => None,
        }
    }

    fn attempt_after_search(&mut self, candidate: &Candidate, record: &mut PairRecord) -> Result<MeasuredPair, NoPair> {
        self.go_on()?;
        let up = self.map_from_source.rotation.inverse() * nalgebra::Vector3::z();
        record.start = PairStart::Coarse;
        let start = self.verification.search(self.keyframes, candidate, up)?;
        self.attempt(candidate, start, record)
    }

    fn attempt(&mut self, candidate: &Candidate, start: Pose, record: &mut PairRecord) -> Result<MeasuredPair, NoPair> {
        let (target, source) = (candidate.target, candidate.source);
        record.found = start;
        let mut alignment = self.register(candidate, &start)?;
        record.found = alignment.target_from_source;
        record.overlap = alignment.overlap;
        record.residual_m = alignment.residual_rms_m;
        record.iterations += alignment.iterations;
        record.sigmas = distance_in_sigmas(candidate, &alignment);
        self.acceptance(candidate)
            .judge(&alignment, &start, &self.limits(candidate), true)
            .map_err(PairRejection::Registration)?;
        // It may have slid along these directions; what it says across them is as good as ever.
        if is_unsure(&alignment) {
            doubt_weak_directions(&mut alignment);
            record.sigmas = distance_in_sigmas(candidate, &alignment);
        }
        let allowed = self.config.accept_sigmas;
        if record.sigmas > allowed {
            return Err(PairRejection::Improbable { sigmas: record.sigmas, allowed }.into());
        }
        if self.must_prove_itself(candidate) && self.config.verify_loops {
            self.verification.verify(self.keyframes, candidate, &alignment.target_from_source)?;
        }
        let closes_loop = candidate.kind == PairKind::Loop;
        let (target_from_source, covariance) = (alignment.target_from_source, alignment.covariance);
        Ok(MeasuredPair { target, source, target_from_source, covariance, closes_loop })
    }

    /// Whether the next piece of work may begin.
    fn go_on(&self) -> Result<(), NoPair> {
        if (self.interrupted)() { Err(NoPair::Interrupted) } else { Ok(()) }
    }

    fn get(&mut self, node: usize) -> Result<Arc<dyn PreparedScan>, NoPair> {
        self.go_on()?;
        Ok(self.ready.get(node, &self.keyframes[node], &*self.registration)?)
    }

    fn register(&mut self, candidate: &Candidate, start: &Pose) -> Result<Alignment, NoPair> {
        let limits = self.limits(candidate);
        let (source, target) = (self.get(candidate.source)?, self.get(candidate.target)?);
        self.go_on()?;
        let [target_id, source_id] = [candidate.target, candidate.source].map(|node| Some(self.scan_ids[node]));
        self.registration.name_pair(PairIds { target: target_id, source: source_id });
        let result = self.registration.align(&*target, &*source, start, &limits);
        let failed = |e: AlignError| PairRejection::Registration(Rejection::Failed { reason: e.to_string() });
        Ok(result.map_err(failed)?)
    }

    /// A certain prediction needs no far partners, which would only mislead.
    fn limits(&self, candidate: &Candidate) -> Limits {
        let limits = self.sequential.limits;
        let gate = self.config.gate_sigmas * (candidate.sigma_m + candidate.sigma_rotation * 10.0);
        let pair_distance_m = limits.pair_distance_m.min(gate.max(LEAST_PAIR_DISTANCE_M));
        Limits { pair_distance_m, ..limits }
    }

    /// Whether a pair must show more than the next scan of a chain: a loop, unless it is near and need not.
    fn must_prove_itself(&self, candidate: &Candidate) -> bool {
        candidate.kind == PairKind::Loop && (candidate.needs_coarse || self.config.verify_near_loops)
    }

    fn acceptance(&self, candidate: &Candidate) -> AcceptanceConfig {
        let acceptance = self.sequential.acceptance;
        if !self.must_prove_itself(candidate) {
            return acceptance;
        }
        AcceptanceConfig { min_overlap: acceptance.min_overlap.max(self.config.min_loop_overlap), ..acceptance }
    }
}

/// The Mahalanobis distance of what was found from what was predicted.
fn distance_in_sigmas(candidate: &Candidate, alignment: &Alignment) -> f64 {
    let error = log(&(candidate.predicted.inverse() * alignment.target_from_source));
    let covariance: Covariance = candidate.covariance + alignment.covariance;
    covariance.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error)).max(0.0).sqrt())
}
