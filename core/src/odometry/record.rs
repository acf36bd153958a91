//! What the odometry says of a frame: the pose and the evidence for it.

use serde::{Deserialize, Serialize};

use crate::geometry::{Covariance, Pose, Twist};
use crate::registration::Constraint;

/// When a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameTime {
    /// The time of the last beam on the sensor's clock [s].
    pub end_s: f64,
    /// From the first beam to the last [s].
    pub duration_s: f64,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameStatus {
    /// The first frame: the map begins with it.
    Started,
    /// Aligned with the map, and added to it.
    Tracked,
    /// As `Tracked`, but in some directions of motion the map says nothing, and the pose keeps the prediction there
    /// (see `constraint`).
    UnderConstrained,
    /// No pose was found at which the frame fits the map. The pose is the prediction; the map stays as it was.
    Lost,
    /// Too few returns within the range limits to align anything. The pose is the prediction; the map stays as it was.
    TooFewPoints,
    /// The guess, or the prediction, holds a value that is not finite or is more than 10,000 km out. The frame was not
    /// looked at.
    InvalidGuess,
}

impl FrameStatus {
    /// Whether the pose was found in the map, and the frame added to it.
    #[must_use]
    pub fn is_tracked(self) -> bool {
        matches!(self, Self::Started | Self::Tracked | Self::UnderConstrained)
    }
}

/// Where the alignment that was kept had begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// The guess of the caller.
    Guess,
    /// The last motion goes on.
    ConstantVelocity,
    /// The scanner stands where it was.
    ZeroMotion,
    /// One of the poses of the search.
    Search,
}

/// The answer to one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// What became of the frame.
    pub status: FrameStatus,
    /// The scanner's pose at the end of the scan; the map's frame is the scanner's at the end of the first one, or
    /// that in which its guess was given.
    pub map_from_scanner: Pose,
    /// Covariance of `map_from_scanner` within the local map: 6x6, translation [m^2] before rotation [rad^2],
    /// perturbation on the right, in the scanner's frame. Drift since the first frame is not in it. Where there is no
    /// pose, the square of what the prediction may be off.
    pub covariance: Covariance,
    /// Where the alignment that was kept had begun.
    pub start: Start,
    /// `map_from_scanner` as it was expected: the guess, or the last motion gone on.
    pub predicted: Pose,
    /// The motion during the scan by which its points were deskewed: `start_from_end = exp(scan_motion)`, in the moving
    /// scanner's frame. Zero where the points carry no times, and for the first frame.
    pub scan_motion: Twist,
    /// The share of the frame's points that fit the map: the mean of 1 / (1 + (r / `robust_scale_m`)^2) over all
    /// points, with the distance r to the map's plane there, and 0 where the map has none.
    pub score: f64,
    /// The score below which the frame is lost.
    pub required_score: f64,
    /// The share of the frame's points for which the map has a plane.
    pub overlap: f64,
    /// Root mean square of the weighted distances to the planes [m].
    pub residual_rms_m: f64,
    /// Steps of the alignment that was kept.
    pub iterations: u32,
    /// Its last step was below the tolerances.
    pub converged: bool,
    /// How far the motion model was thought to be off before this frame: sigma of the adaptive threshold [m].
    pub threshold_m: f64,
    /// Poses tried by the search, 0 when the prediction was good enough.
    pub searched: u32,
    /// Points aligned.
    pub points: u32,
    /// Which directions of motion the map determines, in the scanner's frame.
    pub constraint: Constraint,
}
