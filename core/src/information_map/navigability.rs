//! Can the robot cross this cell? Navigability C_nc (4.4) and the states a cell can be in.

/// What is known of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CellState {
    /// No evidence of any kind, ever.
    Unknown,
    /// Something was seen here; the value is C_nc (4.4), 0.5 when it says neither navigable nor obstacle.
    Known(f64),
}

/// C_nc from the four quantities of (4.1) to (4.4): with r = n_phi / (n_phi + w n_alpha) it is
/// r (0.5 + Fbar / 2) + (1 - r) (0.5 - Bbar / 2), and 0.5 when there is neither. In [0, 1]; 0 cannot be crossed.
#[must_use]
pub fn navigability_of(n_phi: u64, mean_f: f64, n_alpha: u64, mean_b: f64, obstacle_weight: f64) -> f64 {
    if n_phi == 0 && n_alpha == 0 {
        return 0.5;
    }
    let r = n_phi as f64 / (n_phi as f64 + obstacle_weight * n_alpha as f64);
    r * (0.5 + 0.5 * mean_f) + (1.0 - r) * (0.5 - 0.5 * mean_b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn without_navigable_or_obstacle_points_it_is_one_half() {
        assert_eq!(navigability_of(0, 0.0, 0, 0.0, 3.0), 0.5);
    }

    #[test]
    fn sure_ground_is_one_and_a_sure_wall_is_zero() {
        assert_eq!(navigability_of(9, 1.0, 0, 0.0, 3.0), 1.0);
        assert_eq!(navigability_of(0, 0.0, 9, 1.0, 3.0), 0.0);
    }

    proptest! {
        #[test]
        fn it_stays_between_zero_and_one(
            phi in 0..100_000u64, f in 0.0..=1.0f64, alpha in 0..100_000u64, b in 0.0..=1.0f64, w in 1.0..100.0f64,
        ) {
            prop_assert!((0.0..=1.0).contains(&navigability_of(phi, f, alpha, b, w)));
        }

        #[test]
        fn it_rises_with_navigable_and_falls_with_obstacle_points(
            phi in 0..1000u64, f in 0.0..=1.0f64, alpha in 0..1000u64, b in 0.0..=1.0f64, w in 1.0..10.0f64,
        ) {
            let now = navigability_of(phi, f, alpha, b, w);
            prop_assert!(navigability_of(phi + 1, f, alpha, b, w) >= now - 1e-12);
            prop_assert!(navigability_of(phi, f, alpha + 1, b, w) <= now + 1e-12);
            prop_assert!(navigability_of(phi, (f + 0.1).min(1.0), alpha, b, w) >= now);
            prop_assert!(navigability_of(phi, f, alpha, (b + 0.1).min(1.0), w) <= now);
        }
    }
}
