//! A scan that registration slides along a direction which the scans hardly hold, wherever it is tried: the prior holds that
//! direction, registration the others.

use super::attempt::{Attempt, complete};
use super::sequential::SequentialAligner;
use super::{AlignmentRecord, Hypothesis, HypothesisName, TargetState};
use crate::geometry::Pose;
use crate::registration::Alignment;

/// An alignment that had slid and was taken back to the prior along what it had slid.
#[derive(Debug, Clone)]
pub(super) struct Held {
    target: TargetState,
    start: Pose,
    alignment: Alignment,
}

impl SequentialAligner {
    /// Remembers the one that overlaps most. A scan that was found already is not to be found anew like this.
    pub(super) fn note_held(&mut self, attempt: &Attempt<'_>, alignment: Alignment) {
        let is_better = self.held.as_ref().is_none_or(|held| alignment.overlap > held.alignment.overlap);
        if is_better && attempt.name != HypothesisName::Submap {
            self.held = Some(Held { target: *attempt.target, start: attempt.start, alignment });
        }
    }

    /// Completes the record with what was remembered, if anything was.
    pub(super) fn accept_held(&mut self, record: &mut AlignmentRecord) -> bool {
        let Some(Held { target, start, alignment }) = self.held.take() else { return false };
        record.hypotheses.push(Hypothesis {
            name: HypothesisName::Held,
            start,
            result: alignment.target_from_source,
            overlap: alignment.overlap,
            residual_m: alignment.residual_rms_m,
            iterations: 0,
            rejected: None,
        });
        complete(record, &target, alignment);
        true
    }
}
