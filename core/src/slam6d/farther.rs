//! A scan that was taken farther from where its prior has it than an attempt may go: the wheels have turned where the robot
//! stood, or it has slid. What ended at its limits was often on its way to the right place, so it goes on from there.

use super::attempt::Attempt;
use super::older_scans::OlderScans;
use super::sequential::SequentialAligner;
use super::{AlignmentRecord, HypothesisName, TargetState};
use crate::geometry::Pose;
use crate::registration::PreparedScan;

/// How often it goes on: each time by as much as the limits allow.
const MOST: usize = 3;

impl SequentialAligner {
    /// Goes on from the best of the places where attempts ended at their limits or contradicted the prior, against the last
    /// accepted scan and older ones, and from where that ends. Only for a prior that says how sure it is. What is found is
    /// believed only if it is consistent with what each scanner has seen of the other.
    pub(super) fn go_farther(
        &mut self,
        record: &mut AlignmentRecord,
        last: (&TargetState, &dyn PreparedScan),
        older: &mut dyn OlderScans,
        source: &dyn PreparedScan,
    ) -> bool {
        let pair_distance_m = self.config().limits.pair_distance_m;
        for _ in 0..MOST {
            let Some(Farthest { place: from, .. }) = self.farthest.take() else { return false };
            let (name, start) = (HypothesisName::Farther, last.0.map_from_scanner.inverse() * from);
            let attempt = Attempt { name, target: last.0, scan: last.1, start, pair_distance_m };
            let was_confirmed = self.slid.is_confirmed();
            if self.attempt(record, &attempt, source) {
                return true;
            }
            if was_confirmed && !self.slid.is_confirmed() {
                return false;
            }
            if self.retry(record, name, &from, older, source) {
                return true;
            }
        }
        false
    }
}

/// Where the best of the attempts that ended at their limits has come to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Farthest {
    /// `map_from_scanner`.
    pub place: Pose,
    /// Share of the scan's points with a partner there.
    pub overlap: f64,
}
