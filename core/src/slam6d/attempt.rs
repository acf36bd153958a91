//! One attempt to align a scan, from a start to a result that is accepted or not.

use super::farther::Farthest;
use super::prior::{Slide, hold_weak_directions, weigh};
use super::sequential::{SequentialAligner, normalised};
use super::{AlignmentRecord, AlignmentStatus, Hypothesis, HypothesisName, Rejection, TargetState};
use crate::geometry::{Pose, adjoint};
use crate::registration::{AlignError, Alignment, Limits, PairIds, PreparedScan};

/// So many times the distance from the prior is allowed when nothing else has fitted: a robot that has slid believes its wheels
/// too much, and one whose scan is not aligned is lost.
const LAST_RESORT: f64 = 2.0;
/// The same where two attempts have come to the place.
const CONFIRMED: f64 = 4.0;

/// A start to be tried against a scan.
pub(super) struct Attempt<'a> {
    pub name: HypothesisName,
    pub target: &'a TargetState,
    pub scan: &'a dyn PreparedScan,
    /// `target_from_source`.
    pub start: Pose,
    pub pair_distance_m: f64,
}

impl SequentialAligner {
    /// Tries one start against one scan, notes the hypothesis, and completes the record if the result is accepted.
    pub(super) fn attempt(
        &mut self,
        record: &mut AlignmentRecord,
        attempt: &Attempt<'_>,
        source: &dyn PreparedScan,
    ) -> bool {
        let &Attempt { target, scan, start, pair_distance_m, .. } = attempt;
        let limits = Limits { pair_distance_m, ..self.config.limits };
        self.registration.name_pair(PairIds { target: Some(target.scan_id), source: Some(record.scan_id) });
        let result = self.registration.align(scan, source, &start, &limits);
        let (mut hypothesis, alignment) = self.judge(attempt, &limits, result);
        if let Some(Rejection::NotConverged { .. }) = hypothesis.rejected {
            self.keep_held(attempt, hypothesis.overlap, None);
        }
        let alignment = alignment.and_then(|alignment| self.believe(alignment, &mut hypothesis, attempt, source));
        self.note_farthest(target, &hypothesis);
        record.iterations += hypothesis.iterations;
        record.hypotheses.push(hypothesis);
        let Some(alignment) = alignment else { return false };
        complete(record, target, alignment);
        true
    }

    /// Weighs what registration has found with the prior and with what the scanners have seen; `None`, with the reason in the
    /// hypothesis, where it is not believed.
    fn believe(
        &mut self,
        mut alignment: Alignment,
        hypothesis: &mut Hypothesis,
        attempt: &Attempt<'_>,
        source: &dyn PreparedScan,
    ) -> Option<Alignment> {
        let is_farther = attempt.name == HypothesisName::Farther;
        if is_farther && self.slid.is_confirmed() {
            hypothesis.rejected = self.slid.check_that_it_stays(&attempt.start, &alignment).err();
            if hypothesis.rejected.is_some() {
                return None;
            }
        }
        let ended = normalised(attempt.target.map_from_scanner * alignment.target_from_source);
        let (slide, contradiction) = self.weigh(&mut alignment, attempt);
        let second = self.second_look(&alignment, contradiction, attempt, source);
        // Where registration has ended is not believed; what is left of it is, when nothing else fits.
        let has_slid = slide.slid_m > 0.0;
        if !is_farther && (has_slid || slide.is_unsure) {
            let (slid_m, iterations, overlap) = (slide.slid_m, alignment.iterations, alignment.overlap);
            let doubt = if has_slid { Rejection::Slid { slid_m } } else { Rejection::Unsure { iterations } };
            if has_slid {
                self.note_slid(ended, overlap);
            }
            self.keep_held(attempt, overlap, second.is_ok().then_some(alignment));
            hypothesis.rejected = Some(second.err().unwrap_or(doubt));
            return None;
        }
        hypothesis.result = alignment.target_from_source;
        hypothesis.rejected = second.err();
        hypothesis.rejected.is_none().then_some(alignment)
    }

    /// Remembers where an attempt that overlaps more than others was refused only for being far from where the prior has it.
    fn note_farthest(&mut self, target: &TargetState, hypothesis: &Hypothesis) {
        let overlap = hypothesis.overlap;
        let place = normalised(target.map_from_scanner * hypothesis.result);
        let is_farther = hypothesis.name == HypothesisName::Farther;
        let contradicts = matches!(hypothesis.rejected, Some(Rejection::ContradictsPrior { .. })) && !is_farther;
        if contradicts && self.slid.witness(target.scan_id, place) {
            self.farthest = Some(Farthest { place, overlap });
        }
        let is_better = self.farthest.is_none_or(|best| overlap > best.overlap);
        let is_far = match hypothesis.rejected {
            Some(Rejection::TooFar { .. }) => true,
            Some(Rejection::ContradictsPrior { .. }) => !is_farther,
            _ => false,
        };
        if is_better && is_far && !self.slid.is_confirmed() {
            self.farthest = Some(Farthest { place, overlap });
        }
    }

    /// Weighs an alignment with the prior if that came with a covariance. How far it had slid and was taken back; and where
    /// the two contradict each other, by how many standard deviations.
    fn weigh(&self, alignment: &mut Alignment, attempt: &Attempt<'_>) -> (Slide, Option<f64>) {
        let gate = self.config.prior_gate_sigmas;
        let covariance = self.prior.and_then(|prior| prior.covariance).filter(|_| gate > 0.0);
        let Some((covariance, guess)) = covariance.zip(self.guess_by_prior()) else { return (Slide::default(), None) };
        let expected = attempt.target.map_from_scanner.inverse() * guess;
        let is_confirmed = attempt.name == HypothesisName::Farther && self.slid.is_confirmed();
        let slide =
            if is_confirmed { Slide::default() } else { hold_weak_directions(alignment, &expected, &covariance) };
        (slide, weigh(alignment, &expected, &covariance, gate).err())
    }

    /// Weighs an alignment that overlaps little, contradicts the prior or went farther than allowed by evidence of its own. One
    /// that overlaps little and contradicts the prior is not believed while others are to be tried: scans that share little
    /// often fit somewhere else as well.
    pub(super) fn second_look(
        &mut self,
        alignment: &Alignment,
        contradiction: Option<f64>,
        attempt: &Attempt<'_>,
        source: &dyn PreparedScan,
    ) -> Result<(), Rejection> {
        let (acceptance, pose) = (self.config.acceptance, &alignment.target_from_source);
        match (acceptance.is_doubtful(alignment), contradiction) {
            (false, None) if attempt.name != HypothesisName::Farther => return Ok(()),
            (true, Some(sigmas)) => {
                let times = match attempt.name {
                    HypothesisName::Farther if self.slid.is_confirmed() => CONFIRMED,
                    HypothesisName::Farther => LAST_RESORT,
                    _ => 1.0,
                };
                let (allowed, overlap) = (times * self.config.prior_gate_sigmas, alignment.overlap);
                if sigmas > allowed {
                    return Err(Rejection::ContradictsPrior { sigmas, allowed, overlap });
                }
            }
            _ => {}
        }
        acceptance.weigh(&match attempt.name {
            HypothesisName::OlderScan | HypothesisName::Farther => {
                self.verifier.weigh_other(attempt.scan, source, pose)
            }
            _ => self.verifier.weigh(attempt.scan, source, pose),
        })
    }

    /// The hypothesis as recorded, and the alignment if it is accepted; a prior holds directions that the scans leave open.
    fn judge(
        &self,
        attempt: &Attempt<'_>,
        limits: &Limits,
        result: Result<Alignment, AlignError>,
    ) -> (Hypothesis, Option<Alignment>) {
        use HypothesisName::{OlderScan, PriorMotion, PriorMotionWide};
        let &Attempt { name, start, .. } = attempt;
        let has_prior = matches!(name, PriorMotion | PriorMotionWide | OlderScan);
        let failed =
            Hypothesis { name, start, result: start, overlap: 0.0, residual_m: 0.0, iterations: 0, rejected: None };
        match result {
            Err(error) => {
                let rejected = Some(Rejection::Failed { reason: error.to_string() });
                (Hypothesis { rejected, ..failed }, None)
            }
            Ok(alignment) => {
                let rejected = self.config.acceptance.judge(&alignment, &start, limits, has_prior).err();
                let hypothesis = Hypothesis {
                    result: alignment.target_from_source,
                    overlap: alignment.overlap,
                    residual_m: alignment.residual_rms_m,
                    iterations: alignment.iterations,
                    rejected: rejected.clone(),
                    ..failed
                };
                (hypothesis, rejected.is_none().then_some(alignment))
            }
        }
    }
}

/// Writes an accepted pair into the record.
pub(super) fn complete(record: &mut AlignmentRecord, target: &TargetState, alignment: Alignment) {
    record.target_id = Some(target.scan_id);
    record.map_from_scanner = normalised(target.map_from_scanner * alignment.target_from_source);
    record.target_from_scanner = Some(alignment.target_from_source);
    // A perturbation of the target's pose seen from the source: exp(x) T = T exp(Ad(T^-1) x).
    let carried = adjoint(&alignment.target_from_source.inverse());
    record.covariance = carried * target.covariance * carried.transpose() + alignment.covariance;
    record.pair_covariance = Some(alignment.covariance);
    record.overlap = alignment.overlap;
    record.residual_m = alignment.residual_rms_m;
    record.constraint = Some(alignment.constraint);
    record.status = AlignmentStatus::Aligned;
}
