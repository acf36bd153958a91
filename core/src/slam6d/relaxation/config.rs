//! The settings of multi-scan relaxation.

use serde::{Deserialize, Serialize};

use crate::registration::{ConfigError, RobustKernel};

/// The settings of multi-scan relaxation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelaxationConfig {
    /// Most rounds: point pairs are found again in each.
    pub max_rounds: u32,
    /// The source's threshold: relaxation ends when no scan moves farther than this in a round [m].
    pub translation_tolerance_m: f64,
    /// ... and none turns more than this [rad].
    pub rotation_tolerance: f64,
    /// Scans whose scanners stood farther apart than this are not paired [m].
    pub max_distance_m: f64,
    /// Scans of which less than this share of the points meet are not paired.
    pub min_overlap: f64,
    /// The farthest partner of a point in the first round [m]. It is halved as the motions get smaller.
    pub first_pair_distance_m: f64,
    /// The farthest partner of a point in the last rounds [m].
    pub final_pair_distance_m: f64,
    /// How distances to the tangent planes lose weight as they grow.
    pub robust_kernel: RobustKernel,
    /// The distance to the tangent plane at which they begin to, in the last rounds [m].
    pub robust_scale_m: f64,
    /// Every so many points of a scan look for a partner in each other scan.
    pub stride: usize,
    /// Worker threads; results do not depend on it.
    pub threads: usize,
}

impl Default for RelaxationConfig {
    fn default() -> Self {
        Self {
            max_rounds: 30,
            translation_tolerance_m: 1e-3,
            rotation_tolerance: 1e-4,
            max_distance_m: 8.0,
            min_overlap: 0.3,
            first_pair_distance_m: 1.0,
            final_pair_distance_m: 0.5,
            robust_kernel: RobustKernel::Cauchy,
            robust_scale_m: 0.1,
            stride: 4,
            threads: 1,
        }
    }
}

impl RelaxationConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("relaxation.max_rounds", f64::from(self.max_rounds), 1.0, 10_000.0)?;
        ConfigError::check("relaxation.translation_tolerance_m", self.translation_tolerance_m, 1e-9, 10.0)?;
        ConfigError::check("relaxation.rotation_tolerance", self.rotation_tolerance, 1e-9, 1.0)?;
        ConfigError::check("relaxation.max_distance_m", self.max_distance_m, 0.0, 1e4)?;
        ConfigError::check("relaxation.min_overlap", self.min_overlap, 0.0, 1.0)?;
        let (first, last) = (self.first_pair_distance_m, self.final_pair_distance_m);
        ConfigError::check("relaxation.final_pair_distance_m", last, 1e-3, 100.0)?;
        ConfigError::check("relaxation.first_pair_distance_m", first, last, 100.0)?;
        ConfigError::check("relaxation.robust_scale_m", self.robust_scale_m, 1e-6, 100.0)?;
        ConfigError::check("relaxation.stride", self.stride as f64, 1.0, 1e6)
    }
}
