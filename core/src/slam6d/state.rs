//! What a restarted sequential aligner needs to go on as if nothing had happened.

use serde::{Deserialize, Serialize};

use crate::geometry::{Covariance, Pose};

/// Everything an aligner remembers but the target's points, which are prepared again from the target's scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct AlignerState {
    /// The pose of the last scan, a guess when it was not accepted; `None` before the first.
    pub last: Option<Pose>,
    /// The motion from the scan before last to the last, `before_from_last`.
    pub last_motion: Option<Pose>,
    /// The scan the next one is aligned to; `None` before the first.
    pub target: Option<TargetState>,
}

/// The last accepted scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TargetState {
    /// The scan.
    pub scan_id: u64,
    /// Its pose.
    pub map_from_scanner: Pose,
    /// The prior it came with, `map_from_scanner` by odometry.
    pub prior: Option<Pose>,
    /// The number of its reduced points, by which a restart knows it again.
    pub reduced_points: u64,
    /// Covariance of its pose, see [`super::AlignmentRecord::covariance`].
    pub covariance: Covariance,
}
