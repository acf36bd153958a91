//! The rigid motion that best takes points onto points.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::geometry::Pose;

/// The pose `target_from_source` with the least sum of squared distances of the pairs (Umeyama 1991, without scale), or
/// `None` for fewer than three pairs or pairs on a line.
pub(super) fn fit(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Pose> {
    if pairs.len() < 3 {
        return None;
    }
    let count = pairs.len() as f64;
    let (mut target, mut source) = (Vector3::zeros(), Vector3::zeros());
    for (t, s) in pairs {
        target += t / count;
        source += s / count;
    }
    let mut covariance = Matrix3::zeros();
    for (t, s) in pairs {
        covariance += (t - target) * (s - source).transpose();
    }
    let svd = covariance.svd(true, true);
    if svd.singular_values[1] < 1e-6 * svd.singular_values[0].max(1e-12) {
        return None;
    }
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut signs = Matrix3::identity();
    signs[(2, 2)] = (u * v_t).determinant().signum();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * signs * v_t));
    Some(Pose::from_parts((target - rotation * source).into(), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_recovers_the_motion_of_points_in_a_plane_and_in_space(
            t in prop::array::uniform3(-9.0..9.0f64),
            r in prop::array::uniform3(-1.7..1.7f64),
            height in prop::sample::select(vec![0.0, 1.0]),
        ) {
            let pose = Pose::new(Vector3::from(t), Vector3::from(r));
            let points = [[0.0, 0.0, 0.0], [3.0, 0.0, height], [0.0, 2.0, 0.0], [-1.0, 4.0, -height]];
            let pairs: Vec<_> = points.map(Vector3::from).map(|p| ((pose * nalgebra::Point3::from(p)).coords, p)).to_vec();
            let found = fit(&pairs).unwrap();
            prop_assert!((found.inverse() * pose).translation.vector.norm() < 1e-6);
            prop_assert!(found.rotation.angle_to(&pose.rotation) < 1e-6);
        }
    }

    #[test]
    fn two_pairs_and_pairs_on_a_line_define_no_motion() {
        let on_a_line: Vec<_> = (0..5).map(|k| Vector3::x() * f64::from(k)).map(|p| (p, p)).collect();
        assert_eq!(fit(&on_a_line), None);
        assert_eq!(fit(&on_a_line[..2]), None);
    }
}
