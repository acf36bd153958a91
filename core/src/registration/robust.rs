//! Robust kernels: how much a pair counts, given how badly it fits.

use serde::{Deserialize, Serialize};

use super::RegistrationConfig;
use super::evidence::Gates;

/// The weight function of iteratively reweighted least squares, s the scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustKernel {
    /// Every pair counts alike.
    None,
    /// Full weight up to the scale, then falling as s / |r| (Huber 1964).
    Huber,
    /// 1 / (1 + (r / s)^2).
    #[default]
    Cauchy,
    /// (1 - (r / s)^2)^2 up to the scale, nothing beyond (Beaton and Tukey 1974); s is taken four times as wide as by
    /// the others, which makes it as efficient on normal errors.
    Tukey,
    /// 1 / (1 + (r / s)^2)^2 (Geman and McClure 1987).
    GemanMcclure,
}

impl RobustKernel {
    /// The weight of a residual at a scale, both in one unit: in [0, 1].
    #[must_use]
    pub fn weight(self, residual: f64, scale: f64) -> f64 {
        let ratio = residual / scale;
        f64::from(Kernel::new(self, 1.0).weight((ratio * ratio) as f32))
    }
}

/// A kernel at one scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kernel {
    kind: RobustKernel,
    /// 1 / s^2.
    per_scale_sq: f32,
}

impl Kernel {
    /// The kernel of a pass. Kernels that give far pairs nothing at all would leave a distant start where it is: as long
    /// as pairs may be far apart, Cauchy's takes their place.
    pub fn of_pass(config: &RegistrationConfig, gates: &Gates) -> Self {
        let on_the_way = gates.widening() > 1.0;
        let kind = match config.robust_kernel {
            RobustKernel::Tukey | RobustKernel::GemanMcclure if on_the_way => RobustKernel::Cauchy,
            kind => kind,
        };
        Self::new(kind, gates.scale_m * gates.widening())
    }

    /// The kernel at the scale [m].
    pub fn new(kind: RobustKernel, scale_m: f64) -> Self {
        let scale_m = if kind == RobustKernel::Tukey { 4.0 * scale_m } else { scale_m };
        Self { kind, per_scale_sq: (1.0 / (scale_m * scale_m)) as f32 }
    }

    /// The weight of a residual, given its square [m^2]: in [0, 1].
    #[inline(always)]
    pub fn weight(&self, residual_sq: f32) -> f32 {
        let ratio_sq = residual_sq * self.per_scale_sq;
        match self.kind {
            RobustKernel::None => 1.0,
            RobustKernel::Huber if ratio_sq <= 1.0 => 1.0,
            RobustKernel::Huber => 1.0 / ratio_sq.sqrt(),
            RobustKernel::Cauchy => 1.0 / (1.0 + ratio_sq),
            RobustKernel::Tukey => {
                let left = (1.0 - ratio_sq).max(0.0);
                left * left
            }
            RobustKernel::GemanMcclure => {
                let weight = 1.0 / (1.0 + ratio_sq);
                weight * weight
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_start_at_one_and_never_rise() {
        use RobustKernel::{Cauchy, GemanMcclure, Huber, None, Tukey};
        for kind in [Huber, Cauchy, Tukey, GemanMcclure] {
            let kernel = Kernel::new(kind, 0.1);
            assert_eq!(kernel.weight(0.0), 1.0);
            let weights: Vec<f32> = (0..100).map(|k| kernel.weight(0.0004 * (k * k) as f32)).collect();
            assert!(weights.windows(2).all(|w| w[1] <= w[0]), "{kind:?}: {weights:?}");
            assert!(weights[99] < 0.06, "{kind:?}");
        }
        assert_eq!(Kernel::new(None, 0.1).weight(81.0), 1.0);
        assert_eq!(Kernel::new(Tukey, 0.1).weight(0.17), 0.0);
    }
}
