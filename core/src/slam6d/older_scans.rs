//! What a scan that does not fit the last accepted one is tried against.

use std::sync::Arc;

use super::TargetState;
use crate::geometry::Pose;
use crate::registration::{PreparedScan, Registration};

/// An accepted scan, where it stands, as a registration method has prepared it.
pub(super) type Accepted = (TargetState, Arc<dyn PreparedScan>);

/// The accepted scans other than the last, those nearest to a guessed pose `map_from_scanner` first.
pub(super) trait OlderScans {
    /// How far off the nearest is [m]; infinite when there is none.
    fn nearest_m(&mut self, guess: &Pose) -> f64;

    /// The scan of this id, prepared by the method.
    fn by_id(&mut self, registration: &dyn Registration, scan_id: u64) -> Option<Accepted>;

    /// The k-th, prepared by the method.
    fn get(&mut self, registration: &dyn Registration, guess: &Pose, k: usize) -> Option<Accepted>;
}

/// There are none.
pub(super) struct NoOlderScans;

impl OlderScans for NoOlderScans {
    fn nearest_m(&mut self, _: &Pose) -> f64 {
        f64::INFINITY
    }

    fn by_id(&mut self, _: &dyn Registration, _: u64) -> Option<Accepted> {
        None
    }

    fn get(&mut self, _: &dyn Registration, _: &Pose, _: usize) -> Option<Accepted> {
        None
    }
}
