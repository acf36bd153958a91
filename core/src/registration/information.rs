//! What the pairs say about the pose: the Hessian of the distances to the tangent planes, the directions it
//! constrains, and the covariance.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

use super::Constraint;
use super::correspondences::Pair;
use crate::geometry::{Covariance, Twist};

/// Entries of the upper triangle of a 6x6 matrix.
const UPPER: usize = 21;
/// Added to the residual's variance [m^2]: no range finder is better than a millimetre.
const LEAST_VARIANCE: f64 = 1e-6;

/// The normal equations of point to plane, `H delta = -b`, with the sums that normalise them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PlaneSystem {
    upper: [f64; UPPER],
    gradient: [f64; 6],
    /// Sum of the weights.
    pub weight: f64,
    /// Weighted sum of squared residuals [m^2].
    pub residual_sq: f64,
    /// Weighted sum of squared ranges [m^2].
    range_sq: f64,
}

/// How the distances to the tangent planes err.
#[derive(Debug, Clone, Copy)]
pub(super) struct ErrorModel {
    /// Variance of each distance [m^2].
    pub variance: f64,
    /// How many points have one error in common.
    pub share: f64,
    /// A pull that all points have in common and no number of them averages out [m].
    pub bias_m: f64,
}

impl PlaneSystem {
    /// Adds a pair with the residual `n . (p - m)` and its derivative `[n, p x n]` by a perturbation on the right.
    #[inline]
    pub fn add(&mut self, pair: &Pair, residual: f64, weight: f64) {
        let turning = pair.source.cross(&pair.normal);
        let j = [pair.normal.x, pair.normal.y, pair.normal.z, turning.x, turning.y, turning.z];
        let mut k = 0;
        for row in 0..6 {
            let weighted = weight * j[row];
            self.gradient[row] += weighted * residual;
            for value in &j[row..] {
                self.upper[k] += weighted * value;
                k += 1;
            }
        }
        self.weight += weight;
        self.residual_sq += weight * residual * residual;
        self.range_sq += weight * pair.source.norm_squared();
    }

    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.upper.iter_mut().zip(&other.upper).for_each(|(a, b)| *a += b);
        self.gradient.iter_mut().zip(&other.gradient).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
        self.residual_sq += other.residual_sq;
        self.range_sq += other.range_sq;
    }

    /// Which directions the pairs constrain.
    pub fn constraint(&self, threshold: f64) -> Constraint {
        let length_m = (self.range_sq / self.weight).sqrt();
        if !(length_m.is_finite() && length_m > 0.0) {
            return Constraint::none(threshold);
        }
        let scale = Vector6::new(1.0, 1.0, 1.0, length_m, length_m, length_m);
        let mut normalised = Matrix6::zeros();
        let mut k = 0;
        for row in 0..6 {
            for column in row..6 {
                let value = self.upper[k] / (self.weight * scale[row] * scale[column]);
                normalised[(row, column)] = value;
                normalised[(column, row)] = value;
                k += 1;
            }
        }
        let eigen = SymmetricEigen::new(normalised);
        let mut order = [0, 1, 2, 3, 4, 5];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let mut constraint = Constraint { length_m, ..Constraint::none(threshold) };
        for (place, from) in order.into_iter().enumerate() {
            // Rounding can leave a zero eigenvalue slightly negative.
            constraint.eigenvalues[place] = eigen.eigenvalues[from].max(0.0);
            constraint.directions.set_column(place, &eigen.eigenvectors.column(from));
        }
        constraint
    }

    /// The Gauss-Newton step within the constrained directions; the others keep the pose (Zhang, Kaess, Singh 2016).
    pub fn step(&self, constraint: &Constraint) -> Twist {
        let gradient = Vector6::from(self.gradient).component_div(&constraint.scale()) / self.weight;
        let mut step = Twist::zeros();
        for k in (0..6).filter(|k| constraint.is_constrained(*k)) {
            let direction = constraint.directions.column(k);
            step -= direction * (direction.dot(&gradient) / constraint.eigenvalues[k]);
        }
        step.component_div(&constraint.scale())
    }

    /// The covariance of the pose. Unconstrained directions get at least `unknown_m` as their standard deviation.
    pub fn covariance(&self, constraint: &Constraint, errors: &ErrorModel, unknown_m: f64) -> Covariance {
        let known = (errors.variance + LEAST_VARIANCE) * errors.share / self.weight.max(1.0);
        let mut covariance = Covariance::zeros();
        for k in 0..6 {
            // An eigenvalue of zero would make it infinite, which no reader could use.
            let eigenvalue = constraint.eigenvalues[k].max(1e-4);
            let mut spread = known / eigenvalue + (errors.bias_m / eigenvalue).powi(2);
            if !constraint.is_constrained(k) {
                spread = spread.max(unknown_m * unknown_m);
            }
            let direction = constraint.directions.column(k).component_div(&constraint.scale());
            covariance += direction * direction.transpose() * spread;
        }
        (covariance + covariance.transpose()) * 0.5
    }
}
