//! The decision record of a correction: which pairs were tried, what came of each, and what moved.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::geometry::{Covariance, Pose};
use crate::slam6d::Rejection;

/// What a pair of scans is expected to show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairKind {
    /// Scans that overlap because they were taken shortly after one another.
    Overlap,
    /// The robot was here before.
    Loop,
}

/// Where the registration of a pair began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairStart {
    /// At the poses as known.
    Prediction,
    /// At what coarse alignment found around them.
    Coarse,
}

/// Why a pair was not accepted.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairRejection {
    /// A keyframe could not be prepared again.
    #[error("{reason}")]
    Prepare {
        /// The words of the method.
        reason: String,
    },
    /// Coarse alignment found no hypothesis it trusts.
    #[error("coarse alignment: {reason}")]
    Coarse {
        /// Its own words.
        reason: String,
    },
    /// Registration did not give what it must show.
    #[error(transparent)]
    Registration(Rejection),
    /// The pose found is farther from the predicted one than both their uncertainties allow.
    #[error("the pose found is {sigmas:.1} standard deviations from the predicted one; {allowed:.1} are allowed")]
    Improbable {
        /// Distance [standard deviations].
        sigmas: f64,
        /// Allowed [standard deviations].
        allowed: f64,
    },
    /// At the pose found the scans contradict each other.
    #[error("the scans contradict each other: {reason}")]
    Contradiction {
        /// What verification says.
        reason: String,
    },
    /// The measurement cannot be used.
    #[error("{reason}")]
    Measurement {
        /// Why not.
        reason: String,
    },
}

/// What was tried for one pair of scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    /// What was expected of it.
    pub kind: PairKind,
    /// The earlier scan.
    pub target_id: u64,
    /// The later scan.
    pub source_id: u64,
    /// `target_from_source` by the poses before.
    pub predicted: Pose,
    /// The largest standard deviation of its position [m].
    pub predicted_sigma_m: f64,
    /// The largest standard deviation of its angles [rad].
    pub predicted_sigma_rotation: f64,
    /// The share of the source that the target should have seen, by the predicted poses.
    pub predicted_overlap: f64,
    /// Where registration began.
    pub start: PairStart,
    /// `target_from_source` found; the predicted one where nothing was found.
    pub found: Pose,
    /// The share of the source's points with a partner.
    pub overlap: f64,
    /// Root mean square of the residual [m].
    pub residual_m: f64,
    /// Steps taken.
    pub iterations: u32,
    /// Distance of what was found from what was predicted [standard deviations].
    pub sigmas: f64,
    /// Why it was not accepted, or `None` when it was.
    pub rejected: Option<PairRejection>,
}

/// A pose that was corrected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseCorrection {
    /// The scan.
    pub scan_id: u64,
    /// Its pose before, `map_from_scanner`.
    pub before: Pose,
    /// Its pose from now on, `map_from_scanner`.
    pub after: Pose,
    /// Covariance of `after`, see [`crate::slam6d::AlignmentRecord::covariance`]; an upper bound.
    pub covariance: Covariance,
}

/// The decision record of the correction that follows a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorrectionRecord {
    /// The scan.
    pub scan_id: u64,
    /// Earlier scans within reach of it that do not directly precede it.
    pub candidates: usize,
    /// The pairs that were tried, in order.
    pub pairs: Vec<PairRecord>,
    /// Accepted scans so far: the nodes of the graph.
    pub nodes: usize,
    /// Accepted pairs so far, the sequential ones included: its edges.
    pub edges: usize,
    /// Loop closures, by target and source, that are switched off since they contradict the rest.
    pub switched_off: Vec<(u64, u64)>,
    /// What was solved; `None` when every new pair agreed with the poses as they are.
    pub relaxation: Option<Relaxation>,
    /// The poses that were corrected, by the order of the scans.
    pub corrections: Vec<PoseCorrection>,
    /// Memory of all keyframes [bytes].
    pub keyframe_bytes: usize,
}

/// How the poses were solved for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Relaxation {
    /// Scans whose poses were free.
    pub free_nodes: usize,
    /// Weighted squared error of the pairs before. Zero for the proportional method, which has none.
    pub chi2_before: f64,
    /// And after.
    pub chi2_after: f64,
    /// Linearisations.
    pub iterations: u32,
    /// Whether the last step was below the tolerances.
    pub converged: bool,
}
