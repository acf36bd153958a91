//! The settings of sequential alignment.

use serde::{Deserialize, Serialize};

use super::AcceptanceConfig;
use crate::registration::{ConfigError, Limits};

/// The settings of sequential alignment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SequentialConfig {
    /// The limits of each alignment.
    pub limits: Limits,
    /// What an alignment must show.
    pub acceptance: AcceptanceConfig,
    /// The pair distance of the second attempt from the same start [m].
    pub wide_pair_distance_m: f64,
    /// A pose within so many standard deviations of its prior's and its own from the one expected by the prior is weighed with
    /// it; one farther off is refused where the scans overlap by less than `acceptance.verify_below_overlap`, and must be consistent
    /// as those below it where they overlap more. 0 never asks.
    /// Only for priors that come with a covariance.
    pub prior_gate_sigmas: f64,
    /// The standard deviation of the position of a scan that was not aligned [m].
    pub guess_sigma_m: f64,
    /// The standard deviation of the angles of a scan that was not aligned [rad].
    pub guess_sigma_rotation: f64,
}

impl Default for SequentialConfig {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            acceptance: AcceptanceConfig::default(),
            wide_pair_distance_m: 5.0,
            prior_gate_sigmas: 5.0,
            guess_sigma_m: 1.0,
            guess_sigma_rotation: 0.2,
        }
    }
}

impl SequentialConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.limits.validate()?;
        self.acceptance.validate()?;
        ConfigError::check("wide_pair_distance_m", self.wide_pair_distance_m, 1e-3, 100.0)?;
        ConfigError::check("prior_gate_sigmas", self.prior_gate_sigmas, 0.0, 1e3)?;
        ConfigError::check("guess_sigma_m", self.guess_sigma_m, 0.0, 1e4)?;
        ConfigError::check("guess_sigma_rotation", self.guess_sigma_rotation, 0.0, std::f64::consts::PI)
    }
}
