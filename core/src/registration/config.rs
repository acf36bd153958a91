//! The settings of the built-in methods.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::RobustKernel;

/// A setting is out of range.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{field} = {value} is out of range; it must lie between {least} and {most}")]
pub struct ConfigError {
    /// The field, as written in the configuration.
    pub field: &'static str,
    /// The value it had.
    pub value: f64,
    /// The least allowed value.
    pub least: f64,
    /// The greatest allowed value.
    pub most: f64,
}

impl ConfigError {
    /// Passes when `least <= value <= most`.
    ///
    /// # Errors
    /// The field with its allowed range.
    pub fn check(field: &'static str, value: f64, least: f64, most: f64) -> Result<(), Self> {
        if (least..=most).contains(&value) { Ok(()) } else { Err(Self { field, value, least, most }) }
    }
}

/// How a scan is reduced before it is aligned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreparationConfig {
    /// Points nearer than this are dropped: they hit the robot itself [m].
    pub min_range_m: f64,
    /// Points farther than this are dropped [m].
    pub max_range_m: f64,
    /// Edge of the voxels; the returns in one voxel become their centroid [m].
    pub voxel_m: f64,
    /// Fewer reduced points than this are an error.
    pub minimum_points: usize,
}

impl Default for PreparationConfig {
    fn default() -> Self {
        Self { min_range_m: 0.25, max_range_m: 120.0, voxel_m: 0.25, minimum_points: 100 }
    }
}

impl PreparationConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("preparation.min_range_m", self.min_range_m, 0.0, 1e3)?;
        ConfigError::check("preparation.max_range_m", self.max_range_m, self.min_range_m, 1e4)?;
        // Voxel coordinates are stored in 21 bits an axis.
        let least_voxel = (self.max_range_m / f64::from(1 << 19)).max(1e-3);
        ConfigError::check("preparation.voxel_m", self.voxel_m, least_voxel, 10.0)?;
        ConfigError::check("preparation.minimum_points", self.minimum_points as f64, 10.0, 1e6)
    }
}

/// How a step follows from the pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Optimiser {
    /// The full step of the normal equations.
    #[default]
    GaussNewton,
    /// Shorter steps after one that made things worse (Levenberg 1944, Marquardt 1963).
    LevenbergMarquardt,
}

/// The settings of a registration method; the built-in ones share them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationConfig {
    /// Worker threads; results do not depend on it.
    pub threads: usize,
    /// How scans are reduced.
    pub preparation: PreparationConfig,
    /// The farthest partner a point may have once the alignment has settled [m].
    pub final_pair_distance_m: f64,
    /// How a step follows from the pairs.
    pub optimiser: Optimiser,
    /// How residuals lose weight as they grow. Point to point and the normal distributions transform have none.
    pub robust_kernel: RobustKernel,
    /// The residual at which they begin to, once the alignment has settled [m].
    pub robust_scale_m: f64,
    /// The share of the pairs, those that fit best, which pull at all (trimmed ICP, Chetverikov et al. 2002); 1 trims
    /// none.
    pub trimmed_overlap: f64,
    /// A last step shorter than this ends the alignment [m].
    pub translation_tolerance_m: f64,
    /// A last step turning less than this ends the alignment [rad].
    pub rotation_tolerance: f64,
    /// The least eigenvalue of the normalised Hessian of a direction that counts as constrained, see
    /// [`super::Constraint`]. Noise in the normals alone gives 0.001 to 0.002 at 1 cm; a narrow corridor's roll, which
    /// is known but has short levers, 0.009.
    pub constrained_eigenvalue: f64,
    /// The distance within which a partner counts as overlap [m].
    pub overlap_distance_m: f64,
    /// How many points of a scan share one error (they are fitted to the same few returns and seen by the same beam):
    /// the covariance is that many times the one of independent points.
    pub points_per_independent_error: f64,
    /// Settings of methods that are not built in, as they please.
    pub custom: toml::Table,
}

impl Default for RegistrationConfig {
    fn default() -> Self {
        Self {
            threads: 1,
            preparation: PreparationConfig::default(),
            final_pair_distance_m: 0.5,
            optimiser: Optimiser::GaussNewton,
            robust_kernel: RobustKernel::Cauchy,
            robust_scale_m: 0.1,
            trimmed_overlap: 1.0,
            translation_tolerance_m: 2e-4,
            rotation_tolerance: 2e-5,
            constrained_eigenvalue: 0.004,
            overlap_distance_m: 0.3,
            points_per_independent_error: 48.0,
            custom: toml::Table::new(),
        }
    }
}

impl RegistrationConfig {
    /// Checks every field; `custom` is the business of the method it is for.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("threads", self.threads as f64, 1.0, 256.0)?;
        self.preparation.validate()?;
        ConfigError::check("final_pair_distance_m", self.final_pair_distance_m, 1e-3, 100.0)?;
        ConfigError::check("robust_scale_m", self.robust_scale_m, 1e-4, 100.0)?;
        ConfigError::check("translation_tolerance_m", self.translation_tolerance_m, 0.0, 1.0)?;
        ConfigError::check("trimmed_overlap", self.trimmed_overlap, 0.05, 1.0)?;
        ConfigError::check("rotation_tolerance", self.rotation_tolerance, 0.0, 1.0)?;
        ConfigError::check("constrained_eigenvalue", self.constrained_eigenvalue, 1e-6, 0.3)?;
        ConfigError::check("overlap_distance_m", self.overlap_distance_m, 1e-3, 100.0)?;
        ConfigError::check("points_per_independent_error", self.points_per_independent_error, 1.0, 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_toml() {
        let config = RegistrationConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<RegistrationConfig>(&text).unwrap(), config);
    }

    #[test]
    fn a_voxel_of_zero_is_refused_by_name() {
        let mut config = RegistrationConfig::default();
        config.preparation.voxel_m = 0.0;
        let error = config.validate().unwrap_err();
        assert_eq!(error.field, "preparation.voxel_m");
        config.preparation.voxel_m = f64::NAN;
        assert!(config.validate().is_err());
    }

    #[test]
    fn an_unknown_field_is_refused() {
        assert!(toml::from_str::<RegistrationConfig>("voxels = 1").is_err());
    }
}
