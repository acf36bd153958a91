//! Registration with the prior as one more measurement at every step, for scans that registration alone slides along what they
//! hardly hold: the maximum a posteriori estimate (Barfoot, State Estimation for Robotics, 2017, section 4.3) by Gauss-Newton
//! steps, each weighed with the prior before pairs are sought again. It begins at the prior and stays near it, so that pairs are
//! the right ones, and what the scans hold well (the heading along walls) comes from them.

use super::attempt::Attempt;
use super::prior::{doubt_weak_directions, weigh};
use super::sequential::SequentialAligner;
use crate::geometry::rotation_angle;
use crate::registration::{Alignment, Limits, PreparedScan};

/// Most steps.
const MOST_STEPS: u32 = 40;
/// Pairs may at first be as far apart as in any registration, and after every step by this factor less, down to this [m].
const CLOSER: f64 = 0.8;
const LEAST_PAIR_DISTANCE_M: f64 = 0.5;
/// It has converged when a step moves it by less [m, rad].
const STILL_M: f64 = 1e-3;
const STILL: f64 = 1e-4;

impl SequentialAligner {
    /// Registers from where the prior has the scan. `None` without a prior that says how sure it is, when a step fails, or when
    /// the result is not accepted.
    pub(super) fn register_with_prior(
        &mut self,
        attempt: &Attempt<'_>,
        source: &dyn PreparedScan,
    ) -> Option<Alignment> {
        let covariance = self.prior?.covariance?;
        let expected = attempt.target.map_from_scanner.inverse() * self.guess_by_prior()?;
        let mut limits = Limits { max_iterations: 1, ..self.config.limits };
        let mut pose = expected;
        for step in 1..=MOST_STEPS {
            let mut found = self.registration.align(attempt.scan, source, &pose, &limits).ok()?;
            doubt_weak_directions(&mut found);
            weigh(&mut found, &expected, &covariance, f64::INFINITY).ok()?;
            let moved = pose.inverse() * found.target_from_source;
            pose = found.target_from_source;
            let is_still = moved.translation.vector.norm() < STILL_M && rotation_angle(&moved) < STILL;
            if limits.pair_distance_m <= LEAST_PAIR_DISTANCE_M && is_still {
                (found.iterations, found.converged) = (step, true);
                let has_prior = true;
                let judged = self.config.acceptance.judge(&found, &expected, &self.config.limits, has_prior);
                return judged.is_ok().then_some(found);
            }
            limits.pair_distance_m = (CLOSER * limits.pair_distance_m).max(LEAST_PAIR_DISTANCE_M);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geometry::{Covariance, Pose};
    use crate::registration::test_scenes::{CORRIDOR, Rectangle, scan_of};
    use crate::registration::{RegistrationConfig, Registry};
    use crate::scan::ScanView;
    use crate::slam6d::{HypothesisName, Prior, PriorFrame, SequentialConfig};

    /// The corridor with boards across it, seen from a pose.
    fn corridor_with_boards(boards_m: &[f64], pose: &Pose, seed: u64) -> Vec<crate::scan::Point> {
        let board = |x: &f64| -> Rectangle { ([*x, -2.0, -1.0], [0.0, 1.2, 0.0], [0.0, 0.0, 2.0]) };
        let scene: Vec<Rectangle> = CORRIDOR.into_iter().chain(boards_m.iter().map(board)).collect();
        scan_of(&scene, pose, 40.0, seed)
    }

    #[test]
    fn along_a_direction_that_few_pairs_hold_the_prior_decides_and_in_all_others_the_scans() {
        let truth = Pose::new(Vector3::new(0.6, 0.05, 0.0), Vector3::z() * 0.02);
        // What is paired along the corridor is not the same thing: boards that the first scan has seen 0.4 m farther back.
        let first = corridor_with_boards(&[2.0, 4.0, 6.0, -3.0, -5.0], &Pose::identity(), 1);
        let second = corridor_with_boards(&[2.4, 4.4, 6.4, -2.6, -4.6], &truth, 2);
        let config = RegistrationConfig { constrained_eigenvalue: 0.001, ..RegistrationConfig::default() };
        let method = Registry::default().create("point_to_plane", &config).unwrap();
        let mut aligner = SequentialAligner::new(method, SequentialConfig::default(), 0.25).unwrap();
        aligner.align_next(0, ScanView::unordered(&first), Some(Pose::identity()));

        let prior = Pose::new(Vector3::new(0.65, 0.18, 0.03), Vector3::z() * 0.035);
        let variances = [0.1, 0.1, 0.1, 0.01, 0.01, 0.01].map(|sigma: f64| sigma * sigma);
        let covariance = Some(Covariance::from_diagonal(&variances.into()));
        aligner.prior = Some(Prior { map_from_scanner: prior, frame: PriorFrame::Map, covariance });
        let target = aligner.state().target.unwrap();
        let scan = aligner.keyframe().unwrap().clone();
        let source = aligner.registration_mut().prepare(ScanView::unordered(&second)).unwrap();
        let limits = aligner.config().limits;
        let alone = aligner.registration_mut().align(&*scan, &*source, &prior, &limits).unwrap();
        let name = HypothesisName::PriorMotion;
        let pair_distance_m = limits.pair_distance_m;
        let attempt = Attempt { name, target: &target, scan: &*scan, start: prior, pair_distance_m };
        let found = aligner.register_with_prior(&attempt, &*source).unwrap();

        let off = |pose: &Pose| truth.inverse() * pose;
        let (slid, held) = (off(&alone.target_from_source).translation.x, off(&found.target_from_source));
        assert!(slid.abs() > 0.3, "registration alone follows the boards: {slid} {:?}", alone.constraint.eigenvalues);
        assert!(held.translation.x.abs() < 0.1 && held.translation.y.abs() < 0.01, "{held}");
        assert!(rotation_angle(&held) < 0.002, "{held}");
        let along = found.covariance[(0, 0)].sqrt();
        assert!((0.05..0.12).contains(&along) && found.covariance[(1, 1)].sqrt() < 0.02, "{along}");
    }
}
