//! Where an iteration stands, and how it takes a step: within the limits, narrowing the pair distance, keeping the best.

use nalgebra::UnitQuaternion;

use super::iteration::Problem;
use super::{Limits, Optimiser, RegistrationConfig};
use crate::geometry::{self, Pose, Twist};

/// The pair distance is halved when a step moves the points by less than this share of it.
const SETTLED_SHARE: f64 = 0.1;
/// After so many steps without a lower cost, each below this share of the pair distance, pairs only change places.
const STALLED_STEPS: u32 = 6;
const STALLED_SHARE: f64 = 0.02;

/// The best iterate so far.
#[derive(Debug, Clone, Copy)]
pub(super) struct Best {
    pub(super) pose: Pose,
    pub(super) cost: f64,
    pub(super) limited: bool,
}

/// Where the iteration stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Walk {
    pub(super) pose: Pose,
    pub(super) limited: bool,
    pub(super) gate: f64,
    pub(super) final_gate: f64,
    /// A last step that moves the points by less than this is enough [m]; zero asks for the configuration's.
    pub(super) tolerance_m: f64,
    pub(super) iterations: u32,
    /// Most steps.
    pub(super) most_iterations: u32,
    /// The last step was below the tolerances, at the final pair distance.
    pub(super) settled: bool,
    pub(super) damping: f64,
    /// Small steps in a row that did not lower the cost.
    pub(super) stalled: u32,
    /// The greatest squared residual that pulls [m^2].
    pub(super) trimmed_sq: f32,
    /// The robust scale, where the scans themselves tell one [m]; else the configuration's.
    pub(super) scale_m: Option<f64>,
    pub(super) first_cost: f64,
    pub(super) best: Best,
}

impl Walk {
    pub(super) fn new(pose: Pose, gate: f64) -> Self {
        Self {
            pose,
            limited: false,
            gate,
            final_gate: gate,
            tolerance_m: 0.0,
            iterations: 0,
            most_iterations: u32::MAX,
            settled: false,
            damping: 1e-3,
            stalled: 0,
            trimmed_sq: f32::INFINITY,
            scale_m: None,
            first_cost: f64::INFINITY,
            best: Best { pose, cost: f64::INFINITY, limited: false },
        }
    }

    /// Goes on from the best pose with another pair distance.
    pub(super) fn continued(&self, gate: f64) -> Self {
        let Best { pose, limited, .. } = self.best;
        Self { limited, iterations: self.iterations, ..Self::new(pose, gate) }
    }

    /// Keeps the present pose when it is the best so far, and tells whether it is.
    pub(super) fn judge(&mut self, cost: f64) -> bool {
        if self.first_cost.is_infinite() {
            self.first_cost = cost;
        }
        let improved = cost < self.best.cost;
        if improved {
            self.best = Best { pose: self.pose, cost, limited: self.limited };
        }
        improved
    }

    /// The damping of the next step: a step that made things worse asks for a shorter one (Marquardt 1963).
    pub(super) fn damping(&mut self, optimiser: Optimiser, improved: bool) -> f64 {
        match optimiser {
            Optimiser::GaussNewton => 0.0,
            Optimiser::LevenbergMarquardt => {
                self.damping = if improved { self.damping * 0.1 } else { self.damping * 10.0 }.clamp(1e-7, 1e3);
                self.damping
            }
        }
    }

    /// Takes a step, stays within the limits, and narrows the pair distance once the steps are small against it.
    /// `false` when the limits leave no way to go and the pair distance is final: then nothing was done.
    pub(super) fn advance(&mut self, problem: &Problem<'_>, step: &Twist, length_m: f64) -> bool {
        let mut next = self.pose * geometry::exp(step);
        next.rotation.renormalize();
        let limited;
        (next, limited) = within_limits(&next, problem.start, problem.limits);
        let moved = self.pose.inverse() * next;
        let (shift, turn) = (moved.translation.vector.norm(), geometry::rotation_angle(&moved));
        let stuck = limited && shift + turn * length_m < problem.config.translation_tolerance_m;
        if stuck && self.gate <= self.final_gate {
            return false;
        }
        (self.pose, self.limited) = (next, limited);
        self.iterations += 1;
        if shift + turn * length_m < SETTLED_SHARE * self.gate {
            self.gate = (0.5 * self.gate).max(self.final_gate);
        }
        true
    }

    /// Whether small steps at the final pair distance have stopped to make things better.
    pub(super) fn is_stalled(&mut self, improved: bool, step: &Twist, length_m: f64) -> bool {
        let moves_m = step.fixed_rows::<3>(0).norm() + step.fixed_rows::<3>(3).norm() * length_m;
        let in_place = self.gate <= self.final_gate && moves_m < STALLED_SHARE * self.gate;
        self.stalled = if improved || !in_place { 0 } else { self.stalled + 1 };
        self.stalled >= STALLED_STEPS
    }

    /// Whether a step at the final pair distance is below the tolerances.
    pub(super) fn is_small(&self, step: &Twist, length_m: f64, config: &RegistrationConfig) -> bool {
        let (shift, turn) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
        if self.gate > self.final_gate {
            false
        } else if self.tolerance_m > 0.0 {
            shift + turn * length_m < self.tolerance_m
        } else {
            shift < config.translation_tolerance_m && turn < config.rotation_tolerance
        }
    }
}

/// The pose moved back onto the border of the limits around `start`, and whether it was on it or beyond.
fn within_limits(pose: &Pose, start: &Pose, limits: &Limits) -> (Pose, bool) {
    let mut moved = start.inverse() * pose;
    let shift = moved.translation.vector.norm();
    let turn = geometry::rotation_angle(&moved);
    // A pose once moved to the border may lie a rounding error inside it.
    const BORDER: f64 = 1.0 - 1e-9;
    if shift <= BORDER * limits.max_translation_m && turn <= BORDER * limits.max_rotation {
        return (*pose, false);
    }
    if shift > limits.max_translation_m {
        moved.translation.vector *= limits.max_translation_m / shift;
    }
    if turn > limits.max_rotation {
        let axis = moved.rotation.scaled_axis();
        moved.rotation = UnitQuaternion::from_scaled_axis(axis * (limits.max_rotation / turn));
    }
    (start * moved, true)
}
