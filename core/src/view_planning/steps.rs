//! Where the ground steps: neighbouring cells that can both be driven on, but not from one to the other, as at the edge of
//! a deck or of a retaining wall. The higher one of the two is marked: the robot keeps clear of it as it does of an
//! obstacle, and so of any two neighbours that it may enter the ground differs by no more than it masters.

use super::config::PlanningConfig;

/// The largest differences in height of the ground that the robot masters [m]: a step, and as much as the steepest slope
/// rises between the middles of the cells.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct StepLimits {
    /// Between cells that share a side.
    pub beside: f32,
    /// Between cells that share a corner; also within a cell.
    pub diagonal: f32,
    /// The steepest slope.
    pub slope: f32,
    /// The step.
    pub step: f32,
}

impl StepLimits {
    pub fn new(config: &PlanningConfig, cell_m: f64) -> Self {
        let slope = config.max_slope_deg.to_radians().tan();
        let limit = |distance_m: f64| (config.max_step_m + distance_m * slope) as f32;
        let (beside, diagonal) = (limit(cell_m), limit(cell_m * std::f64::consts::SQRT_2));
        Self { beside, diagonal, slope: slope as f32, step: config.max_step_m as f32 }
    }

    /// The largest difference between ends of the ground of two neighbouring cells, for the choice of levels.
    pub fn between_levels(config: &PlanningConfig, cell_m: f64) -> f64 {
        config.max_step_m + 2.0 * std::f64::consts::SQRT_2 * cell_m * config.max_slope_deg.to_radians().tan()
    }
}

/// Heights of the ground in a line of cells, and which of them can be driven on, one bit each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line<'a> {
    pub ground: &'a [f32; 16],
    pub navigable: u16,
}

/// The cells of a line that stand over one beside them in it.
pub(super) fn along(line: Line<'_>, limits: &StepLimits) -> u16 {
    let both = line.navigable & line.navigable >> 1;
    if both == 0 {
        return 0;
    }
    let (lower, upper) = higher(&line.ground[..15], &line.ground[1..], limits.beside);
    lower & both | (upper & both) << 1
}

/// The cells of two neighbouring lines that stand over one of the other line, straight across or at a corner.
pub(super) fn across(a: Line<'_>, b: Line<'_>, limits: &StepLimits) -> (u16, u16) {
    let near = b.navigable | b.navigable << 1 | b.navigable >> 1;
    if a.navigable & near == 0 {
        return (0, 0);
    }
    let (in_a, in_b) = higher(a.ground, b.ground, limits.beside);
    let both = a.navigable & b.navigable;
    let (mut in_a, mut in_b) = (in_a & both, in_b & both);
    let (first, second) = higher(&a.ground[..15], &b.ground[1..], limits.diagonal);
    let both = a.navigable & b.navigable >> 1;
    in_a |= first & both;
    in_b |= (second & both) << 1;
    let (first, second) = higher(&a.ground[1..], &b.ground[..15], limits.diagonal);
    let both = a.navigable >> 1 & b.navigable;
    in_a |= (first & both) << 1;
    in_b |= second & both;
    (in_a, in_b)
}

/// The pairs whose first is higher than its second by more than `limit`, and those whose second is.
#[inline]
fn higher(a: &[f32], b: &[f32], limit: f32) -> (u16, u16) {
    let (mut first, mut second) = (0, 0);
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        first |= u16::from(a - b > limit) << k;
        second |= u16::from(b - a > limit) << k;
    }
    (first, second)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: StepLimits = StepLimits { beside: 0.3, diagonal: 0.4, slope: 0.3, step: 0.2 };

    #[test]
    fn a_step_of_a_wheel_s_radius_and_the_steepest_slope_are_mastered_and_half_a_metre_is_not() {
        let limits = StepLimits::new(&PlanningConfig::default(), 0.3);
        let slope = 20f32.to_radians().tan();
        assert!(limits.beside > 0.165 + 0.29 * slope && limits.diagonal > 0.165 + 0.42 * slope);
        assert!(limits.diagonal < 0.35, "{limits:?}");
    }

    proptest! {
        #[test]
        fn exactly_the_higher_ones_of_neighbours_that_differ_too_much_are_marked(
            a in prop::collection::vec(0.0..0.8f32, 16), b in prop::collection::vec(0.0..0.8f32, 16),
            free_a in any::<u16>(), free_b in any::<u16>(),
        ) {
            let [a, b]: [[f32; 16]; 2] = [a.try_into().unwrap(), b.try_into().unwrap()];
            let (line_a, line_b) = (Line { ground: &a, navigable: free_a }, Line { ground: &b, navigable: free_b });
            let (in_a, in_b) = across(line_a, line_b, &LIMITS);
            let in_row = along(line_a, &LIMITS);
            let is_free = |bits: u16, k: usize| bits >> k & 1 == 1;
            let limit = |i: usize, k: usize| if i == k { LIMITS.beside } else { LIMITS.diagonal };
            for i in 0..16usize {
                let near = i.saturating_sub(1)..=(i + 1).min(15);
                let a_over_b = near.clone().any(|k| is_free(free_a, i) && is_free(free_b, k) && a[i] - b[k] > limit(i, k));
                let b_over_a = near.clone().any(|k| is_free(free_b, i) && is_free(free_a, k) && b[i] - a[k] > limit(i, k));
                let a_over_a = near.clone().any(|k| is_free(free_a, i) && is_free(free_a, k) && a[i] - a[k] > LIMITS.beside);
                prop_assert_eq!((is_free(in_a, i), is_free(in_b, i), is_free(in_row, i)), (a_over_b, b_over_a, a_over_a));
            }
        }
    }
}
