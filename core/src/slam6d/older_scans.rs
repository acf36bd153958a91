//! What a scan that does not fit the last accepted one is tried against.

use std::sync::Arc;

use super::TargetState;
use crate::geometry::Pose;
use crate::registration::{PreparedScan, Registration};

/// The accepted scans other than the last, those nearest to a guessed pose `map_from_scanner` first.
pub(super) trait OlderScans {
    /// How far off the nearest is [m]; infinite when there is none.
    fn nearest_m(&mut self, guess: &Pose) -> f64;

    /// The k-th, prepared by the method.
    fn get(
        &mut self,
        registration: &dyn Registration,
        guess: &Pose,
        k: usize,
    ) -> Option<(TargetState, Arc<dyn PreparedScan>)>;
}

/// There are none.
pub(super) struct NoOlderScans;

impl OlderScans for NoOlderScans {
    fn nearest_m(&mut self, _: &Pose) -> f64 {
        f64::INFINITY
    }

    fn get(&mut self, _: &dyn Registration, _: &Pose, _: usize) -> Option<(TargetState, Arc<dyn PreparedScan>)> {
        None
    }
}
