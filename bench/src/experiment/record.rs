//! A finished run, as it is kept.

use mirador_core::view_planning::StopReason;
use serde::{Deserialize, Serialize};

use super::Entry;
use super::picture::Frame;
use crate::exploration::{GivenUp, Outcome, Step};
use mirador_core::simulation::ModelDistance;

/// A finished run, as it is kept in `runs/`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord {
    /// The source's name of the experiment; empty for what it did not do.
    pub experiment: String,
    /// The world.
    pub world: String,
    /// The strategy.
    pub strategy: String,
    /// Name of the weight set; empty for strategies without weights.
    pub weights_name: String,
    /// w_A, w_Q, w_O, w_C.
    pub weights: Option<[f64; 4]>,
    /// Seed of scans and candidates.
    pub seed: u64,
    /// How the robot moved: `kinematic`, in jumps along its paths with true poses.
    pub mode: String,
    /// Why it stopped; null when it was cut off or got stuck.
    pub stop: Option<StopReason>,
    /// The targets that were given up, because something stopped the robot on the way to them.
    pub given_up: Vec<GivenUp>,
    /// It ended because it gave up target after target.
    pub is_stuck: bool,
    /// The state after every scan.
    pub steps: Vec<Step>,
    /// The way after every scan but the last, as corners [m, map frame].
    pub ways: Vec<Vec<[f64; 2]>>,
    /// The model against the true surfaces.
    pub model_error: Option<ModelDistance>,
    /// Error of the poses [m]: null, they are true in this mode.
    pub pose_error_m: Option<f64>,
    /// Time of the run, simulation included [s].
    pub wall_s: f64,
    /// Where the picture of the map lies; null where none was kept.
    pub picture: Option<Frame>,
}

impl RunRecord {
    pub(super) fn new(entry: &Entry, seed: u64, outcome: &Outcome, picture: Option<Frame>) -> Self {
        Self {
            experiment: entry.experiment.clone(),
            world: entry.world.clone(),
            strategy: entry.strategy.clone(),
            weights_name: entry.weights_name.clone(),
            weights: entry.weights,
            seed,
            mode: "kinematic".into(),
            stop: outcome.stop,
            given_up: outcome.given_up.clone(),
            is_stuck: outcome.is_stuck,
            steps: outcome.steps.clone(),
            ways: outcome.ways.clone(),
            model_error: outcome.model_error,
            pose_error_m: None,
            wall_s: outcome.wall_s,
            picture,
        }
    }

    /// The stop reason as a word; `stuck` when it gave up target after target, `cut_off` when the limit of scans was reached.
    #[must_use]
    pub fn stop_word(&self) -> String {
        match self.stop.map(serde_json::to_value) {
            Some(Ok(serde_json::Value::String(word))) => word,
            _ if self.is_stuck => "stuck".to_owned(),
            _ => "cut_off".to_owned(),
        }
    }

    /// Whether it did not end by its own criterion: it got stuck, was cut off, or saw nowhere to go to.
    #[must_use]
    pub fn is_failure(&self) -> bool {
        !matches!(self.stop, Some(StopReason::Done | StopReason::NothingToGain))
    }

    /// The state at the end.
    pub(super) fn last(&self) -> Option<&Step> {
        self.steps.last()
    }

    /// The first scan after which coverage and quality are at least these.
    pub(super) fn reaches(&self, coverage: f64, quality: f64) -> Option<usize> {
        self.steps.iter().position(|step| step.coverage >= coverage && step.quality >= quality)
    }
}
