//! What registration answers: the pose and the evidence for it.

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use crate::geometry::{Covariance, Pose, Twist};

/// The result of aligning one pair of scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// The best pose found, never one outside the limits. Along directions the geometry does not constrain it keeps
    /// the start.
    pub target_from_source: Pose,
    /// Covariance of `target_from_source`: 6x6, translation [m^2] before rotation [rad^2], perturbation on the right,
    /// in the source's frame. Along a direction that is not constrained the variance is at least the square of the
    /// pair distance allowed at the start.
    pub covariance: Covariance,
    /// The share of the source's reduced points that have a partner in the target within `overlap_distance_m`.
    pub overlap: f64,
    /// The distance within which a partner counts for `overlap` [m].
    pub overlap_distance_m: f64,
    /// Root mean square of the method's own residual over the paired points [m]: point to point or point to plane.
    pub residual_rms_m: f64,
    /// The method's objective at the returned pose, by which the best of all iterates was chosen: the mean over the
    /// source's points of the squared residual, cut off where a pair counts as none [m^2]. It compares poses of one
    /// pair of scans under one method and configuration, nothing else.
    pub cost: f64,
    /// Steps taken.
    pub iterations: u32,
    /// The last step was below the tolerances, at the final pair distance.
    pub converged: bool,
    /// The search ended at the border of the limits: the true pose may be beyond.
    pub limit_reached: bool,
    /// Which directions of motion the geometry determines.
    pub constraint: Constraint,
}

/// Which of the six directions of motion the pairs of points determine.
///
/// The test is on the eigenvalues of the normalised Hessian `D H D / sum(w)`, `H = sum(w J^T J)` with J the derivative
/// of the distance to the target's tangent plane, and D = diag(1, 1, 1, 1/L, 1/L, 1/L), L being the root mean square
/// range of the paired points. An eigenvalue is thus the mean squared change of that distance per metre of motion: 1/3
/// each where surfaces face all ways alike, 0 along a corridor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Constraint {
    /// The eigenvalues, ascending.
    pub eigenvalues: [f64; 6],
    /// Column k is the unit direction of eigenvalue k: translation [m] before rotation multiplied by `length_m`, in
    /// the source's frame.
    pub directions: Matrix6<f64>,
    /// L, by which rotations are made comparable with translations [m].
    pub length_m: f64,
    /// The least eigenvalue that counts as constrained.
    pub threshold: f64,
}

impl Constraint {
    /// Nothing is known: no pairs.
    #[must_use]
    pub fn none(threshold: f64) -> Self {
        Self { eigenvalues: [0.0; 6], directions: Matrix6::identity(), length_m: 1.0, threshold }
    }

    /// Whether direction k is determined.
    #[must_use]
    pub fn is_constrained(&self, k: usize) -> bool {
        self.eigenvalues.get(k).is_some_and(|value| *value >= self.threshold)
    }

    /// Bit k is set when direction k is determined.
    #[must_use]
    pub fn mask(&self) -> u8 {
        (0..6).filter(|k| self.is_constrained(*k)).fold(0, |mask, k| mask | 1 << k)
    }

    /// The number of directions that are determined.
    #[must_use]
    pub fn constrained_directions(&self) -> u32 {
        self.mask().count_ones()
    }

    /// The part of a motion that the geometry determines; the rest is dropped.
    #[must_use]
    pub fn project(&self, motion: &Twist) -> Twist {
        let scaled = motion.component_mul(&self.scale());
        let mut kept = Twist::zeros();
        for k in (0..6).filter(|k| self.is_constrained(*k)) {
            let direction = self.directions.column(k);
            kept += direction * direction.dot(&scaled);
        }
        kept.component_div(&self.scale())
    }

    /// The factors that turn a twist into the normalised coordinates of `directions`.
    pub(crate) fn scale(&self) -> Vector6<f64> {
        Vector6::new(1.0, 1.0, 1.0, self.length_m, self.length_m, self.length_m)
    }
}
