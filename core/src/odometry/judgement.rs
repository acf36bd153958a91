//! What is said of a frame: whether its pose is believed, and how well it is known.

use super::registration::Outcome;
use super::system;
use super::track::Prediction;
use super::{FrameRecord, FrameStatus, Odometry, Start};
use crate::geometry::{Covariance, Twist};
use crate::registration::{Constraint, ErrorModel, covariance_of};

/// A frame that fits worse than this share of the usual, wherever it was looked for, is lost.
const LOST_SHARE: f64 = 0.7;

impl Odometry {
    /// The score below which a pose is none.
    pub(super) fn least_score(&self) -> f64 {
        self.config.minimum_score.max(LOST_SHARE * self.usual_score)
    }

    pub(super) fn record(
        &self,
        start: Start,
        outcome: &Outcome,
        searched: u32,
        prediction: &Prediction,
    ) -> FrameRecord {
        let constraint = system::in_scanner_axes(&outcome.constraint, &outcome.map_from_scanner);
        let sums = &outcome.system;
        let lost = outcome.score < self.least_score();
        let status = if lost {
            FrameStatus::Lost
        } else if constraint.constrained_directions() < 6 {
            FrameStatus::UnderConstrained
        } else {
            FrameStatus::Tracked
        };
        let mean_square = sums.residual_sq / sums.weight.max(1.0);
        let sigma = self.threshold.sigma_m();
        let share = self.config.points_per_independent_error;
        let points = self.frame.points();
        FrameRecord {
            status,
            map_from_scanner: outcome.map_from_scanner,
            covariance: if lost {
                self.covariance_of_prediction()
            } else {
                let errors = ErrorModel { variance: mean_square, share, bias_m: 0.0 };
                covariance_of(&constraint, &errors, sums.weight, sigma)
            },
            start,
            score: outcome.score,
            overlap: sums.pairs / points.max(1) as f64,
            residual_rms_m: mean_square.sqrt(),
            iterations: outcome.iterations,
            converged: outcome.converged,
            searched,
            points: points as u32,
            constraint,
            required_score: self.least_score(),
            ..self.unaligned(status, prediction)
        }
    }

    /// The record of a frame that says nothing of the pose.
    pub(super) fn unaligned(&self, status: FrameStatus, prediction: &Prediction) -> FrameRecord {
        FrameRecord {
            status,
            map_from_scanner: prediction.pose,
            covariance: self.covariance_of_prediction(),
            start: prediction.start,
            predicted: prediction.pose,
            scan_motion: Twist::zeros(),
            score: 0.0,
            required_score: self.config.minimum_score,
            overlap: 0.0,
            residual_rms_m: 0.0,
            iterations: 0,
            converged: false,
            threshold_m: self.threshold.sigma_m(),
            searched: 0,
            points: 0,
            constraint: Constraint::none(self.config.constrained_eigenvalue),
        }
    }

    /// A prediction is off by sigma at the far end of the range, by translation or by rotation.
    pub(super) fn covariance_of_prediction(&self) -> Covariance {
        let sigma = self.threshold.sigma_m();
        let turn = sigma / self.config.max_range_m;
        let variance = |k: usize| if k < 3 { sigma * sigma } else { turn * turn };
        Covariance::from_diagonal(&Twist::from_fn(|k, _| variance(k)))
    }
}
