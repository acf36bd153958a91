//! What a restarted process needs beside the map and the odometry's own bytes.

use serde::{Deserialize, Serialize};

use crate::geometry::{Covariance, Pose};

/// What does not grow of continuous alignment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ContinuousState {
    /// The last keyframe; `None` before the first.
    pub(super) anchor: Option<Anchor>,
    /// The last frame with a pose.
    pub(super) last: Option<LastFrame>,
    /// Frames lost since then.
    pub(super) lost_frames: u32,
    /// Keyframes that the scanner was looked for at since it is lost.
    pub(super) keyframes_tried: usize,
    /// The frames since the odometry was written down.
    pub(super) since_snapshot: Vec<FrameInput>,
}

/// A keyframe in both frames of reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Anchor {
    pub scan_id: u64,
    /// Where the odometry saw it.
    pub odometry_from_scanner: Pose,
    /// How well: within the local map, perturbation on the right.
    pub covariance: Covariance,
    /// Where it was in the map when it came; the map knows better, if it is kept.
    pub map_from_scanner: Pose,
}

/// A frame with a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct LastFrame {
    pub odometry_from_scanner: Pose,
    pub prior: Option<Pose>,
}

/// What the odometry was told of a frame beside its points and times.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameInput {
    /// The scan.
    pub scan_id: u64,
    /// Where it was expected, in the odometry's frame.
    pub guess: Option<Pose>,
    /// The scanner was lost before.
    pub was_lost: bool,
}
