//! What the pairs say about the pose: the normal equations of the distances to the tangent planes, the directions they
//! constrain, and the covariance.

use nalgebra::{Matrix3, Matrix6, SMatrix, SymmetricEigen, Vector6};

use super::Constraint;
use super::pairs::{BATCH, LANES, Pairs};
use crate::geometry::{Covariance, Pose, Twist};

/// Entries of the upper triangle of a 6x6 matrix.
const UPPER: usize = 21;
/// Added to the residual's variance [m^2]: no range finder is better than a millimetre.
const LEAST_VARIANCE: f64 = 1e-6;

/// Normal equations `H delta = -g` of a perturbation of the source about its scanner. While they are summed their axes
/// are the target's; `turn` brings them to the source's, where the perturbation acts on the right.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct NormalEquations {
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
}

/// The normal equations of point to plane with the sums that normalise them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PlaneSystem {
    pub equations: NormalEquations,
    /// Sum of the weights.
    pub weight: f64,
    /// Weighted sum of squared residuals [m^2].
    pub residual_sq: f64,
    /// Weighted sum of squared ranges [m^2].
    range_sq: f64,
}

/// How the distances to the tangent planes err.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ErrorModel {
    /// Variance of each distance [m^2].
    pub variance: f64,
    /// How many points have one error in common.
    pub share: f64,
    /// A pull that all points have in common and no number of them averages out [m].
    pub bias_m: f64,
}

impl NormalEquations {
    /// Adds sums kept side by side: the upper triangle row by row, and the gradient.
    #[inline(always)]
    pub fn add_lanes(&mut self, upper: &[[f32; LANES]; UPPER], gradient: &[[f32; LANES]; 6]) {
        let mut entry = 0;
        for row in 0..6 {
            self.gradient[row] += total(&gradient[row]);
            for column in row..6 {
                let value = total(&upper[entry]);
                self.hessian[(row, column)] += value;
                if column > row {
                    self.hessian[(column, row)] += value;
                }
                entry += 1;
            }
        }
    }

    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.hessian += other.hessian;
        self.gradient += other.gradient;
    }

    /// From the target's axes to the source's.
    pub fn turn(&mut self, target_from_source: &Pose) {
        let rotation: Matrix3<f64> = target_from_source.rotation.to_rotation_matrix().into_inner();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        self.hessian = both.transpose() * self.hessian * both;
        self.gradient = both.transpose() * self.gradient;
    }

    /// The Gauss-Newton step within the constrained directions; the others keep the pose (Zhang, Kaess, Singh 2016).
    /// With `damping` the diagonal grows by that share (Levenberg-Marquardt). `None` when the equations are singular.
    pub fn step(&self, constraint: &Constraint, damping: f64) -> Option<Twist> {
        let scale = constraint.scale();
        let hessian = Matrix6::from_fn(|r, c| self.hessian[(r, c)] / (scale[r] * scale[c]));
        let gradient = self.gradient.component_div(&scale);
        // The open directions become rows of their own with the solution zero.
        let (mut reduced, mut right) = (Matrix6::identity(), Vector6::zeros());
        let basis: SMatrix<f64, 6, 6> = constraint.directions;
        let turned = basis.transpose() * hessian * basis;
        let along = basis.transpose() * gradient;
        for r in (0..6).filter(|k| constraint.is_constrained(*k)) {
            right[r] = -along[r];
            for c in (0..6).filter(|k| constraint.is_constrained(*k)) {
                reduced[(r, c)] = turned[(r, c)];
            }
            reduced[(r, r)] *= 1.0 + damping;
        }
        let solution = reduced.cholesky()?.solve(&right);
        Some((basis * solution).component_div(&scale))
    }
}

impl PlaneSystem {
    /// Adds a batch of pairs with the residuals `n . (q - m)` and their derivative `[n, arm x n]`. `normals` and
    /// `residuals` are theirs; weights past the number of pairs are zero.
    #[inline(always)]
    pub fn add(
        &mut self,
        pairs: &Pairs<'_>,
        normals: &[[f32; BATCH]; 3],
        residuals: &[f32; BATCH],
        weights: &[f32; BATCH],
    ) {
        let mut upper = [[0.0_f32; LANES]; UPPER];
        let mut gradient = [[0.0_f32; LANES]; 6];
        let mut norms = [[0.0_f32; LANES]; 3];
        for first in (0..pairs.count).step_by(LANES) {
            let lanes = |values: &[f32; BATCH]| {
                let mut out = [0.0_f32; LANES];
                out.copy_from_slice(&values[first..first + LANES]);
                out
            };
            let n = [lanes(&normals[0]), lanes(&normals[1]), lanes(&normals[2])];
            let a = [lanes(&pairs.arm[0]), lanes(&pairs.arm[1]), lanes(&pairs.arm[2])];
            let (w, r) = (lanes(weights), lanes(residuals));
            let cross = |i: usize, j: usize| {
                let mut out = [0.0_f32; LANES];
                for k in 0..LANES {
                    out[k] = a[i][k] * n[j][k] - a[j][k] * n[i][k];
                }
                out
            };
            let jacobian = [n[0], n[1], n[2], cross(1, 2), cross(2, 0), cross(0, 1)];
            let mut entry = 0;
            for row in 0..6 {
                let mut weighted = [0.0_f32; LANES];
                for k in 0..LANES {
                    weighted[k] = w[k] * jacobian[row][k];
                    gradient[row][k] += weighted[k] * r[k];
                }
                for column in row..6 {
                    for k in 0..LANES {
                        upper[entry][k] += weighted[k] * jacobian[column][k];
                    }
                    entry += 1;
                }
            }
            for k in 0..LANES {
                norms[0][k] += w[k];
                norms[1][k] += w[k] * r[k] * r[k];
                norms[2][k] += w[k] * (a[0][k] * a[0][k] + a[1][k] * a[1][k] + a[2][k] * a[2][k]);
            }
        }
        self.equations.add_lanes(&upper, &gradient);
        self.weight += total(&norms[0]);
        self.residual_sq += total(&norms[1]);
        self.range_sq += total(&norms[2]);
    }

    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.equations.merge(&other.equations);
        self.weight += other.weight;
        self.residual_sq += other.residual_sq;
        self.range_sq += other.range_sq;
    }

    /// Which directions the pairs constrain.
    pub fn constraint(&self, threshold: f64) -> Constraint {
        constraint_of(&self.equations.hessian, self.weight, self.range_sq, threshold)
    }

    /// The covariance of the pose. Unconstrained directions get at least `unknown_m` as their standard deviation.
    pub fn covariance(&self, constraint: &Constraint, errors: &ErrorModel, unknown_m: f64) -> Covariance {
        covariance_of(constraint, errors, self.weight, unknown_m)
    }
}

/// Which directions the pairs of these normal equations constrain, in the axes of those: `weight` is the sum of the
/// pairs' weights, `range_sq` that of their weighted squared ranges [m^2].
pub(crate) fn constraint_of(hessian: &Matrix6<f64>, weight: f64, range_sq: f64, threshold: f64) -> Constraint {
    let length_m = (range_sq / weight).sqrt();
    if !(length_m.is_finite() && length_m > 0.0) {
        return Constraint::none(threshold);
    }
    let mut constraint = Constraint { length_m, ..Constraint::none(threshold) };
    let scale = constraint.scale();
    let normalised = Matrix6::from_fn(|r, c| hessian[(r, c)] / (weight * scale[r] * scale[c]));
    let eigen = SymmetricEigen::new(normalised);
    let mut order = [0, 1, 2, 3, 4, 5];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    for (place, from) in order.into_iter().enumerate() {
        // Rounding can leave a zero eigenvalue slightly negative.
        constraint.eigenvalues[place] = eigen.eigenvalues[from].max(0.0);
        constraint.directions.set_column(place, &eigen.eigenvectors.column(from));
    }
    constraint
}

/// The covariance of a pose found by pairs with this sum of weights. Unconstrained directions get at least `unknown_m`
/// as their standard deviation.
pub(crate) fn covariance_of(constraint: &Constraint, errors: &ErrorModel, weight: f64, unknown_m: f64) -> Covariance {
    let known = (errors.variance + LEAST_VARIANCE) * errors.share / weight.max(1.0);
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

/// The lanes added up, in double precision and in one order.
#[inline(always)]
fn total(lanes: &[f32; LANES]) -> f64 {
    lanes.iter().fold(0.0, |sum, lane| sum + f64::from(*lane))
}
