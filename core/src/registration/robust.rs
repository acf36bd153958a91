//! Robust kernels: how much a pair counts, given how badly it fits.

use serde::{Deserialize, Serialize};

/// The weight function of iteratively reweighted least squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustKernel {
    /// Every pair counts alike.
    None,
    /// Full weight up to the scale, then falling as scale / |r| (Huber 1964).
    Huber,
    /// 1 / (1 + (r / scale)^2).
    #[default]
    Cauchy,
}

impl RobustKernel {
    /// The weight of a residual, in (0, 1].
    #[must_use]
    pub fn weight(self, residual: f64, scale: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber => (scale / residual.abs().max(scale)).min(1.0),
            Self::Cauchy => {
                let ratio = residual / scale;
                1.0 / (1.0 + ratio * ratio)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_start_at_one_and_fall() {
        for kernel in [RobustKernel::Huber, RobustKernel::Cauchy] {
            assert_eq!(kernel.weight(0.0, 0.1), 1.0);
            assert!(kernel.weight(0.5, 0.1) > kernel.weight(-1.0, 0.1));
            assert_eq!(kernel.weight(0.3, 0.1), kernel.weight(-0.3, 0.1));
        }
        assert_eq!(RobustKernel::None.weight(9.0, 0.1), 1.0);
    }
}
