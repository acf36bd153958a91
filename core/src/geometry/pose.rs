//! Rigid motions in SE(3).

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Matrix6, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// A rigid motion named `target_from_source`: it maps coordinates in the source's frame to the target's frame [m].
pub type Pose = Isometry3<f64>;

/// A small motion: translation [m] first, then the rotation vector [rad].
pub type Twist = Vector6<f64>;

/// 6x6 covariance of a pose: translation [m^2] before rotation [rad^2], perturbation on the right, in the source's frame.
pub type Covariance = Matrix6<f64>;

/// The exponential map of SE(3): the motion reached by following `twist` for unit time.
#[must_use]
pub fn exp(twist: &Twist) -> Pose {
    let rho = Vector3::new(twist[0], twist[1], twist[2]);
    let phi = Vector3::new(twist[3], twist[4], twist[5]);
    let rotation = UnitQuaternion::from_scaled_axis(phi);
    Pose::from_parts(Translation3::from(left_jacobian(&phi) * rho), rotation)
}

/// The logarithm of SE(3), the inverse of [`exp`] for rotations below pi.
#[must_use]
pub fn log(pose: &Pose) -> Twist {
    let phi = pose.rotation.scaled_axis();
    let jacobian = left_jacobian(&phi);
    // The left Jacobian is regular for |phi| < 2 pi, and scaled_axis never exceeds pi.
    let rho = jacobian.try_inverse().unwrap_or_else(Matrix3::identity) * pose.translation.vector;
    Twist::new(rho[0], rho[1], rho[2], phi[0], phi[1], phi[2])
}

/// Ad(T), which moves a perturbation through a pose: `T exp(x) T^-1 = exp(Ad(T) x)`, translation before rotation.
#[must_use]
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation: Matrix3<f64> = pose.rotation.to_rotation_matrix().into_inner();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(pose.translation.vector.cross_matrix() * rotation));
    adjoint
}

/// The left Jacobian of SO(3); its series is used below 1e-4 rad, where the closed form loses its digits.
fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let hat = phi.cross_matrix();
    if angle < 1e-4 {
        return Matrix3::identity() + 0.5 * hat + hat * hat / 6.0;
    }
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity() + (1.0 - cos) / (angle * angle) * hat + (angle - sin) / (angle * angle * angle) * (hat * hat)
}

/// The angle of the pose's rotation [rad], in [0, pi].
#[must_use]
pub fn rotation_angle(pose: &Pose) -> f64 {
    // acos(w) loses half the digits near zero; atan2 of the vector part keeps them.
    let q = pose.rotation.quaternion();
    2.0 * q.imag().norm().atan2(q.w.abs())
}

/// The product of a chain of relative poses, from the first frame on: element k is `first_from_k`.
#[must_use]
pub fn compose_all(first_from_next: &[Pose]) -> Vec<Pose> {
    let mut chained = Vec::with_capacity(first_from_next.len() + 1);
    let mut pose = Pose::identity();
    chained.push(pose);
    for step in first_from_next {
        pose *= step;
        pose.rotation.renormalize();
        chained.push(pose);
    }
    chained
}

/// The pose as a row-major 4x4 matrix.
#[must_use]
pub fn rows_from_pose(pose: &Pose) -> [f64; 16] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|i| m[(i / 4, i % 4)])
}

/// The rigid pose nearest to a row-major 4x4 matrix, or `None` when its last row is not `0 0 0 1`, a value is not
/// finite, or the upper 3x3 block is farther than 1e-3 from a rotation.
#[must_use]
pub fn pose_from_rows(rows: &[f64; 16]) -> Option<Pose> {
    if rows.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let m = Matrix4::from_row_slice(rows);
    if (m[(3, 0)].abs() + m[(3, 1)].abs() + m[(3, 2)].abs() + (m[(3, 3)] - 1.0).abs()) > 1e-6 {
        return None;
    }
    let block: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into();
    if (block * block.transpose() - Matrix3::identity()).norm() > 1e-3 || block.determinant() < 0.0 {
        return None;
    }
    // The direct conversion keeps exact inputs exact; an iterative fit is only needed for rounded ones.
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(block));
    let q: Quaternion<f64> = *rotation.quaternion();
    Some(Pose::from_parts(Translation3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]), UnitQuaternion::from_quaternion(q)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    prop_compose! {
        fn any_pose()(t in prop::array::uniform3(-50.0..50.0f64), r in prop::array::uniform3(-1.7..1.7f64)) -> Pose {
            Pose::new(Vector3::from(t), Vector3::from(r))
        }
    }

    proptest! {
        #[test]
        fn the_adjoint_moves_a_perturbation_through_a_pose(
            pose in prop::array::uniform6(-1.5..1.5f64), small in prop::array::uniform6(-0.1..0.1f64),
        ) {
            let (pose, small) = (exp(&Twist::from(pose)), Twist::from(small));
            let moved = log(&(pose * exp(&small) * pose.inverse()));
            prop_assert!((moved - adjoint(&pose) * small).norm() < 1e-9);
        }

        #[test]
        fn the_logarithm_undoes_the_exponential(t in prop::array::uniform3(-9.0..9.0f64), r in prop::array::uniform3(-1.7..1.7f64)) {
            let twist = Twist::new(t[0], t[1], t[2], r[0], r[1], r[2]);
            prop_assert!((log(&exp(&twist)) - twist).norm() < 1e-9);
        }

        #[test]
        fn a_pose_survives_its_row_major_matrix(pose in any_pose()) {
            let back = pose_from_rows(&rows_from_pose(&pose)).unwrap();
            prop_assert!((back.inverse() * pose).translation.vector.norm() < 1e-9);
            prop_assert!(rotation_angle(&(back.inverse() * pose)) < 1e-9);
        }
    }

    #[test]
    fn a_tiny_rotation_keeps_its_digits() {
        let pose = Pose::new(Vector3::zeros(), Vector3::new(0.0, 0.0, 1e-9));
        assert!((rotation_angle(&pose) - 1e-9).abs() < 1e-15);
    }

    #[test]
    fn a_matrix_that_is_not_a_rotation_is_refused() {
        let mut rows = rows_from_pose(&Pose::identity());
        rows[0] = 1.2;
        assert!(pose_from_rows(&rows).is_none());
        rows[0] = f64::NAN;
        assert!(pose_from_rows(&rows).is_none());
    }
}
