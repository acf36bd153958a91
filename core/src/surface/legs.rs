//! Which legs of the grid follow a surface (3.1 and calibration, form 2).
//!
//! A leg joins the points of two adjacent rays. In the triangle scanner-near-far the law of sines gives
//! gamma = L / (r_near dstep) = 1 / sin(angle of incidence at the far point): 1 on a facing wall, large where the ray
//! grazes the surface or where the leg spans two surfaces. It does not change with scale.

use super::config::SurfaceConfig;

/// A filtered point: x, y, z [m] and 1/range [1/m]; all zero where there is no return.
pub(super) type Sample = [f32; 4];

/// Both ends of the leg have returns and are neighbours in direction.
pub(super) const THERE: u8 = 1;
/// The leg follows a surface.
pub(super) const HONEST: u8 = 1 << 1;
/// [`LegTest::presort`] leaves this leg to [`LegTest::judge`].
pub(super) const UNDECIDED: u8 = 1 << 7;

/// Two rays nearer than this are one ray seen twice, or meet in the pole of the scan: no leg [rad].
const STEP_MIN: f32 = 1e-5;

/// What a leg is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Leg {
    /// A return is missing, or the rays are not neighbours.
    Absent,
    /// It spans two surfaces.
    Jump,
    /// It follows a surface.
    Honest,
}

impl Leg {
    /// The two bits of a leg, [`THERE`] and [`HONEST`].
    pub(super) fn bits(self) -> u8 {
        match self {
            Self::Absent => 0,
            Self::Jump => THERE,
            Self::Honest => THERE | HONEST,
        }
    }
}

/// The leg test's limits in single precision, squared where the test is on squares.
#[derive(Debug, Clone, Copy)]
pub(super) struct LegTest {
    gamma2: f32,
    grazing2: f32,
    slope_ratio: f32,
    ground2: f32,
    chord2_max: f32,
}

/// The step between two rays.
struct Step {
    /// Difference of the unit directions.
    chord: [f32; 3],
    /// Its square.
    chord2: f32,
    /// The angle squared [rad^2].
    angle2: f32,
}

impl LegTest {
    pub(super) fn new(config: &SurfaceConfig) -> Self {
        let square = |v: f64| (v * v) as f32;
        Self {
            gamma2: square(config.gamma_max),
            grazing2: square(config.gamma_grazing_max),
            slope_ratio: config.slope_ratio_max as f32,
            ground2: square(config.ground_gamma_factor),
            chord2_max: square(2.0 * (0.5 * config.step_max_deg.to_radians()).sin()),
        }
    }

    /// The bits of the leg between two inverse ranges whose directions differ by a chord of this square (zero where one is
    /// missing); all but the few legs for which the neighbours decide. Without jumps, for many legs at a time.
    #[inline(always)]
    pub(super) fn presort(&self, a: f32, b: f32, chord2: f32) -> u8 {
        // The product of near and far is that of both.
        let (far, rise) = (if a < b { a } else { b }, b - a);
        let is_there = (far > 0.0) & (chord2 >= STEP_MIN * STEP_MIN) & (chord2 <= self.chord2_max);
        let length2 = rise * rise + a * b * chord2;
        let unit2 = far * far * (chord2 * (1.0 + chord2 * (1.0 / 12.0)));
        let is_honest = is_there & (length2 <= self.gamma2 * unit2);
        let is_undecided = is_there & !is_honest & (length2 <= self.grazing2 * unit2);
        u8::from(is_there) | u8::from(is_honest) << 1 | u8::from(is_undecided) << 7
    }

    /// Judges the leg from `a` to `b`; `beyond` gives the points that continue the grid line before a and after b (zero
    /// where there is none). Only few legs need them.
    #[inline]
    pub(super) fn judge(&self, a: &Sample, b: &Sample, beyond: impl FnOnce() -> [Sample; 2]) -> Leg {
        let Some(step) = self.step(a, b) else { return Leg::Absent };
        let (near, far) = (a[3].max(b[3]), a[3].min(b[3]));
        let rise = b[3] - a[3];
        // L^2 = (r_a - r_b)^2 + r_a r_b chord^2, multiplied by (q_near q_far)^2 / q_near^2: no division is left.
        let length2 = rise * rise + near * far * step.chord2;
        let unit2 = far * far * step.angle2;
        if length2 <= self.gamma2 * unit2 {
            return Leg::Honest;
        }
        if length2 > self.grazing2 * unit2 {
            return Leg::Jump;
        }
        let slope = rise / step.angle2.sqrt();
        let [before, after] = beyond();
        let goes_on = self.continues(slope, &before, a) || self.continues(slope, b, &after);
        if goes_on || self.is_ground(&step, a, b, length2 / unit2) { Leg::Honest } else { Leg::Jump }
    }

    /// The step between two rays, if both have returns and they are neighbours.
    fn step(&self, a: &Sample, b: &Sample) -> Option<Step> {
        if a[3] <= 0.0 || b[3] <= 0.0 {
            return None;
        }
        let chord: [f32; 3] = std::array::from_fn(|i| b[i] * b[3] - a[i] * a[3]);
        let chord2 = chord[0] * chord[0] + chord[1] * chord[1] + chord[2] * chord[2];
        if chord2 < STEP_MIN * STEP_MIN || chord2 > self.chord2_max {
            return None;
        }
        // angle = 2 asin(chord / 2), to third order.
        Some(Step { chord, chord2, angle2: chord2 * (1.0 + chord2 * (1.0 / 12.0)) })
    }

    /// Whether 1/range changes per radian as on the adjacent leg, in sign and within the ratio.
    fn continues(&self, slope: f32, a: &Sample, b: &Sample) -> bool {
        self.step(a, b).is_some_and(|step| {
            let adjacent = (b[3] - a[3]) / step.angle2.sqrt();
            slope * adjacent > 0.0 && slope.abs() <= self.slope_ratio * adjacent.abs()
        })
    }

    /// Whether this is a leg in elevation under the horizon, no longer than level ground explains.
    fn is_ground(&self, step: &Step, a: &Sample, b: &Sample, gamma2: f32) -> bool {
        let (sin_a, sin_b) = (a[2] * a[3], b[2] * b[3]);
        if sin_a >= 0.0 || sin_b >= 0.0 {
            return false;
        }
        let sin = 0.5 * (sin_a + sin_b);
        let in_elevation = step.chord[2] * step.chord[2] > 0.5 * step.chord2 * (1.0 - sin * sin);
        let sin_far = if a[3] < b[3] { sin_a } else { sin_b };
        in_elevation && gamma2 * sin_far * sin_far <= self.ground2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NONE: Sample = [0.0; 4];

    fn sample(az: f32, el: f32, range: f32) -> Sample {
        let u = [el.cos() * az.cos(), el.cos() * az.sin(), el.sin()];
        [u[0] * range, u[1] * range, u[2] * range, 1.0 / range]
    }

    fn test() -> LegTest {
        LegTest::new(&SurfaceConfig::default())
    }

    proptest! {
        #[test]
        fn the_judgement_does_not_change_with_scale(
            ranges in prop::array::uniform4(0.5..30.0f32), el in -1.2..1.2f32, exponent in -3..4i32, along_el: bool,
        ) {
            let at = |k: usize, s: f32| {
                let d = 0.01 * k as f32;
                if along_el { sample(0.3, el + d, ranges[k] * s) } else { sample(0.3 + d, el, ranges[k] * s) }
            };
            let judged = |s: f32| test().judge(&at(1, s), &at(2, s), || [at(0, s), at(3, s)]);
            // Powers of two change no mantissa.
            prop_assert_eq!(judged(1.0), judged(2f32.powi(exponent)));
        }

        #[test]
        fn the_judgement_does_not_depend_on_the_order_along_the_line(ranges in prop::array::uniform4(0.5..30.0f32), el in -1.2..1.2f32) {
            let p: Vec<_> = ranges.iter().enumerate().map(|(k, r)| sample(0.0, el + 0.01 * k as f32, *r)).collect();
            let (there, back) = (test().judge(&p[1], &p[2], || [p[0], p[3]]), test().judge(&p[2], &p[1], || [p[3], p[0]]));
            prop_assert_eq!(there, back);
        }
    }

    #[test]
    fn a_facing_wall_is_honest_and_a_depth_jump_is_not() {
        assert_eq!(test().judge(&sample(0.0, 0.0, 5.0), &sample(0.01, 0.0, 5.0), || [NONE, NONE]), Leg::Honest);
        assert_eq!(test().judge(&sample(0.0, 0.0, 5.0), &sample(0.01, 0.0, 7.0), || [NONE, NONE]), Leg::Jump);
    }

    #[test]
    fn a_grazing_wall_is_honest_only_with_a_neighbour_that_goes_on() {
        // A wall along x at y = 1, seen at gamma of about 20.
        let at = |k: usize| {
            let az = 0.05 + 0.004 * k as f32;
            sample(az, 0.0, 1.0 / az.sin())
        };
        assert_eq!(test().judge(&at(1), &at(2), || [at(0), at(3)]), Leg::Honest);
        assert_eq!(test().judge(&at(1), &at(2), || [NONE, NONE]), Leg::Jump);
    }

    #[test]
    fn level_ground_is_honest_without_neighbours_but_not_the_same_leg_above_the_horizon() {
        let at = |deg: f32, sign: f32| sample(0.0, sign * deg.to_radians(), 1.0 / deg.to_radians().sin());
        assert_eq!(test().judge(&at(3.5, -1.0), &at(3.0, -1.0), || [NONE, NONE]), Leg::Honest);
        assert_eq!(test().judge(&at(3.5, 1.0), &at(3.0, 1.0), || [NONE, NONE]), Leg::Jump);
    }

    #[test]
    fn one_direction_seen_twice_makes_no_leg() {
        assert_eq!(test().judge(&sample(0.0, 0.0, 5.0), &sample(0.0, 0.0, 5.0), || [NONE, NONE]), Leg::Absent);
        assert_eq!(test().judge(&sample(0.0, 0.0, 5.0), &sample(0.0, 0.0, 9.0), || [NONE, NONE]), Leg::Absent);
        assert_eq!(test().judge(&sample(0.0, 0.0, 5.0), &sample(0.5, 0.0, 5.0), || [NONE, NONE]), Leg::Absent);
        assert_eq!(test().judge(&NONE, &sample(0.0, 0.0, 5.0), || [NONE, NONE]), Leg::Absent);
    }
}
