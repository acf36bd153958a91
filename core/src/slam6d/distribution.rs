//! The source's correction of a closed loop: spread over its scans in proportion to the distance travelled (3.5 to 3.7).
//!
//! It needs neither covariances nor other edges and costs next to nothing, but knows one loop only; the pose graph is
//! the default.

use nalgebra::UnitQuaternion;

use crate::geometry::Pose;

/// Moves the poses of a loop, `map_from_scanner` from the first scan to the one that closed it, so that the last becomes
/// `corrected_last`. Scan k takes the share c_k = d(i..k) / d(i..n) of the correction: its translation is moved by c_k
/// of the last one's motion, its rotation turned by c_k of the last one's rotation about the same axis (slerp). Where the
/// scanner never moved, the shares grow evenly from scan to scan.
pub fn distribute(loop_poses: &mut [Pose], corrected_last: &Pose) {
    let Some(last) = loop_poses.last().copied() else { return };
    let shares = shares(loop_poses);
    let shift = corrected_last.translation.vector - last.translation.vector;
    let turn = (corrected_last.rotation * last.rotation.inverse()).scaled_axis();
    for (pose, share) in loop_poses.iter_mut().zip(shares) {
        // The first is not to change at all, not even by rounding.
        if share > 0.0 {
            pose.translation.vector += shift * share;
            pose.rotation = UnitQuaternion::from_scaled_axis(turn * share) * pose.rotation;
            pose.rotation.renormalize();
        }
    }
    if let [_, .., last] = loop_poses {
        *last = *corrected_last;
    }
}

/// c_k, the share of the distance travelled up to each scan: 0 for the first, 1 for the last (3.5).
#[must_use]
pub fn shares(loop_poses: &[Pose]) -> Vec<f64> {
    let position = |pose: &Pose| pose.translation.vector;
    let mut travelled = 0.0;
    let mut shares: Vec<f64> = Vec::with_capacity(loop_poses.len());
    for (k, pose) in loop_poses.iter().enumerate() {
        travelled += k.checked_sub(1).map_or(0.0, |before| (position(pose) - position(&loop_poses[before])).norm());
        shares.push(travelled);
    }
    let steps = loop_poses.len().saturating_sub(1);
    if travelled > 0.0 && travelled.is_finite() {
        shares.iter_mut().for_each(|share| *share /= travelled);
    } else {
        shares.iter_mut().enumerate().for_each(|(k, share)| *share = k as f64 / steps.max(1) as f64);
    }
    shares
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::{Twist, exp, rotation_angle};

    prop_compose! {
        fn any_loop()(steps in prop::collection::vec((prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-0.5..0.5f64)), 1..12)) -> Vec<Pose> {
            let mut pose = Pose::translation(5.0, -2.0, 1.0);
            let mut poses = vec![pose];
            for (t, r) in steps {
                pose *= exp(&Twist::new(t[0], t[1], t[2], r[0], r[1], r[2]));
                poses.push(pose);
            }
            poses
        }
    }

    proptest! {
        #[test]
        fn the_first_stays_the_last_is_exact_and_the_others_move_the_more_the_later(
            poses in any_loop(), t in prop::array::uniform3(-2.0..2.0f64), r in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let corrected_last = exp(&Twist::new(t[0], t[1], t[2], r[0], r[1], r[2])) * poses[poses.len() - 1];
            let mut moved = poses.clone();
            distribute(&mut moved, &corrected_last);
            prop_assert_eq!(moved[0], poses[0]);
            prop_assert_eq!(moved[poses.len() - 1], corrected_last);
            let by = |k: usize| {
                let shift = (moved[k].translation.vector - poses[k].translation.vector).norm();
                (shift, rotation_angle(&(moved[k] * poses[k].inverse())))
            };
            let (whole_shift, whole_turn) = by(poses.len() - 1);
            for (k, share) in shares(&poses).into_iter().enumerate() {
                let (shift, turn) = by(k);
                prop_assert!((shift - share * whole_shift).abs() < 1e-9 && (turn - share * whole_turn).abs() < 1e-9);
                if k > 0 {
                    let (before, turn_before) = by(k - 1);
                    prop_assert!(shift >= before - 1e-12 && turn >= turn_before - 1e-9);
                }
            }
        }

        #[test]
        fn a_loop_that_closes_already_stays(poses in any_loop()) {
            let mut moved = poses.clone();
            distribute(&mut moved, &poses[poses.len() - 1]);
            for (a, b) in moved.iter().zip(&poses) {
                prop_assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-12);
            }
        }
    }

    #[test]
    fn the_shares_follow_the_distance_and_where_there_is_none_the_count() {
        let at = |x: f64| Pose::translation(x, 0.0, 0.0);
        assert_eq!(shares(&[at(0.0), at(1.0), at(1.0), at(4.0)]), [0.0, 0.25, 0.25, 1.0]);
        assert_eq!(shares(&[at(2.0), at(2.0), at(2.0)]), [0.0, 0.5, 1.0]);
        assert_eq!(shares(&[at(2.0)]), [0.0]);
        let mut single = [at(2.0)];
        distribute(&mut single, &at(3.0));
        assert_eq!(single, [at(2.0)], "the first stays, even if it is the last");
        distribute(&mut [], &at(3.0));
    }
}
