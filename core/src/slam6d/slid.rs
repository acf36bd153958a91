//! A scan that registration slides along a direction which the scans hardly hold. Mostly that is by chance, and each attempt ends
//! somewhere else, or slides on from where it ended: then it is registered with the prior (see `with_prior`). Where two
//! attempts end at one place and a third stays there, it is the robot that has slid, or has stood while its wheels turned, and
//! what is wrong is the prior. So it is where two scans, each for itself and without sliding, come to one place.

use super::attempt::{Attempt, complete};
use super::farther::Farthest;
use super::older_scans::OlderScans;
use super::prior::SLOW;
use super::sequential::SequentialAligner;
use super::{AlignmentRecord, Hypothesis, HypothesisName, Rejection, TargetState};
use crate::geometry::{Pose, log, rotation_angle};
use crate::registration::{Alignment, PairIds, PreparedScan};

/// Two attempts that end so near to one another have come to one place [m, rad].
const ONE_PLACE_M: f64 = 0.1;
const ONE_PLACE: f64 = 0.02;
/// An attempt that ends so near to where it began has stayed, however many steps it took [m, rad].
const SAME_PLACE_M: f64 = 0.005;
const SAME_PLACE: f64 = 0.001;

/// What attempts that slid have come to, for the scan that is being aligned.
#[derive(Debug, Clone, Default)]
pub(super) struct Slid {
    /// Where each has ended, `map_from_scanner`.
    ended: Vec<Pose>,
    /// Whether two have ended at one place.
    is_confirmed: bool,
    /// Where attempts ended that only the prior speaks against: the target, and `map_from_scanner`.
    contradicted: Vec<(u64, Pose)>,
    /// Whether two targets have led to one place.
    is_witnessed: bool,
    /// Of the attempts that slid, or may have, the one that overlaps most.
    held: Option<Held>,
}

/// An attempt that the prior is to hold.
#[derive(Debug, Clone)]
struct Held {
    name: HypothesisName,
    target: TargetState,
    start: Pose,
    overlap: f64,
    /// What is left of it when the slide is taken back, unless something speaks against that.
    taken_back: Option<Alignment>,
}

impl Slid {
    /// Forgets the last scan.
    pub fn clear(&mut self) {
        self.ended.clear();
        self.contradicted.clear();
        (self.is_confirmed, self.is_witnessed, self.held) = (false, false, None);
    }

    /// Whether two attempts have come to one place, and none has slid on from there.
    pub fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Remembers where an attempt ended that did not slide, but contradicts the prior; whether another target has led there, too.
    pub fn witness(&mut self, target_id: u64, place: Pose) -> bool {
        let is_same =
            |(other, there): &(u64, Pose)| *other != target_id && are_within(there, &place, ONE_PLACE_M, ONE_PLACE);
        let agrees = self.contradicted.iter().any(is_same);
        self.contradicted.push((target_id, place));
        self.is_witnessed |= agrees;
        self.is_confirmed |= agrees;
        agrees
    }

    /// Whether an attempt from the confirmed place has stayed there, without many steps or all but exactly. If not, it is confirmed
    /// no more, unless two targets have led there.
    ///
    /// # Errors
    /// [`Rejection::Slid`].
    pub fn check_that_it_stays(&mut self, start: &Pose, alignment: &Alignment) -> Result<(), Rejection> {
        let ended = &alignment.target_from_source;
        let stays = alignment.iterations < SLOW && are_within(start, ended, ONE_PLACE_M, ONE_PLACE);
        if stays || are_within(start, ended, SAME_PLACE_M, SAME_PLACE) {
            return Ok(());
        }
        self.is_confirmed = self.is_witnessed;
        Err(Rejection::Slid { slid_m: (start.inverse() * ended).translation.vector.norm() })
    }
}

fn are_within(place: &Pose, other: &Pose, metres: f64, radians: f64) -> bool {
    let apart = other.inverse() * place;
    apart.translation.vector.norm() < metres && rotation_angle(&apart) < radians
}

impl SequentialAligner {
    /// Remembers where an attempt ended that slid far from the prior, `map_from_scanner`. Where the prior may still be right it is
    /// no proof that two have: they are of the same scans, and what draws one aside draws both.
    pub(super) fn note_slid(&mut self, ended: Pose, overlap: f64) {
        let is_far = self.sigmas_from_prior(&ended) > self.config().prior_gate_sigmas;
        if is_far && self.slid.ended.iter().any(|other| are_within(other, &ended, ONE_PLACE_M, ONE_PLACE)) {
            self.slid.is_confirmed = true;
            self.farthest = Some(Farthest { place: ended, overlap });
        }
        self.slid.ended.push(ended);
    }

    /// How far a place, `map_from_scanner`, lies from where the prior has the scan, in standard deviations of the prior; 0 for one
    /// that does not say how sure it is.
    fn sigmas_from_prior(&self, place: &Pose) -> f64 {
        let covariance = self.prior.and_then(|prior| prior.covariance);
        let Some((guess, covariance)) = self.guess_by_prior().zip(covariance) else { return 0.0 };
        let off = log(&(guess.inverse() * place));
        covariance.cholesky().map_or(0.0, |factor| off.dot(&factor.solve(&off)).max(0.0).sqrt())
    }

    /// Keeps an attempt that slid, or may have, for the case that nothing else fits: of several the one that overlaps most. There is
    /// nothing to go back to from a place where the prior does not have the scan.
    pub(super) fn keep_held(&mut self, attempt: &Attempt<'_>, overlap: f64, taken_back: Option<Alignment>) {
        let is_from_prior = attempt.name != HypothesisName::Farther;
        if is_from_prior && self.slid.held.as_ref().is_none_or(|held| overlap > held.overlap) {
            let &Attempt { name, target, start, .. } = attempt;
            self.slid.held = Some(Held { name, target: *target, start, overlap, taken_back });
        }
    }

    /// Completes the record with what can be believed of the attempt that was kept: its scans registered with the prior, else what
    /// is left of it without the slide.
    pub(super) fn accept_held(
        &mut self,
        record: &mut AlignmentRecord,
        last: (&TargetState, &dyn PreparedScan),
        older: &mut dyn OlderScans,
        source: &dyn PreparedScan,
    ) -> bool {
        if self.slid.is_confirmed {
            return false;
        }
        let Some(held) = self.slid.held.take() else { return false };
        let Held { name, target, start, taken_back, .. } = held;
        let is_last = target.scan_id == last.0.scan_id;
        let other = if is_last { None } else { older.by_id(&*self.registration, target.scan_id) };
        let other = other.as_ref().map(|(_, scan)| &**scan);
        let Some(scan) = (if is_last { Some(last.1) } else { other }) else { return false };
        let pair_distance_m = self.config.limits.pair_distance_m;
        let attempt = Attempt { name, target: &target, scan, start, pair_distance_m };
        self.registration.name_pair(PairIds { target: Some(target.scan_id), source: Some(record.scan_id) });
        let with_prior = self.register_with_prior(&attempt, source);
        let with_prior = with_prior.filter(|found| self.second_look(found, None, &attempt, source).is_ok());
        let iterations = with_prior.as_ref().map_or(0, |found| found.iterations);
        let Some(alignment) = with_prior.or(taken_back) else { return false };
        record.iterations += iterations;
        record.hypotheses.push(Hypothesis {
            name: HypothesisName::Held,
            start,
            result: alignment.target_from_source,
            overlap: alignment.overlap,
            residual_m: alignment.residual_rms_m,
            iterations,
            rejected: None,
        });
        complete(record, &target, alignment);
        true
    }
}
