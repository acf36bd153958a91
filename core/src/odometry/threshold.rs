//! How far the motion model is to be trusted: the adaptive threshold of KISS-ICP (Vizzo et al. 2023, section III-C).

use serde::{Deserialize, Serialize};

use crate::geometry::{Pose, rotation_angle};

/// How far a motion displaces a point at `range_m` from the scanner, at most [m]: equation 4 of the paper.
pub(super) fn displacement_m(motion: &Pose, range_m: f64) -> f64 {
    motion.translation.vector.norm() + 2.0 * range_m * (0.5 * rotation_angle(motion)).sin()
}

/// The deviations between predicted and found poses so far: equation 5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct AdaptiveThreshold {
    initial_m: f64,
    min_motion_m: f64,
    range_m: f64,
    sum_sq: f64,
    count: f64,
}

/// The deviations count so many frames, then they fade: after a bend in the road the threshold settles again.
const MEMORY_FRAMES: f64 = 100.0;

impl AdaptiveThreshold {
    pub fn new(initial_m: f64, min_motion_m: f64, range_m: f64) -> Self {
        Self { initial_m, min_motion_m, range_m, sum_sq: initial_m * initial_m, count: 1.0 }
    }

    /// The standard deviation sigma of the motion model's error at the far end of the range [m].
    pub fn sigma_m(&self) -> f64 {
        (self.sum_sq / self.count).sqrt()
    }

    /// Learns from a frame: the motion from the predicted to the found pose. Deviations below `min_motion_m` say
    /// nothing about the model, the scanner hardly moved.
    pub fn update(&mut self, found_from_predicted: &Pose) {
        let deviation = displacement_m(found_from_predicted, self.range_m);
        if deviation > self.min_motion_m {
            self.sum_sq += deviation * deviation;
            self.count += 1.0;
            if self.count > MEMORY_FRAMES {
                self.sum_sq *= MEMORY_FRAMES / self.count;
                self.count = MEMORY_FRAMES;
            }
        }
    }

    /// Nothing is known of the motion any more: as at the start.
    pub fn reset(&mut self) {
        *self = Self::new(self.initial_m, self.min_motion_m, self.range_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn shift(metres: f64) -> Pose {
        Pose::new(Vector3::new(metres, 0.0, 0.0), Vector3::zeros())
    }

    #[test]
    fn sigma_is_the_root_mean_square_of_the_deviations() {
        let mut threshold = AdaptiveThreshold::new(2.0, 0.1, 100.0);
        assert_eq!(threshold.sigma_m(), 2.0);
        threshold.update(&shift(1.0));
        threshold.update(&shift(0.05));
        assert!((threshold.sigma_m() - (5.0_f64 / 2.0).sqrt()).abs() < 1e-12);
        for _ in 0..2000 {
            threshold.update(&shift(0.3));
        }
        assert!((threshold.sigma_m() - 0.3).abs() < 1e-6);
        threshold.reset();
        assert_eq!(threshold.sigma_m(), 2.0);
    }

    #[test]
    fn a_turn_displaces_far_points_more() {
        let turn = Pose::new(Vector3::zeros(), Vector3::new(0.0, 0.0, 0.1));
        assert!((displacement_m(&turn, 50.0) - 100.0 * 0.05_f64.sin()).abs() < 1e-12);
        assert_eq!(displacement_m(&turn, 0.0), 0.0);
    }
}
