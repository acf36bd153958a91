//! The noise filter before meshing (calibration, form 1): 1/range is linear along a grid line on a plane, so the mean
//! over pairs that lie symmetrically about a point takes noise out and leaves slanted ground where it is.

use super::config::SurfaceConfig;

/// The filter's limits in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoother {
    radius: f32,
    cells_max: usize,
    residual_max: f32,
    jump: f32,
    jump_share: f32,
}

impl Smoother {
    pub(super) fn new(config: &SurfaceConfig) -> Self {
        Self {
            radius: config.filter_radius_m as f32,
            cells_max: config.filter_cells_max,
            residual_max: config.filter_residual_max_m as f32,
            jump: config.filter_jump_m as f32,
            jump_share: config.filter_jump_share as f32,
        }
    }

    /// The filtered inverse range at position `at` of a line of inverse ranges `q` (zero where there is no return):
    /// cell k of the line has index `base + k * stride`. `step` is the angle to the next ray along the line [rad].
    pub(super) fn smooth(&self, q: &[f32], line: Line, at: usize, step: f32) -> f32 {
        let here = q[line.base + at * line.stride];
        let width = self.half_width(here, step).min(line.reach(at));
        if width == 0 {
            return here;
        }
        let range = 1.0 / here;
        // The mean of a pair must lie within residual_max of the range; asked of the inverses, without a division.
        let least = 1.0 / (range + self.residual_max);
        let most = if range > self.residual_max { 1.0 / (range - self.residual_max) } else { f32::INFINITY };
        let jump = self.jump.max(self.jump_share * range);
        let (mut sum, mut pairs) = (0.0, 0.0);
        for offset in 1..=width {
            let (plus, minus) = line.pair(q, at, offset);
            let mean = 0.5 * (plus + minus);
            // A missing return has q = 0 and fails the last test. No short circuits: the tests are cheaper than jumps.
            let fits = (mean > least) & (mean < most) & ((plus - minus).abs() < jump * plus * minus);
            sum += if fits { mean } else { 0.0 };
            pairs += if fits { 1.0 } else { 0.0 };
        }
        (here + 2.0 * sum) / (1.0 + 2.0 * pairs)
    }

    /// How many cells to each side lie within the radius on the surface.
    fn half_width(&self, here: f32, step: f32) -> usize {
        if here <= 0.0 || step <= 0.0 {
            return 0;
        }
        let cells = self.radius * here / step + 0.5;
        if cells < self.cells_max as f32 { cells as usize } else { self.cells_max }
    }
}

/// One line of the grid within a flat array.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    pub(super) base: usize,
    pub(super) stride: usize,
    pub(super) len: usize,
    pub(super) wraps: bool,
}

impl Line {
    /// The largest offset for which both cells of the pair exist.
    fn reach(&self, at: usize) -> usize {
        if self.wraps { (self.len - 1) / 2 } else { at.min(self.len - 1 - at) }
    }

    /// The values `offset` cells ahead and behind.
    fn pair(&self, q: &[f32], at: usize, offset: usize) -> (f32, f32) {
        let ahead = if at + offset < self.len { at + offset } else { at + offset - self.len };
        let behind = if at >= offset { at - offset } else { at + self.len - offset };
        (q[self.base + ahead * self.stride], q[self.base + behind * self.stride])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f32 = 0.00873;

    /// Inverse ranges of ground 1 m below, looked at from `from_deg` under the horizon downwards.
    fn ground(from_deg: f32, count: usize) -> Vec<f32> {
        (0..count).map(|i| (from_deg.to_radians() + i as f32 * STEP).sin()).collect()
    }

    fn smooth_all(q: &[f32], wraps: bool) -> Vec<f32> {
        let line = Line { base: 0, stride: 1, len: q.len(), wraps };
        let smoother = Smoother::new(&SurfaceConfig::default());
        (0..q.len()).map(|at| smoother.smooth(q, line, at, STEP)).collect()
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
