//! How far a trajectory is from the truth.

use serde::{Deserialize, Serialize};

use crate::geometry::{Pose, rotation_angle};

/// The absolute trajectory error, the first pose of the estimate laid on the first of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryError {
    /// Root mean square of the distances [m].
    pub ate_rmse_m: f64,
    /// Root mean square of the angles [deg].
    pub ate_rmse_deg: f64,
    /// The largest distance [m].
    pub max_m: f64,
    /// The largest angle [deg].
    pub max_deg: f64,
}

/// Compares two trajectories of `map_from_scanner`, pose by pose, after the motion that lays the first estimate on the
/// first truth. `None` when they differ in length or are empty.
#[must_use]
pub fn trajectory_error(estimate: &[Pose], truth: &[Pose]) -> Option<TrajectoryError> {
    if estimate.len() != truth.len() {
        return None;
    }
    let truth_from_estimate = truth.first()? * estimate.first()?.inverse();
    let mut error = TrajectoryError { ate_rmse_m: 0.0, ate_rmse_deg: 0.0, max_m: 0.0, max_deg: 0.0 };
    for (estimate, truth) in estimate.iter().zip(truth) {
        let difference = truth.inverse() * truth_from_estimate * estimate;
        let metres = difference.translation.vector.norm();
        let degrees = rotation_angle(&difference).to_degrees();
        error.ate_rmse_m += metres * metres;
        error.ate_rmse_deg += degrees * degrees;
        error.max_m = error.max_m.max(metres);
        error.max_deg = error.max_deg.max(degrees);
    }
    let count = truth.len() as f64;
    error.ate_rmse_m = (error.ate_rmse_m / count).sqrt();
    error.ate_rmse_deg = (error.ate_rmse_deg / count).sqrt();
    Some(error)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn a_trajectory_moved_as_a_whole_has_no_error() {
        let truth: Vec<Pose> = (0..5)
            .map(|i| Pose::new(Vector3::new(f64::from(i), 1.0, 0.0), Vector3::z() * 0.1 * f64::from(i)))
            .collect();
        let moved = Pose::new(Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.1, 0.2, 0.3));
        let estimate: Vec<Pose> = truth.iter().map(|pose| moved * pose).collect();
        let error = trajectory_error(&estimate, &truth).unwrap();
        assert!(error.max_m < 1e-12 && error.max_deg < 1e-6, "{error:?}");
    }

    #[test]
    fn one_pose_off_by_a_metre_shows_in_rmse_and_maximum() {
        let truth = vec![Pose::identity(); 4];
        let mut estimate = truth.clone();
        estimate[2] = Pose::new(Vector3::y(), Vector3::x() * 0.1);
        let error = trajectory_error(&estimate, &truth).unwrap();
        assert!((error.ate_rmse_m - 0.5).abs() < 1e-12 && (error.max_m - 1.0).abs() < 1e-12);
        assert!((error.max_deg - 0.1_f64.to_degrees()).abs() < 1e-9);
    }

    #[test]
    fn trajectories_of_different_length_cannot_be_compared() {
        assert_eq!(trajectory_error(&[Pose::identity()], &[]), None);
        assert_eq!(trajectory_error(&[], &[]), None);
    }
}
