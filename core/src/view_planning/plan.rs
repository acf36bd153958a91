//! The outcome of planning, which is at the same time the record of the decision: it explains itself.

use super::config::PlanningConfig;
use serde::{Deserialize, Serialize};

/// What a strategy measured for one candidate before anything was brought to [0, 1].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RawGain {
    /// Unexplored cells in range, in the work area and not hidden: C_se - n_o (4.7).
    pub unexplored_cells: u32,
    /// Known cells in view.
    pub known_cells: u32,
    /// Sum over the known cells in view of the quality expected less the quality so far, improvements only (4.10).
    pub quality_sum: f64,
    /// Sum over the zones in view of |v . n_zone| [m^2] (4.11).
    pub zone_sum: f64,
}

/// A place to scan from, with everything that speaks for and against it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Position of the robot's base on the ground [m, map frame].
    pub position: [f64; 3],
    /// Heading on arrival [rad, map frame].
    pub heading: f64,
    /// A, information gain in [0, 1] (4.7).
    pub information: f64,
    /// Q, quality gain in [0, 1] (4.10).
    pub quality: f64,
    /// O, zones of interest in [0, 1] (4.11).
    pub zones: f64,
    /// C, travel cost [m] (4.6).
    pub cost: f64,
    /// u, utility (2.3); more is better.
    pub utility: f64,
    /// The sums behind A, Q and O.
    pub raw: RawGain,
}

/// Why a place was not made a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RejectionReason {
    /// Outside the work area.
    OutsideArea,
    /// The robot's footprint would touch an obstacle or a step.
    NearObstacle,
    /// No path leads there.
    Unreachable,
    /// Too near to where the robot stands, or to where it has scanned if the strategy keeps away from there.
    NearRobot,
    /// Too near to a candidate drawn earlier.
    NearCandidate,
    /// Too small a group of frontier cells.
    SmallFrontier,
}

/// A place that was considered and not made a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Where [m, map frame].
    pub position: [f64; 2],
    /// Why.
    pub reason: RejectionReason,
}

/// How often each reason applied.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rejections {
    /// All places rejected, by reason.
    pub counts: std::collections::BTreeMap<RejectionReason, usize>,
}

/// Why the exploration stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// No candidate is worth more than C_p and the asked mean quality is reached.
    Done,
    /// The map holds no ground that can be driven on.
    NoNavigableGround,
    /// There is ground to drive on, but no path leads to any of it.
    NothingReachable,
    /// Reachable ground is there, but every place on it was rejected.
    NoCandidate,
    /// No candidate would show anything new or better, although the asked mean quality is not reached.
    NothingToGain,
    /// The robot's pose is not finite or not on the map.
    LocalisationLost,
}

/// Go or stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "decision")]
pub enum Decision {
    /// Drive to a candidate and scan.
    Go {
        /// Index into [`ViewPlan::candidates`].
        candidate: usize,
    },
    /// Stop exploring.
    Stop {
        /// Why.
        reason: StopReason,
    },
}

/// A planned view, and the record of why. Nothing in it depends on time or on the number of threads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewPlan {
    /// Name of the strategy.
    pub strategy: String,
    /// Revision of the map the decision was taken on.
    pub map_revision: u64,
    /// Number of the scan after which it was taken.
    pub scan_number: u64,
    /// Seed of the run.
    pub run_seed: u64,
    /// map_from_robot, row-major 4x4.
    pub map_from_robot: [f64; 16],
    /// The settings.
    pub config: PlanningConfig,
    /// C_p (4.12).
    pub stop_threshold: f64,
    /// Mean Q_a of the reachable ground, `None` when there is none.
    pub mean_quality: Option<f64>,
    /// Cells with C_nc over the threshold within the horizon.
    pub navigable_cells: usize,
    /// Of those, the ones a path leads to.
    pub reachable_cells: usize,
    /// Every candidate with its terms, in the order in which they were drawn.
    pub candidates: Vec<Candidate>,
    /// The first places rejected, at most [`ViewPlan::MAX_REJECTED`].
    pub rejected: Vec<Rejected>,
    /// How many were rejected in all, by reason.
    pub rejections: Rejections,
    /// Indices of the candidates that are to be visited, in order, the chosen one first. Empty for strategies that look
    /// one view ahead.
    #[serde(default)]
    pub tour: Vec<usize>,
    /// What to do.
    pub decision: Decision,
    /// Waypoints from the robot's cell to the chosen candidate [m, map frame]; empty when stopping. Every straight
    /// piece stays in cells that were checked.
    pub path: Vec<[f64; 3]>,
}

impl ViewPlan {
    /// Rejected places listed one by one; the rest is only counted.
    pub const MAX_REJECTED: usize = 256;

    /// The chosen candidate, if the decision is to go.
    #[must_use]
    pub fn chosen(&self) -> Option<&Candidate> {
        match self.decision {
            Decision::Go { candidate } => self.candidates.get(candidate),
            Decision::Stop { .. } => None,
        }
    }

    pub(super) fn reject(&mut self, position: [f64; 2], reason: RejectionReason) {
        *self.rejections.counts.entry(reason).or_insert(0) += 1;
        if self.rejected.len() < Self::MAX_REJECTED {
            self.rejected.push(Rejected { position, reason });
        }
    }
}
