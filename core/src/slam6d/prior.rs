//! What is known of a scan's pose before its alignment, and how it is weighed with what registration finds.

use crate::geometry::{Covariance, Pose, Twist, exp, log};
use crate::registration::Alignment;

/// Where a scan was taken, before its alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// `map_from_scanner`.
    pub map_from_scanner: Pose,
    /// Its frame.
    pub frame: PriorFrame,
    /// How well it is known since the last aligned scan, perturbation on the right, in the scanner's frame; `None` when nobody
    /// says.
    pub covariance: Option<Covariance>,
}

/// What the pose of a prior refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorFrame {
    /// Any fixed frame, as of an odometer: only the motion between two priors counts.
    Odometry,
    /// The map: who gives it hears where scans were aligned and moves along, so a motion between two priors would contain
    /// what was corrected at the first.
    Map,
}

impl From<Pose> for Prior {
    fn from(map_from_scanner: Pose) -> Self {
        Self { map_from_scanner, frame: PriorFrame::Odometry, covariance: None }
    }
}

/// Weighs the pose that registration found with the one expected by the prior, each by its covariance: the linear estimate of
/// least variance (Barfoot, State Estimation for Robotics, 2017, section 7.3.2, one step). Where the geometry holds the
/// pose this changes next to nothing; a direction that it leaves open, along which registration may end anywhere, is held
/// by the prior. A pose farther than `gate` standard deviations from the expected one is left as it is: then one of the two
/// is wrong about itself.
///
/// # Errors
/// How far the pose found lies from the expected one, in standard deviations, when that is beyond the gate.
pub(super) fn weigh(alignment: &mut Alignment, expected: &Pose, prior: &Covariance, gate: f64) -> Result<(), f64> {
    let error = log(&(expected.inverse() * alignment.target_from_source));
    let found = alignment.covariance;
    let Some(sum) = (prior + found).cholesky() else { return Ok(()) };
    let distance = error.dot(&sum.solve(&error)).max(0.0).sqrt();
    if !distance.is_finite() {
        return Ok(());
    }
    if distance > gate {
        return Err(distance);
    }
    let mut pose = alignment.target_from_source * exp(&(-(found * sum.solve(&error))));
    pose.rotation.renormalize();
    alignment.target_from_source = pose;
    let covariance = found - found * sum.solve(&found);
    alignment.covariance = (covariance + covariance.transpose()) * 0.5;
    Ok(())
}

/// What counts as a weak direction, and what as far along it.
struct Weak {
    /// The pairs constrain it by less than this (see [`crate::registration::Constraint`]).
    eigenvalue: f64,
    /// So far from the prior [its standard deviations] the pose is not believed along it,
    sigmas: f64,
    /// and nearer it is known no better than this [m, and m at the distance of the points for rotations].
    sigma_m: f64,
}

/// A direction that only the noise of the normals seems to hold.
const WEAK: Weak = Weak { eigenvalue: 0.004, sigmas: 3.0, sigma_m: 0.0 };
/// The same for an alignment of many steps of scans that share little: so registration slides along a street or a yard where
/// what they share beside the ground are a few pairs by chance. Of some 700 alignments in six explorations 24 ended more than
/// 0.03 m off. Of these three were of scans during which the robot moved, one was 0.032 m off, and all others had taken 20 steps
/// or more and shared less than 0.6, as only 8 of the good ones had: half of those took at most 5 steps, 95 in 100 at most 11. One
/// that came later shared 0.65, had taken 33 steps, and was 0.3 degrees off.
const WEAK_IF_SLOW: Weak = Weak { eigenvalue: 0.03, sigmas: 2.0, sigma_m: 0.3 };
pub(super) const SLOW: u32 = 20;
const SLOW_BELOW_OVERLAP: f64 = 0.7;
/// Where such an alignment has slid along one direction, nothing that it says of directions weaker than this is believed: it has
/// slid along a curve.
const HELD_BELOW: f64 = 0.1;
/// What is taken back is known no better than this by registration [m].
const HELD_SIGMA_M: f64 = 2.0;

/// What is to be thought of an alignment along the directions that the scans hold but weakly.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Slide {
    /// By how much [m] it had slid and was taken back, the distance of the points counting for rotations; 0 where nothing was.
    pub slid_m: f64,
    /// It came slowly along such a direction, and not far.
    pub is_unsure: bool,
}

/// Takes the pose back to the expected one along directions that the scans hold but weakly, where registration has left it by
/// more than the prior makes likely: along a wall it slides far for little. What it found in all other directions stays.
pub(super) fn hold_weak_directions(alignment: &mut Alignment, expected: &Pose, prior: &Covariance) -> Slide {
    let is_slow = is_slow(alignment);
    let weak = if is_slow { WEAK_IF_SLOW } else { WEAK };
    let scale = Covariance::from_diagonal(&alignment.constraint.scale());
    let Some(back) = scale.try_inverse() else { return Slide::default() };
    let spread = scale * prior * scale;
    let mut error = scale * log(&(expected.inverse() * alignment.target_from_source));
    let found = error;
    let is_far = |direction: &Twist| {
        let along = direction.dot(&found);
        along.powi(2) > weak.sigmas.powi(2) * direction.dot(&(spread * direction))
    };
    let weakest = weaker_than(alignment, weak.eigenvalue);
    let slides = weakest.iter().any(is_far);
    if !slides {
        add_unknown(alignment, &weakest, weak.sigma_m);
        return Slide { slid_m: 0.0, is_unsure: is_slow && !weakest.is_empty() };
    }
    let held = match is_slow {
        true => weaker_than(alignment, HELD_BELOW),
        false => weakest.into_iter().filter(is_far).collect(),
    };
    let mut slid_sq = 0.0;
    for direction in &held {
        let along = direction.dot(&found);
        error -= along * direction;
        slid_sq += along.powi(2);
    }
    add_unknown(alignment, &held, HELD_SIGMA_M);
    alignment.target_from_source = expected * exp(&(back * error));
    alignment.target_from_source.rotation.renormalize();
    Slide { slid_m: slid_sq.sqrt(), is_unsure: false }
}

/// Whether an alignment came in many steps, of scans that share little.
fn is_slow(alignment: &Alignment) -> bool {
    alignment.iterations >= SLOW && alignment.overlap < SLOW_BELOW_OVERLAP
}

/// Whether an alignment came in many steps along a direction that the scans hardly hold, so that it may be wrong along it.
pub(super) fn is_unsure(alignment: &Alignment) -> bool {
    is_slow(alignment) && !weaker_than(alignment, WEAK_IF_SLOW.eigenvalue).is_empty()
}

/// Lets an alignment be no surer along directions that the scans hardly hold than one that came slowly is.
pub(super) fn doubt_weak_directions(alignment: &mut Alignment) {
    let weak = weaker_than(alignment, WEAK_IF_SLOW.eigenvalue);
    add_unknown(alignment, &weak, WEAK_IF_SLOW.sigma_m);
}

/// The directions that the pairs hold, but by less than this; rotations times the distance of the points.
fn weaker_than(alignment: &Alignment, eigenvalue: f64) -> Vec<Twist> {
    let constraint = &alignment.constraint;
    let weaker = (0..6).filter(|&k| constraint.is_constrained(k) && constraint.eigenvalues[k] < eigenvalue);
    weaker.map(|k| constraint.directions.column(k).into_owned()).collect()
}

/// So much [m] more is unknown along each of the directions.
fn add_unknown(alignment: &mut Alignment, directions: &[Twist], sigma_m: f64) {
    let scale = Covariance::from_diagonal(&alignment.constraint.scale());
    let Some(back) = scale.try_inverse() else { return };
    let spread = |direction: &Twist| sigma_m.powi(2) * direction * direction.transpose();
    let unknown = directions.iter().map(spread).fold(Covariance::zeros(), |sum, one| sum + one);
    alignment.covariance += back * unknown * back;
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector3, Vector6};

    use super::*;
    use crate::registration::Constraint;

    fn alignment(pose: Pose, sigmas: [f64; 6]) -> Alignment {
        Alignment {
            target_from_source: pose,
            covariance: Covariance::from_diagonal(&Vector6::from(sigmas.map(|s| s * s))),
            overlap: 0.5,
            overlap_distance_m: 0.3,
            residual_rms_m: 0.01,
            cost: 0.001,
            iterations: 9,
            converged: true,
            limit_reached: false,
            constraint: Constraint::none(0.01),
        }
    }

    fn prior() -> Covariance {
        Covariance::from_diagonal(&Vector6::from([0.1, 0.1, 0.1, 0.01, 0.01, 0.01].map(|s: f64| s * s)))
    }

    #[test]
    fn an_open_direction_is_held_by_the_prior_and_the_others_by_the_geometry() {
        let expected = Pose::new(Vector3::new(3.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 0.4));
        let off = Pose::new(Vector3::new(0.9, 0.12, 0.0), Vector3::zeros());
        let mut found = alignment(expected * off, [2.0, 0.004, 0.004, 0.001, 0.001, 0.001]);
        weigh(&mut found, &expected, &prior(), 5.0).unwrap();
        let left = (expected.inverse() * found.target_from_source).translation.vector;
        assert!(left.x.abs() < 0.005 && (left.y - 0.12).abs() < 0.001, "{left}");
        assert!(found.covariance[(0, 0)].sqrt() < 0.1 && found.covariance[(1, 1)].sqrt() < 0.004);
        assert!(found.covariance.cholesky().is_some());
    }

    #[test]
    fn along_a_weak_direction_a_pose_far_from_the_prior_is_taken_back_and_one_near_it_stays() {
        let expected = Pose::new(Vector3::new(3.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 0.4));
        let found = |along: f64, eigenvalue: f64, iterations: u32, overlap: f64| {
            let off = Pose::new(Vector3::new(along, 0.02, 0.0), Vector3::new(0.0, 0.0, 0.003));
            let constraint = Constraint {
                eigenvalues: [eigenvalue, 0.1, 0.1, 0.2, 0.3, 0.4],
                length_m: 8.0,
                ..Constraint::none(0.001)
            };
            let mut found = Alignment { constraint, iterations, overlap, ..alignment(expected * off, [0.02; 6]) };
            let slid = hold_weak_directions(&mut found, &expected, &prior()).slid_m;
            (log(&(expected.inverse() * found.target_from_source)), found.covariance[(0, 0)].sqrt(), slid)
        };
        for (along, eigenvalue, iterations) in [(0.46, 0.002, 9), (0.46, 0.002, 40), (0.25, 0.025, 26)] {
            let (back, sigma, slid) = found(along, eigenvalue, iterations, 0.5);
            assert!(
                back[0].abs() < 0.002 && (back[1] - 0.02).abs() < 0.002 && (back[5] - 0.003).abs() < 1e-6,
                "{back}"
            );
            assert!(sigma > 1.0 && (slid - along).abs() < 1e-3, "{slid}");
        }
        // Near, well held, open (which is the prior's anyway), or scans that share much.
        let few = [(0.2, 0.002, 9, 0.5), (0.46, 0.01, 9, 0.5), (0.46, 0.0005, 9, 0.5)];
        let many = [(0.46, 0.04, 40, 0.5), (0.46, 0.01, 40, 0.7)];
        for (along, eigenvalue, iterations, overlap) in few.into_iter().chain(many) {
            let (kept, sigma, slid) = found(along, eigenvalue, iterations, overlap);
            assert!((kept[0] - along).abs() < 1e-3 && sigma < 0.03 && slid == 0.0, "{along} {eigenvalue}: {kept}");
        }
        // Of what came slowly but not far it is not sure.
        let (kept, sigma, slid) = found(0.19, 0.025, 26, 0.5);
        assert!((kept[0] - 0.19).abs() < 1e-3 && (sigma - 0.3).abs() < 0.01 && slid == 0.0, "{kept} {sigma}");
    }

    #[test]
    fn a_pose_that_contradicts_the_prior_is_left_as_it_was_found() {
        let mut found = alignment(Pose::translation(0.9, 0.0, 0.0), [0.004; 6]);
        let before = found.clone();
        let sigmas = weigh(&mut found, &Pose::identity(), &prior(), 5.0).unwrap_err();
        assert!((sigmas - 9.0).abs() < 0.1, "{sigmas}");
        assert_eq!(found, before);
    }
}
