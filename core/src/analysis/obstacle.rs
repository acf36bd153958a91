//! B_l: would the robot run into this? (3.19, calibration form 6)

use super::config::ObstacleForm;

/// Below this |v.n| a surface is seen too edge-on for its normal to be trusted, and its score falls.
const INCIDENCE_FULL: f32 = 0.1;

/// How far below the wedge of climbable slopes a point may lie and still be in reach [m].
const REACH_MARGIN: f32 = 0.05;

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
        ObstacleForm::Calibrated => horizontal * (incidence / INCIDENCE_FULL).min(1.0),
        ObstacleForm::Literal => horizontal * height_factor * incidence,
    }
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
