//! Odometry for scanners in motion: every scan of a 10 Hz LiDAR against a local map of the last ones.
//!
//! [`Odometry`] takes one frame a call and answers with a [`FrameRecord`]: the pose, its covariance, how well the frame
//! fits, and which directions of motion the map determines. A frame that fits nowhere is flagged and leaves the map as
//! it was; the next one goes on from there.
//!
//! The pipeline is that of KISS-ICP (Vizzo et al. 2023): constant velocity, deskewing, two reductions, an adaptive
//! threshold, a robust kernel, a voxel-hash map. It departs from it where that is faster or surer: the map holds planes
//! (the mean and normal of the points in voxels of two sizes, as VGICP, Koide et al. 2021, keeps distributions), so
//! that a pair costs one look-up and an alignment a few steps; a frame is deskewed again by the motion it was found to
//! have; and where the prediction leads nowhere, many starts are followed and judged by how well they fit.

mod config;
mod deskew;
mod deskewing;
mod judgement;
mod keyframes;
mod level;
mod local_map;
mod pipeline;
mod record;
mod reduce;
mod registration;
mod search;
mod snapshot;
mod surfel;
mod system;
mod threshold;
mod track;
mod voxel_key;

#[cfg(test)]
mod tests;

pub use config::OdometryConfig;
pub use deskew::MotionTable;
pub use keyframes::{Keyframe, KeyframeConfig, KeyframeSelector};
pub use pipeline::Odometry;
pub use record::{FrameRecord, FrameStatus, FrameTime, Start};
pub use snapshot::SnapshotError;
