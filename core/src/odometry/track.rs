//! Where the scanner was, how it moved, and where it should be next.

use serde::{Deserialize, Serialize};

use super::{FrameTime, Start};
use crate::geometry::{self, Pose, Twist};

/// Poses farther out than this are a fault of the caller [m].
const FARTHEST_M: f64 = 1e10;
/// When so many times the usual interval passed without a frame, the last motion says nothing any more.
const STALE_INTERVALS: f64 = 5.0;

/// The scanner's last pose and motion.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Track {
    pose: Pose,
    /// The last motion, in the scanner's frame, over `interval`.
    motion: Twist,
    interval: Interval,
    /// Frames without a pose since the last.
    skipped: u32,
    /// When the last frame with a pose ended [s].
    end_s: Option<f64>,
    /// Frames with a pose.
    tracked: u64,
}

/// What lies between two frames with a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Interval {
    /// In frames: 1 when none was skipped between.
    frames: f64,
    seconds: Option<f64>,
}

impl Default for Interval {
    fn default() -> Self {
        Self { frames: 1.0, seconds: None }
    }
}

/// Where a frame should be.
#[derive(Debug, Clone)]
pub(super) struct Prediction {
    /// `map_from_scanner` at the end of the scan.
    pub pose: Pose,
    /// What it rests on.
    pub start: Start,
    /// The last pose.
    pub last: Pose,
    /// The motion during the scan, in the scanner's frame.
    pub scan_motion: Twist,
    /// Too long ago to go by the last motion.
    pub is_stale: bool,
    /// The part of the interval from the last pose that the scan took.
    scan_share: f64,
    interval: Interval,
    end_s: Option<f64>,
}

impl Prediction {
    /// The motion during the scan when it ended at a pose.
    pub fn scan_motion_to(&self, pose: &Pose) -> Twist {
        geometry::log(&(self.last.inverse() * pose)) * self.scan_share
    }

    /// Frames since the last pose.
    pub fn intervals(&self) -> f64 {
        self.interval.frames
    }

    /// Whether anything can be done with it.
    pub fn is_usable(&self) -> bool {
        let finite = self.pose.rotation.coords.iter().all(|v| v.is_finite());
        finite && self.pose.translation.vector.iter().all(|v| v.abs() < FARTHEST_M)
    }
}

impl Track {
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// Only the first frame has a pose: nothing is known of the motion.
    pub fn is_beginning(&self) -> bool {
        self.tracked < 2
    }

    /// Where a frame should be that ends at `time`.
    pub fn predict(&self, time: Option<FrameTime>, guess: Option<Pose>) -> Prediction {
        // Times that do not advance or are not numbers tell nothing: the frame counts as evenly spaced.
        let time = time.filter(|time| time.end_s.is_finite() && time.duration_s >= 0.0 && time.duration_s.is_finite());
        let seconds = time.zip(self.end_s).map(|(time, last)| time.end_s - last).filter(|seconds| *seconds > 0.0);
        let interval = Interval { frames: f64::from(self.skipped) + 1.0, seconds };
        let factor = match (seconds, self.interval.seconds) {
            (Some(now), Some(last)) => now / last,
            _ => interval.frames / self.interval.frames,
        };
        let is_stale = factor > STALE_INTERVALS;
        let motion = if is_stale { Twist::zeros() } else { self.motion * factor };
        let scan_share = match (time, seconds) {
            (Some(time), Some(seconds)) => (time.duration_s / seconds).min(1.0),
            _ => 1.0 / interval.frames,
        };
        let (pose, start) = match guess {
            Some(guess) => (guess, Start::Guess),
            None => (self.pose * geometry::exp(&motion), Start::ConstantVelocity),
        };
        let mut prediction = Prediction {
            pose,
            start,
            last: self.pose,
            scan_motion: motion * scan_share,
            is_stale,
            scan_share,
            interval,
            end_s: time.map(|time| time.end_s),
        };
        if guess.is_some() && self.tracked > 0 {
            prediction.scan_motion = prediction.scan_motion_to(&pose);
        }
        prediction
    }

    /// The first frame.
    pub fn begin(&mut self, prediction: &Prediction) {
        *self = Self { pose: prediction.pose, end_s: prediction.end_s, tracked: 1, ..Self::default() };
    }

    /// The scanner is here; nothing is known of its motion.
    pub fn restart(&mut self, pose: &Pose) {
        *self = Self { pose: *pose, tracked: 1, ..Self::default() };
    }

    /// A frame has a pose.
    pub fn advance(&mut self, prediction: &Prediction, pose: &Pose) {
        self.motion = geometry::log(&(self.pose.inverse() * pose));
        self.interval = prediction.interval;
        self.end_s = prediction.end_s;
        self.skipped = 0;
        self.tracked += 1;
        self.pose = *pose;
    }

    /// A frame has none.
    pub fn skip(&mut self) {
        self.skipped = self.skipped.saturating_add(1);
    }
}
