//! The noise filter before meshing (calibration, form 1): 1/range is linear along a grid line on a plane, so the mean
//! over pairs that lie symmetrically about a point takes noise out and leaves slanted ground where it is.

use super::config::SurfaceConfig;
use super::lines::LANES;

/// The filter's limits in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoother {
    radius: f32,
    cells_max: f32,
    residual_max: f32,
    jump: f32,
    jump_share: f32,
}

impl Smoother {
    /// The filter of a config, with at most `cells_max` cells to each side.
    pub(super) fn new(config: &SurfaceConfig, cells_max: usize) -> Self {
        Self {
            radius: config.filter_radius_m as f32,
            cells_max: cells_max as f32,
            residual_max: config.filter_residual_max_m as f32,
            jump: config.filter_jump_m as f32,
            jump_share: config.filter_jump_share as f32,
        }
    }

    /// The filtered inverse ranges of eight cells. `here` are theirs (zero where there is no return), `chord2` the squares
    /// of the chords to the next rays along the line, and `pair(k)` gives the inverse ranges k cells ahead and behind,
    /// zero beyond the line's ends.
    #[inline(always)]
    pub(super) fn smooth(
        &self,
        here: [f32; LANES],
        chord2: [f32; LANES],
        pair: impl Fn(usize) -> ([f32; LANES], [f32; LANES]),
    ) -> [f32; LANES] {
        let width = self.half_widths(&here, &chord2);
        let widest = width.iter().fold(0.0f32, |most, w| most.max(*w)) as usize;
        if widest == 0 {
            return here;
        }
        let (mut least, mut most, mut jump) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let range = 1.0 / here[k];
            // The mean of a pair must lie within residual_max of the range; asked of the inverses, without a division.
            least[k] = 1.0 / (range + self.residual_max);
            let far = 1.0 / (range - self.residual_max);
            most[k] = if range > self.residual_max { far } else { f32::INFINITY };
            jump[k] = self.jump.max(self.jump_share * range);
        }
        let (mut sum, mut pairs) = ([0.0f32; LANES], [0.0f32; LANES]);
        for offset in 1..=widest {
            let (plus, minus) = pair(offset);
            let reach = offset as f32;
            for k in 0..LANES {
                let mean = 0.5 * (plus[k] + minus[k]);
                // A missing return has q = 0 and fails the last test. No short circuits: the tests are cheaper than jumps.
                let fits = (reach <= width[k])
                    & (mean > least[k])
                    & (mean < most[k])
                    & ((plus[k] - minus[k]).abs() < jump[k] * plus[k] * minus[k]);
                sum[k] += if fits { mean } else { 0.0 };
                pairs[k] += if fits { 1.0 } else { 0.0 };
            }
        }
        let mut smoothed = [0.0; LANES];
        for k in 0..LANES {
            smoothed[k] = (here[k] + 2.0 * sum[k]) / (1.0 + 2.0 * pairs[k]);
        }
        smoothed
    }

    /// How many cells to each side lie within the radius on the surface (the whole part counts); 0 without a return or a
    /// neighbour.
    #[inline(always)]
    fn half_widths(&self, here: &[f32; LANES], chord2: &[f32; LANES]) -> [f32; LANES] {
        let mut widths = [0.0; LANES];
        for k in 0..LANES {
            let cells = (self.radius * here[k] / chord2[k].sqrt() + 0.5).min(self.cells_max);
            widths[k] = if (here[k] > 0.0) & (chord2[k] > 0.0) { cells } else { 0.0 };
        }
        widths
    }
}

#[cfg(test)]
mod tests {
    use super::super::lines::{LineShape, Lines, lanes};
    use super::*;

    const STEP: f32 = 0.00873;

    /// Inverse ranges of ground 1 m below, looked at from `from_deg` under the horizon downwards.
    fn ground(from_deg: f32, count: usize) -> Vec<f32> {
        (0..count).map(|i| (from_deg.to_radians() + i as f32 * STEP).sin()).collect()
    }

    fn smooth_all(q: &[f32], wraps: bool) -> Vec<f32> {
        let mut lines = Lines::default();
        lines.reset(LineShape::new(q.len(), 8, wraps), 1);
        lines.cells_mut(0).copy_from_slice(q);
        lines.close(0);
        let smoother = Smoother::new(&SurfaceConfig::default(), 8);
        let groups = (0..q.len()).step_by(LANES).flat_map(|col| {
            let at = |shift: isize| lanes(lines.from(0, col, 8), (8 + shift) as usize);
            smoother.smooth(at(0), [STEP * STEP; LANES], |k| (at(k as isize), at(-(k as isize))))
        });
        groups.take(q.len()).collect()
    }

    #[test]
    fn slanted_ground_stays_where_it_is() {
        let q = ground(20.0, 60);
        for (before, after) in q.iter().zip(smooth_all(&q, false)) {
            assert!((1.0 / before - 1.0 / after).abs() < 0.002, "{before} {after}");
        }
    }

    #[test]
    fn noise_is_taken_out_near_the_scanner() {
        let q: Vec<f32> = (0..40).map(|i| 1.0 / (1.0 + if i % 2 == 0 { 0.01 } else { -0.01 })).collect();
        for after in &smooth_all(&q, true) {
            assert!((1.0 / after - 1.0).abs() < 0.002);
        }
    }

    #[test]
    fn a_depth_jump_and_missing_returns_do_not_leak_into_a_point() {
        let mut q = vec![0.5; 20];
        q.extend([0.1; 20]);
        q[7] = 0.0;
        for (before, after) in q.iter().zip(smooth_all(&q, false)) {
            assert!((before - after).abs() < 1e-6, "{before} became {after}");
        }
    }

    #[test]
    fn far_points_are_left_alone() {
        let q: Vec<f32> = (0..40).map(|i| 1.0 / (25.0 + 0.01 * (i % 3) as f32)).collect();
        assert_eq!(smooth_all(&q, false), q);
    }
}
