//! Simultaneous localisation and mapping in six degrees of freedom: every scan's place in one map.
//!
//! [`SequentialAligner`] is the sequential part (section 3, steps 1 and 3): it aligns each scan to the last one that was
//! accepted, judges the result, and accepts or flags it. [`global::GlobalAligner`] closes loops and corrects older scans
//! (steps 4 and 5). [`continuous::ContinuousAligner`] feeds the same map from the odometry of a scanner in motion. What
//! closed loops correct is spread by the [`pose_graph`], the default, or in proportion to distance ([`distribute`]);
//! [`relaxation`] fits all scans to each other at once. All take in any [`crate::registration::Registration`].

mod acceptance;
mod attempt;
pub mod continuous;
mod distribution;
mod errors;
mod farther;
pub mod global;
mod older_scans;
pub mod pose_graph;
mod prior;
mod record;
pub mod relaxation;
mod restore_error;
mod sequential;
mod sequential_config;
mod slid;
mod state;
#[cfg(test)]
mod tests;
mod verifier;
mod with_prior;

pub use acceptance::{AcceptanceConfig, Rejection};
pub use distribution::{distribute, shares};
pub use errors::{TrajectoryError, trajectory_error};
pub use prior::{Prior, PriorFrame};
pub use record::{AlignmentRecord, AlignmentStatus, Hypothesis, HypothesisName};
pub use restore_error::RestoreError;
pub use sequential::SequentialAligner;
pub use sequential_config::SequentialConfig;
pub use state::{AlignerState, TargetState};
