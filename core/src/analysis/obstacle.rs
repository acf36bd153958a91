//! B_l: would the robot run into this? (3.19, calibration form 6)

use super::config::ObstacleForm;

/// Below this |v.n| a surface is seen too edge-on for its normal to be trusted, and its score falls.
const INCIDENCE_FULL: f32 = 0.1;

/// How far below the wedge of climbable slopes a point may lie and still be in reach [m].
const REACH_MARGIN: f32 = 0.05;

/// Rises of the mesh below this say nothing, as noise and grass make them, too; from the other on they count in full [m].
const RISE_NONE: f32 = 0.03;
const RISE_FULL: f32 = 0.06;

/// Whether a point `height_m` over the ground under the robot, at this horizontal distance, lies in the wedge the robot
/// can reach: not below the steepest way down, and below the steepest way up or below the robot's own height. Metres.
#[must_use]
#[inline(always)]
pub fn within_reach(height_m: f32, distance_m: f32, tan_theta: f32, robot_height_m: f32) -> bool {
    let climb = distance_m * tan_theta + REACH_MARGIN;
    (height_m >= -climb) & (height_m <= climb.max(robot_height_m))
}

/// B_l of a point within reach and below the robot's height. `horizontal` is |N_xy|, the horizontal part of the unit
/// normal in the level frame, `incidence` is |v.n|; `height_factor` is H, which only the literal form asks for.
#[must_use]
#[inline(always)]
pub fn obstacle_score(form: ObstacleForm, horizontal: f32, incidence: f32, height_factor: f32) -> f32 {
    match form {
        ObstacleForm::Stepped | ObstacleForm::Calibrated => horizontal * (incidence / INCIDENCE_FULL).min(1.0),
        ObstacleForm::Literal => horizontal * height_factor * incidence,
    }
}

/// What a leg of the mesh, from a point to its neighbour in the level frame [m], says of the surface it lies on: the share
/// of its rise in its length, from a rise of 3 cm on and in full from 6 cm. The normal of a surface is perpendicular to
/// all its legs, so |N_xy| is no less than this share: it is the least that B_l can be.
#[must_use]
#[inline(always)]
pub fn step_score(leg: [f32; 3]) -> f32 {
    let [x, y, z] = leg;
    let rise = z.abs();
    let trust = ((rise - RISE_NONE) * (1.0 / (RISE_FULL - RISE_NONE))).clamp(0.0, 1.0);
    trust * rise / (x * x + y * y + z * z).max(1e-12).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_wall_is_an_obstacle_at_every_incidence_up_to_84_deg(incidence_deg in 0.0..84.0f32) {
            let incidence = incidence_deg.to_radians().cos();
            prop_assert!(obstacle_score(ObstacleForm::Calibrated, 1.0, incidence, 1.0) > 0.99);
        }

        #[test]
        fn flat_ground_is_none_however_it_is_seen(incidence in 0.0..1.0f32) {
            for form in [ObstacleForm::Calibrated, ObstacleForm::Literal] {
                prop_assert!(obstacle_score(form, 0.01, incidence, 1.0) <= 0.01);
            }
        }

        #[test]
        fn the_wedge_opens_with_distance(h in -5.0..5.0f32, d in 0.0..20.0f32, more in 0.0..20.0f32) {
            let reach = |d: f32| within_reach(h, d, 0.36, 1.0);
            prop_assert!(!reach(d) || reach(d + more));
        }
    }

    proptest! {
        #[test]
        fn a_step_says_no_more_than_the_steepness_of_any_surface_it_lies_on(
            leg in prop::array::uniform3(-1.0..1.0f32), other in prop::array::uniform3(-1.0..1.0f32),
        ) {
            let normal = nalgebra::Vector3::from(leg).cross(&nalgebra::Vector3::from(other));
            prop_assume!(normal.norm() > 1e-2);
            let normal = normal.normalize();
            let score = step_score(leg);
            prop_assert!((0.0..=1.0).contains(&score) && score <= normal.x.hypot(normal.y) + 1e-3);
        }

        #[test]
        fn a_step_that_rises_more_over_the_same_ground_says_more(
            x in 0.0..1.0f32, y in 0.0..1.0f32, z in 0.0..1.0f32, more in 0.0..1.0f32, up: bool,
        ) {
            let score = |z: f32| step_score([x, y, if up { z } else { -z }]);
            prop_assert!(score(z + more) >= score(z) - 1e-6);
        }
    }

    #[test]
    fn noise_is_no_step_and_neither_is_a_slope() {
        assert_eq!(step_score([0.0, 0.0, 0.025]), 0.0);
        assert_eq!(step_score([0.0; 3]), 0.0);
        assert!(step_score([0.0, 0.0, 0.07]) > 0.999);
        // 45 deg: below u_B.
        assert!(step_score([0.2, 0.0, 0.2]) < 0.71);
    }

    #[test]
    fn the_literal_form_misses_a_wall_seen_at_45_deg() {
        assert!(obstacle_score(ObstacleForm::Literal, 1.0, 0.7, 1.0) < 0.83);
    }

    #[test]
    fn a_point_beside_the_robot_is_in_reach_and_one_in_a_hole_or_over_its_head_is_not() {
        assert!(within_reach(0.9, 0.5, 0.36, 1.0));
        assert!(!within_reach(1.1, 0.5, 0.36, 1.0));
        assert!(!within_reach(-0.5, 1.0, 0.36, 1.0));
        assert!(within_reach(-0.5, 2.0, 0.36, 1.0));
        assert!(within_reach(2.0, 10.0, 0.36, 1.0));
    }
}
