//! The source's way to close a loop: its error is spread over the scans between in proportion to the distance travelled
//! (section 3, step 4, equations 3.5 to 3.7).

use nalgebra::UnitQuaternion;

use crate::geometry::Pose;

/// The poses after a loop from scan `first` to scan `last` was closed, where `last` turned out to be at
/// `map_from_last`: scan k in between takes the share c_k = d(first..k) / d(first..last) of the error, its translation
/// linearly, its rotation by slerp. Scans up to `first` stay; those behind `last` move along with it.
pub(super) fn distribute(poses: &mut [Pose], first: usize, last: usize, map_from_last: &Pose) {
    let Some(before) = poses.get(last).copied().filter(|_| first < last) else { return };
    let shift = map_from_last.translation.vector - before.translation.vector;
    let turn = map_from_last.rotation * before.rotation.inverse();
    let step = |k: usize, poses: &[Pose]| (poses[k].translation.vector - poses[k - 1].translation.vector).norm();
    let whole: f64 = (first + 1..=last).map(|k| step(k, poses)).sum();
    let mut travelled = 0.0;
    let mut place_before = poses[first].translation.vector;
    for k in first + 1..=last {
        travelled += (poses[k].translation.vector - place_before).norm();
        place_before = poses[k].translation.vector;
        // A loop on the spot has no distance to go by: every scan counts alike.
        let share = if whole > 0.0 { travelled / whole } else { (k - first) as f64 / (last - first) as f64 };
        let none = UnitQuaternion::identity();
        // Half a turn leaves the way open; it is no error that a loop can have.
        let turned = none.try_slerp(&turn, share, 1e-12).unwrap_or(none);
        poses[k].translation.vector += shift * share;
        poses[k].rotation = turned * poses[k].rotation;
        poses[k].rotation.renormalize();
    }
    let moved = poses[last] * before.inverse();
    for pose in &mut poses[last + 1..] {
        *pose = moved * *pose;
        pose.rotation.renormalize();
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geometry::rotation_angle;

    fn chain() -> Vec<Pose> {
        [0.0, 1.0, 3.0, 4.0, 6.0].map(|x| Pose::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * 0.1 * x)).to_vec()
    }

    #[test]
    fn each_scan_takes_the_share_of_its_distance() {
        let (before, mut poses) = (chain(), chain());
        let target = Pose::new(Vector3::new(4.0, 0.4, 0.0), Vector3::z() * 0.8);
        distribute(&mut poses, 0, 3, &target);
        assert!((poses[3].inverse() * target).translation.vector.norm() < 1e-12);
        assert!(rotation_angle(&(poses[3].inverse() * target)) < 1e-12);
        assert_eq!(poses[0], before[0]);
        for (k, share) in [(1, 0.25), (2, 0.75)] {
            let shift = poses[k].translation.vector - before[k].translation.vector;
            assert!((shift - Vector3::y() * 0.4 * share).norm() < 1e-12);
            let turn = poses[k].rotation.angle_to(&before[k].rotation);
            assert!((turn - 0.4 * share).abs() < 1e-9, "{turn}");
        }
        let rigid = |poses: &[Pose]| poses[3].inverse() * poses[4];
        assert!((rigid(&poses).translation.vector - rigid(&before).translation.vector).norm() < 1e-12);
    }

    #[test]
    fn a_loop_that_fits_moves_nothing() {
        let mut poses = chain();
        let at = poses[4];
        distribute(&mut poses, 1, 4, &at);
        for (pose, before) in poses.iter().zip(chain()) {
            assert!((pose.translation.vector - before.translation.vector).norm() < 1e-12);
        }
    }

    #[test]
    fn a_loop_on_the_spot_is_spread_over_its_scans_alike() {
        let mut poses = vec![Pose::identity(); 5];
        distribute(&mut poses, 0, 4, &Pose::translation(0.0, 0.0, 0.8));
        let heights: Vec<f64> = poses.iter().map(|p| p.translation.z).collect();
        assert!(heights.iter().zip([0.0, 0.2, 0.4, 0.6, 0.8]).all(|(a, b)| (a - b).abs() < 1e-12), "{heights:?}");
    }
}
