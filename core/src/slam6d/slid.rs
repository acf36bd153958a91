//! A scan that registration slides along a direction which the scans hardly hold. Mostly that is by chance, and each attempt ends
//! somewhere else, or slides on from where it ended: then the prior holds that direction and registration the others. Where two
//! attempts end at one place and a third stays there, it is the robot that has slid, or has stood while its wheels turned, and
//! what is wrong is the prior.

use super::attempt::{Attempt, complete};
use super::farther::Farthest;
use super::prior::SLOW;
use super::sequential::SequentialAligner;
use super::{AlignmentRecord, Hypothesis, HypothesisName, Rejection, TargetState};
use crate::geometry::{Pose, rotation_angle};
use crate::registration::Alignment;

/// Two attempts that end so near to one another have come to one place [m, rad].
const ONE_PLACE_M: f64 = 0.1;
const ONE_PLACE: f64 = 0.02;

/// What attempts that slid have come to, for the scan that is being aligned.
#[derive(Debug, Clone, Default)]
pub(super) struct Slid {
    /// Where each has ended, `map_from_scanner`.
    ended: Vec<Pose>,
    /// Whether two have ended at one place.
    is_confirmed: bool,
    /// The one that overlaps most, taken back to the prior along what it had slid.
    held: Option<Held>,
}

/// An alignment that was taken back.
#[derive(Debug, Clone)]
struct Held {
    target: TargetState,
    start: Pose,
    alignment: Alignment,
}

impl Slid {
    /// Forgets the last scan.
    pub fn clear(&mut self) {
        self.ended.clear();
        (self.is_confirmed, self.held) = (false, None);
    }

    /// Whether two attempts have come to one place, and none has slid on from there.
    pub fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Whether an attempt from the confirmed place has stayed there, without many steps. If not, it is confirmed no more.
    ///
    /// # Errors
    /// [`Rejection::Slid`].
    pub fn check_that_it_stays(&mut self, start: &Pose, alignment: &Alignment) -> Result<(), Rejection> {
        self.is_confirmed &= alignment.iterations < SLOW && are_one(start, &alignment.target_from_source);
        let slid_m = (start.inverse() * alignment.target_from_source).translation.vector.norm();
        if self.is_confirmed { Ok(()) } else { Err(Rejection::Slid { slid_m }) }
    }
}

fn are_one(place: &Pose, other: &Pose) -> bool {
    let apart = other.inverse() * place;
    apart.translation.vector.norm() < ONE_PLACE_M && rotation_angle(&apart) < ONE_PLACE
}

impl SequentialAligner {
    /// Remembers an attempt that slid: where it ended, and what is left of it when that is taken back. A refinement begins where
    /// another attempt has ended and so confirms nothing.
    pub(super) fn note_slid(
        &mut self,
        attempt: &Attempt<'_>,
        ended: Pose,
        alignment: Alignment,
        rejected: Option<&Rejection>,
    ) {
        if attempt.name == HypothesisName::Submap {
            return;
        }
        if self.slid.ended.iter().any(|other| are_one(other, &ended)) {
            self.slid.is_confirmed = true;
            self.farthest = Some(Farthest { place: ended, overlap: alignment.overlap });
        }
        self.slid.ended.push(ended);
        let is_better = self.slid.held.as_ref().is_none_or(|held| alignment.overlap > held.alignment.overlap);
        if is_better && matches!(rejected, Some(Rejection::Slid { .. })) {
            self.slid.held = Some(Held { target: *attempt.target, start: attempt.start, alignment });
        }
    }

    /// Completes the record with what was taken back, if anything was and nothing speaks against it.
    pub(super) fn accept_held(&mut self, record: &mut AlignmentRecord) -> bool {
        if self.slid.is_confirmed {
            return false;
        }
        let Some(Held { target, start, alignment }) = self.slid.held.take() else { return false };
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
