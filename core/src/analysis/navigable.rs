//! F_l = S H: is this a surface the robot can drive on? (3.14 to 3.16, calibration forms 3 and 4)

use super::config::HeightForm;

/// k of S: ln 99, so that S is 0.99 on level ground.
const STEEPNESS: f32 = 4.595_12;

/// A point nearer to the scanner's axis than this counts as this far [m]; H has a pole there.
const DISTANCE_MIN: f32 = 1e-3;

/// S: 0.5 where the slope is theta, 0.99 on level ground, falling to 0 beyond theta. `normal_z` is the vertical part of
/// the unit normal in the level frame.
#[must_use]
#[inline(always)]
pub fn slope_factor(normal_z: f32, cos_theta: f32) -> f32 {
    let steps = (normal_z - cos_theta) / (1.0 - cos_theta);
    1.0 / (1.0 + exp(-STEEPNESS * steps))
}

/// H: 1 at the height of the ground under the robot, falling with the height difference over what a slope of theta
/// would give at this horizontal distance. Heights and distances in metres.
#[must_use]
#[inline(always)]
pub fn height_factor(form: HeightForm, height_m: f32, distance_m: f32, tan_theta: f32) -> f32 {
    let x = height_m / (distance_m.max(DISTANCE_MIN) * tan_theta);
    exp(match form {
        HeightForm::Calibrated => -x * x,
        HeightForm::Gentle => -0.5 * x * x,
        HeightForm::Literal => -x.abs(),
    })
}

/// e^x within 4e-7 of itself, without jumps or calls, so that several are worked out at a time; between e^-87 and e^87.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = x.clamp(-87.0, 87.0);
    // x = n ln 2 + r with |r| <= ln 2 / 2; adding 1.5 * 2^23 rounds to the nearest whole number.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // ln 2 in two parts, the first of which is exact when multiplied by n.
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let p = 1.0 / 720.0;
    let p = p * r + 1.0 / 120.0;
    let p = p * r + 1.0 / 24.0;
    let p = p * r + 1.0 / 6.0;
    let p = p * r + 0.5;
    let p = p * r + 1.0;
    let p = p * r + 1.0;
    // The low bits of `shifted` are n: they go into the exponent of 2^n.
    p * f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cos(deg: f32) -> f32 {
        deg.to_radians().cos()
    }

    fn tan(deg: f32) -> f32 {
        deg.to_radians().tan()
    }

    proptest! {
        #[test]
        fn the_exponential_is_the_exponential(x in -87.0..80.0f32) {
            let exact = f64::from(x).exp();
            prop_assert!((f64::from(exp(x)) - exact).abs() < 4e-7 * exact, "{x}: {} {exact}", exp(x));
        }

        #[test]
        fn s_is_one_half_at_theta_and_0_99_on_level_ground(theta in 2.0..60.0f32) {
            prop_assert_eq!(slope_factor(cos(theta), cos(theta)), 0.5);
            prop_assert!((slope_factor(1.0, cos(theta)) - 0.99).abs() < 1e-5);
        }

        #[test]
        fn s_falls_with_the_slope_to_nothing(theta in 5.0..60.0f32, a in 0.0..90.0f32, b in 0.0..90.0f32) {
            let (flat, steep) = (a.min(b), a.max(b));
            prop_assert!(slope_factor(cos(flat), cos(theta)) >= slope_factor(cos(steep), cos(theta)));
            prop_assert!(slope_factor(cos((2.2 * theta).min(90.0)), cos(theta)) < 0.02 || theta > 40.0);
        }

        #[test]
        fn h_is_one_at_the_robots_height_at_any_distance(d in 0.0..50.0f32, theta in 2.0..60.0f32) {
            for form in [HeightForm::Calibrated, HeightForm::Gentle, HeightForm::Literal] {
                prop_assert_eq!(height_factor(form, 0.0, d, tan(theta)), 1.0);
            }
        }

        #[test]
        fn h_falls_with_height_and_faster_for_a_small_theta(
            d in 0.5..30.0f32, theta in 5.0..55.0f32, z in 0.01..5.0f32, more in 0.01..5.0f32, sign: bool,
        ) {
            let s = if sign { 1.0 } else { -1.0 };
            for form in [HeightForm::Calibrated, HeightForm::Gentle, HeightForm::Literal] {
                let h = |z: f32, theta: f32| height_factor(form, s * z, d, tan(theta));
                prop_assert!(h(z, theta) >= h(z + more, theta));
                prop_assert!(h(z, theta) <= h(z, theta + 5.0));
                prop_assert!(h(z, theta) < 1.0);
            }
        }

        #[test]
        fn a_slope_of_15_deg_stays_navigable_for_a_theta_of_30_deg(d in 0.3..40.0f32, uphill: bool) {
            let z = d * tan(15.0) * if uphill { 1.0 } else { -1.0 };
            let local = |form| slope_factor(cos(15.0), cos(30.0)) * height_factor(form, z, d, tan(30.0));
            // F = (w_l + w_g) F_l on a plane.
            prop_assert!(0.99 * local(HeightForm::Calibrated) > 0.65);
            prop_assert!(0.99 * local(HeightForm::Literal) < 0.65);
        }
    }

    #[test]
    fn a_small_theta_is_far_more_sensitive_than_a_large_one() {
        let fall = |theta: f32| slope_factor(1.0, cos(theta)) - slope_factor(cos(3.0), cos(theta));
        assert!(fall(5.0) > 0.03 && fall(5.0) > 100.0 * fall(45.0));
    }

    #[test]
    fn straight_slopes_are_allowed_up_to_the_calibrated_share_of_theta() {
        // The table of the calibration: the slope where F = 0.65, by theta and form.
        for (theta, form, limit) in [
            (15.0, HeightForm::Calibrated, 9.2),
            (20.0, HeightForm::Calibrated, 12.4),
            (30.0, HeightForm::Calibrated, 19.0),
            (30.0, HeightForm::Gentle, 23.1),
            (30.0, HeightForm::Literal, 12.9),
        ] {
            let f = |slope: f32| {
                0.99 * slope_factor(cos(slope), cos(theta)) * height_factor(form, 5.0 * tan(slope), 5.0, tan(theta))
            };
            assert!(f(limit - 0.2) > 0.65 && f(limit + 0.2) < 0.65, "{theta} {form:?} {}", f(limit));
        }
    }
}
