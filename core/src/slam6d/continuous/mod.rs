//! Scanners in motion: every scan is a frame of the odometry, some are keyframes, and keyframes are nodes of the map.
//!
//! The odometry tells where a frame is seen from the last keyframe; the map tells where that keyframe is. Loops are
//! closed and poses corrected between keyframes as between any other scans, and the frames between two keyframes move
//! along with the first of them. The odometry keeps a frame of reference of its own, which corrections do not touch.
//!
//! A frame that fits nowhere is said to be lost. After some of them the scanner is looked for among the keyframes by
//! what the place looks like; where it is found, the local map is made anew of the keyframes around.

mod aligner;
mod config;
mod lost;
mod record;
mod relocalisation;
mod state;
#[cfg(test)]
mod tests;

pub use aligner::{ContinuousAligner, ContinuousFrame, ContinuousRestoreError};
pub use config::{ContinuousConfig, RelocalisationConfig};
pub use state::{ContinuousState, FrameInput};
