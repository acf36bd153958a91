//! Simultaneous localisation and mapping in six degrees of freedom: every scan's place in one map.
//!
//! This is the sequential part (section 3, steps 1 and 3): each scan is aligned to the last one that was accepted,
//! judged, and either accepted or flagged. It takes in any [`crate::registration::Registration`].

mod acceptance;
mod errors;
pub mod global;
pub mod pose_graph;
mod record;
mod sequential;
mod state;
#[cfg(test)]
mod tests;

pub use acceptance::{AcceptanceConfig, Rejection};
pub use errors::{TrajectoryError, trajectory_error};
pub use record::{AlignmentRecord, AlignmentStatus, Hypothesis, HypothesisName};
pub use sequential::{RestoreError, SequentialAligner, SequentialConfig};
pub use state::{AlignerState, TargetState};
