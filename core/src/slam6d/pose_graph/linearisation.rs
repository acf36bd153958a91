//! What an edge says about its two poses, to first order.
//!
//! With Z the measured and A^-1 B the present motion, the residual is e = log(Z^-1 A^-1 B), a twist in the frame of the
//! second pose. Perturbed on the right, A exp(a) and B exp(b), it becomes e + J_b b - J_b Ad(B^-1 A) a with
//! J_b = J_r(e)^-1, the inverse right Jacobian of SE(3) (Barfoot 2017, section 7.1.5; Sola, Deray, Atchuthan 2018).

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::Edge;
use crate::geometry::{Pose, Twist, adjoint};

/// The normal equations of one edge: its share of H and of the gradient.
pub(in crate::slam6d) struct Terms {
    pub from_from: Matrix6<f64>,
    pub from_to: Matrix6<f64>,
    pub to_to: Matrix6<f64>,
    pub gradient_from: Vector6<f64>,
    pub gradient_to: Vector6<f64>,
    /// e^T Omega e.
    pub chi2: f64,
}

/// The residual of an edge between two poses: log(Z^-1 A^-1 B).
pub(super) fn residual(edge: &Edge, from: &Pose, to: &Pose) -> Twist {
    logarithm(&(edge.from_from_to.inverse() * (from.inverse() * to)))
}

/// e^T Omega e.
pub(super) fn chi2(edge: &Edge, from: &Pose, to: &Pose) -> f64 {
    let e = residual(edge, from, to);
    e.dot(&(edge.information * e))
}

/// Linearises an edge at two poses; everything but `chi2` is multiplied by `weight`.
pub(super) fn linearise(edge: &Edge, from: &Pose, to: &Pose, weight: f64) -> Terms {
    let from_from_to = from.inverse() * to;
    let e = logarithm(&(edge.from_from_to.inverse() * from_from_to));
    let jacobian = inverse_right_jacobian(&e);
    let weighted = jacobian.tr_mul(&edge.information);
    let to_to = weighted * jacobian * weight;
    let whitened = edge.information * e;
    let gradient_to = jacobian.tr_mul(&whitened) * weight;
    Terms { chi2: e.dot(&whitened), ..Terms::of_motion(&from_from_to, to_to, gradient_to) }
}

impl Terms {
    /// The terms of both poses from those of a perturbation of the motion between them on its right: a perturbation of
    /// `to` is one of the motion, and one of `from` is the same as -Ad(to_from_from) times it.
    pub fn of_motion(from_from_to: &Pose, to_to: Matrix6<f64>, gradient_to: Vector6<f64>) -> Self {
        let adjoint = adjoint(&from_from_to.inverse());
        let from_to = -adjoint.tr_mul(&to_to);
        Self {
            from_from: -(from_to * adjoint),
            from_to,
            to_to,
            gradient_from: -adjoint.tr_mul(&gradient_to),
            gradient_to,
            chi2: 0.0,
        }
    }
}

/// [`crate::geometry::log`] without its matrix inversion.
fn logarithm(pose: &Pose) -> Twist {
    let phi = pose.rotation.scaled_axis();
    let rho = inverse_left_jacobian_of_rotation(&phi) * pose.translation.vector;
    Twist::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// The inverse of the right Jacobian of SE(3) at a twist: log(exp(e) exp(d)) = e + J_r(e)^-1 d to first order.
pub(super) fn inverse_right_jacobian(twist: &Twist) -> Matrix6<f64> {
    // J_r(e) = J_l(-e).
    let rho = Vector3::new(-twist[0], -twist[1], -twist[2]);
    let phi = Vector3::new(-twist[3], -twist[4], -twist[5]);
    let rotation = inverse_left_jacobian_of_rotation(&phi);
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-(rotation * coupling(&rho, &phi) * rotation)));
    jacobian
}

/// The inverse left Jacobian of SO(3).
fn inverse_left_jacobian_of_rotation(phi: &Vector3<f64>) -> Matrix3<f64> {
    let square = phi.norm_squared();
    let hat = phi.cross_matrix();
    // The closed form subtracts two large numbers at small angles; the series is exact to 1e-12 below 0.1 rad.
    let factor = if square < 1e-2 {
        1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30_240.0 + square / 1_209_600.0))
    } else {
        let angle = square.sqrt();
        1.0 / square - 0.5 / (angle * (0.5 * angle).tan())
    };
    Matrix3::identity() - 0.5 * hat + factor * hat * hat
}

/// The block that couples translation to rotation in the left Jacobian of SE(3) (Barfoot 2017, equation 7.86).
fn coupling(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
    let square = phi.norm_squared();
    let (first, second, third) = if square < 1e-2 {
        (
            1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362_880.0)),
            1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40_320.0 - square / 3_628_800.0)),
            1.0 / 120.0 - square * (1.0 / 2520.0 - square * (1.0 / 120_960.0 - square / 9_979_200.0)),
        )
    } else {
        let angle = square.sqrt();
        let (sin, cos) = angle.sin_cos();
        let fourth = square * square;
        (
            (angle - sin) / (square * angle),
            (square + 2.0 * cos - 2.0) / (2.0 * fourth),
            (2.0 * angle - 3.0 * sin + angle * cos) / (2.0 * fourth * angle),
        )
    };
    let (r, p) = (rho.cross_matrix(), phi.cross_matrix());
    let (pr, rp) = (p * r, r * p);
    let prp = pr * p;
    0.5 * r + first * (pr + rp + prp) + second * (p * pr + rp * p - 3.0 * prp) + third * (prp * p + p * prp)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::{exp, log};
    use crate::slam6d::pose_graph::EdgeKind;

    fn twist(scale: f64, t: [f64; 3], r: [f64; 3]) -> Twist {
        Twist::new(t[0], t[1], t[2], scale * r[0], scale * r[1], scale * r[2])
    }

    /// Central differences of the residual by the pose of `to` (`second`) or of `from`.
    fn numerical(edge: &Edge, from: &Pose, to: &Pose, second: bool) -> Matrix6<f64> {
        let h = 1e-5;
        let mut jacobian = Matrix6::zeros();
        for k in 0..6 {
            let moved = |sign: f64| {
                let mut delta = Twist::zeros();
                delta[k] = sign * h;
                let (a, b) = if second { (*from, to * exp(&delta)) } else { (from * exp(&delta), *to) };
                log(&(edge.from_from_to.inverse() * a.inverse() * b))
            };
            jacobian.set_column(k, &((moved(1.0) - moved(-1.0)) / (2.0 * h)));
        }
        jacobian
    }

    proptest! {
        #[test]
        fn jacobians_agree_with_numerical_derivatives_at_every_angle(
            t in prop::array::uniform3(-20.0..20.0f64), r in prop::array::uniform3(-1.7..1.7f64),
            et in prop::array::uniform3(-3.0..3.0f64), er in prop::array::uniform3(-1.6..1.6f64),
            size in 0..6_usize,
        ) {
            let scale = [1.0, 0.1, 0.05, 1e-2, 1e-5, 0.0][size];
            let from = exp(&twist(1.0, [3.0, -1.0, 2.0], [0.3, -0.4, 1.2]));
            let measured = exp(&twist(1.0, t, r));
            let to = from * measured * exp(&twist(scale, et, er));
            let edge = Edge { from: 0, to: 1, from_from_to: measured, information: Matrix6::identity(), kind: EdgeKind::Overlap };
            let e = residual(&edge, &from, &to);
            prop_assert!((e - log(&(measured.inverse() * from.inverse() * to))).norm() < 1e-8);
            let jb = inverse_right_jacobian(&e);
            let ja = -jb * adjoint(&(to.inverse() * from));
            prop_assert!((jb - numerical(&edge, &from, &to, true)).amax() < 1e-6);
            prop_assert!((ja - numerical(&edge, &from, &to, false)).amax() < 1e-5);
            let terms = linearise(&edge, &from, &to, 2.0);
            prop_assert!((terms.from_from - 2.0 * ja.transpose() * ja).amax() < 1e-9 * (1.0 + terms.from_from.amax()));
            prop_assert!((terms.from_to - 2.0 * ja.transpose() * jb).amax() < 1e-9 * (1.0 + terms.from_from.amax()));
            prop_assert!((terms.gradient_from - 2.0 * ja.transpose() * e).amax() < 1e-9 * (1.0 + terms.gradient_from.amax()));
            prop_assert!((terms.gradient_to - 2.0 * jb.transpose() * e).amax() < 1e-9 * (1.0 + terms.gradient_to.amax()));
        }
    }

    #[test]
    fn series_and_closed_form_meet() {
        let rho = Vector3::new(1.0, -2.0, 0.5);
        let axis = Vector3::new(0.3, 0.8, -0.52).normalize();
        let (below, above) = (axis * (0.1 - 1e-12), axis * (0.1 + 1e-12));
        assert!((coupling(&rho, &below) - coupling(&rho, &above)).amax() < 1e-9);
        let difference = inverse_left_jacobian_of_rotation(&below) - inverse_left_jacobian_of_rotation(&above);
        assert!(difference.amax() < 1e-11);
    }
}
