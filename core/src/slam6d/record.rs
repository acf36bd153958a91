//! The decision record of one scan: what was tried, what came of it, what was chosen and why.

use serde::{Deserialize, Serialize};

use super::Rejection;
use crate::geometry::{Covariance, Pose};
use crate::registration::Constraint;

/// Where a hypothesis starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HypothesisName {
    /// The motion since the target according to the priors (odometry).
    PriorMotion,
    /// The same, with the larger pair distance.
    PriorMotionWide,
    /// The last motion goes on.
    ConstantMotion,
    /// The same, with the larger pair distance.
    ConstantMotionWide,
    /// The prior again, against an older scan near it, for a scan that does not fit the last accepted one.
    OlderScan,
    /// Where an attempt had slid that fitted otherwise, taken back to the prior along what it had slid.
    Held,
    /// Where an attempt ended that wanted to be farther from its start than allowed.
    Farther,
    /// The scanner stands where it was; turned as the prior has it, where there is one.
    ZeroMotion,
    /// Found by the search of the odometry around the last pose; the start given is the predicted one.
    Search,
    /// Found anew among the keyframes of the map, without any start.
    Relocalisation,
}

/// One attempt to align the scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hypothesis {
    /// Where it starts from.
    pub name: HypothesisName,
    /// The start, `target_from_source`.
    pub start: Pose,
    /// The result, `target_from_source`; the start itself when the method failed.
    pub result: Pose,
    /// Share of the scan's points with a partner.
    pub overlap: f64,
    /// Root mean square of the residual [m].
    pub residual_m: f64,
    /// Steps taken.
    pub iterations: u32,
    /// Why it was not accepted, or `None` when it was.
    pub rejected: Option<Rejection>,
}

/// What became of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlignmentStatus {
    /// It is the first and defines the map.
    First,
    /// It was aligned and is the next scan's target.
    Aligned,
    /// It was not: its pose is a guess, and nothing is aligned to it. The reason is that of the first hypothesis.
    NotAligned(Rejection),
}

/// The decision record of one scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlignmentRecord {
    /// The scan.
    pub scan_id: u64,
    /// The scan it was aligned to.
    pub target_id: Option<u64>,
    /// The name of the registration method.
    pub method: String,
    /// The pose it came with, `map_from_scanner` by odometry.
    pub prior: Option<Pose>,
    /// What was tried, in order; when the status is `Aligned` the last one that was not rejected counts. Start and result of each
    /// are seen from the scan it was tried against: `target_id`, but for those of older scans that were not accepted.
    pub hypotheses: Vec<Hypothesis>,
    /// The chosen pose.
    pub map_from_scanner: Pose,
    /// Where the scan was taken as seen from `target_id`, as it was measured; `None` when it was not.
    pub target_from_scanner: Option<Pose>,
    /// Covariance of `map_from_scanner`, the errors of all pairs on the way added up: 6x6, translation [m^2] before
    /// rotation [rad^2], perturbation on the right, in the scanner's frame. Zero for the first scan.
    pub covariance: Covariance,
    /// Covariance of this pair alone, `target_from_source`; `None` when the scan was not aligned.
    pub pair_covariance: Option<Covariance>,
    /// Share of the scan's points with a partner in the target, at the chosen pose; 0 when not aligned.
    pub overlap: f64,
    /// Root mean square of the residual [m]; 0 when not aligned.
    pub residual_m: f64,
    /// Steps taken over all hypotheses.
    pub iterations: u32,
    /// Which directions the geometry constrains, at the chosen pose; `None` when not aligned.
    pub constraint: Option<Constraint>,
    /// What became of the scan.
    pub status: AlignmentStatus,
}

impl AlignmentRecord {
    /// Whether the pose may be relied on: the scan is the first or was aligned.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        !matches!(self.status, AlignmentStatus::NotAligned(_))
    }
}
