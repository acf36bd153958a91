//! How good a point is as data: D in [0, 1] (3.23 to 3.27).

use super::config::SurfaceConfig;

/// A_max (3.24): the share of a surface at `distance_m` that one ray of a scanner with these angular steps [rad] covers
/// head-on [m^2].
#[must_use]
pub fn area_limit(distance_m: f64, head_step: f64, beam_step: f64) -> f64 {
    distance_m * distance_m * head_step.sin() * beam_step.sin()
}

/// D_A (3.23): 1 up to `area_max`, then in inverse proportion [areas in m^2].
#[must_use]
#[inline]
pub fn area_quality(area: f32, area_max: f32) -> f32 {
    if area <= area_max { 1.0 } else { area_max / area }
}

/// D_I (3.26): |v.n| of the unit ray and the unit normal.
#[must_use]
pub fn incidence_quality(ray: [f32; 3], normal: [f32; 3]) -> f32 {
    (ray[0] * normal[0] + ray[1] * normal[1] + ray[2] * normal[2]).abs().min(1.0)
}

/// D (3.27), the weighted root mean square of both.
#[must_use]
pub fn quality(area_quality: f32, incidence_quality: f32, w_a: f32, w_n: f32) -> f32 {
    let (a, n) = (w_a * area_quality, w_n * incidence_quality);
    ((a * a + n * n) / (w_a * w_a + w_n * w_n)).sqrt().min(1.0)
}

/// The value, or 1 if that is less; one instruction, unlike `f32::min`.
#[inline(always)]
pub(super) fn at_most_one(value: f32) -> f32 {
    if value < 1.0 { value } else { 1.0 }
}

/// The quality's constants in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct QualityScale {
    area_max: f32,
    w_a: f32,
    w_n: f32,
    /// 1 / sqrt(w_a^2 + w_n^2).
    scale: f32,
}

impl QualityScale {
    pub(super) fn new(config: &SurfaceConfig) -> Self {
        let scale = 1.0 / config.w_a.hypot(config.w_n);
        let (w_a, w_n) = (config.w_a as f32, config.w_n as f32);
        Self { area_max: config.area_max_m2 as f32, w_a, w_n, scale: scale as f32 }
    }

    /// D of a point with this area [m^2] and |v.n|.
    #[inline(always)]
    pub(super) fn of(&self, area: f32, incidence: f32) -> f32 {
        // As `area_quality`, without a jump.
        let larger = if area > self.area_max { area } else { self.area_max };
        let (a, n) = (self.w_a * (self.area_max / larger), self.w_n * incidence);
        at_most_one((a * a + n * n).sqrt() * self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quality_lies_between_zero_and_one_and_rises_with_both_parts(
            a in 0.0..=1.0f32, n in 0.0..=1.0f32, more in 0.0..=1.0f32, w_a in 0.01..2.0f32, w_n in 0.01..2.0f32,
        ) {
            let d = quality(a, n, w_a, w_n);
            prop_assert!((0.0..=1.0).contains(&d));
            prop_assert!(quality((a + more).min(1.0), n, w_a, w_n) >= d);
            prop_assert!(quality(a, (n + more).min(1.0), w_a, w_n) >= d);
        }

        #[test]
        fn the_area_quality_is_full_up_to_the_limit_and_then_falls_in_proportion(area in 0.0..1.0f32) {
            let d = area_quality(area, 0.0025);
            if area <= 0.0025 { prop_assert_eq!(d, 1.0); } else { prop_assert!((d * area - 0.0025).abs() < 1e-8); }
        }
    }

    proptest! {
        #[test]
        fn the_scale_of_a_scan_gives_the_quality_of_the_formula(area in 0.0..0.1f32, incidence in 0.0..=1.0f32) {
            let direct = quality(area_quality(area, 0.0025), incidence, 0.93, 0.07);
            prop_assert!((QualityScale::new(&SurfaceConfig::default()).of(area, incidence) - direct).abs() < 1e-5);
        }
    }

    #[test]
    fn the_limit_of_half_a_degree_at_5_7_m_is_25_square_centimetres() {
        let step = 0.5f64.to_radians();
        assert!((area_limit(5.7, step, step) - 0.0025).abs() < 5e-5);
    }

    #[test]
    fn the_weights_are_those_of_the_source() {
        assert!((quality(1.0, 1.0, 0.93, 0.07) - 1.0).abs() < 1e-6);
        assert!((quality(1.0, 0.0, 0.93, 0.07) - 0.93 / (0.93f32 * 0.93 + 0.07 * 0.07).sqrt()).abs() < 1e-6);
        assert!((quality(0.5, 0.0, 0.93, 0.0) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn the_incidence_quality_is_the_cosine_to_the_normal() {
        assert_eq!(incidence_quality([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]), 1.0);
        assert_eq!(incidence_quality([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), 0.0);
        let c = 60f32.to_radians().cos();
        assert!((incidence_quality([1.0, 0.0, 0.0], [-c, 0.0, 60f32.to_radians().sin()]) - 0.5).abs() < 1e-6);
    }
}
