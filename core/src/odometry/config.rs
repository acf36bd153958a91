//! The settings of the odometry.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;

/// The settings of the odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryConfig {
    /// Worker threads; results do not depend on it.
    pub threads: usize,
    /// Returns nearer than this are dropped: they hit the robot itself [m].
    pub min_range_m: f64,
    /// Returns farther than this are dropped, and so is what the map holds at more than this from the scanner [m].
    pub max_range_m: f64,
    /// Edge of the map's fine voxels; the coarse ones are twice as wide [m].
    pub voxel_m: f64,
    /// Most fine voxels in the map, and half as many coarse ones: at about 180 bytes a fine voxel it bounds the memory.
    pub max_voxels: usize,
    /// Carry every point to the end of the scan by its time and the motion. Scans without times are not changed.
    pub deskew: bool,
    /// Most steps of one alignment.
    pub max_iterations: u32,
    /// How far the first predictions may be off: the adaptive threshold before it has learnt anything [m].
    pub initial_threshold_m: f64,
    /// Deviations from the prediction below this teach the threshold nothing [m].
    pub min_motion_m: f64,
    /// The residual at which a pair begins to lose weight, once the alignment has settled [m].
    pub robust_scale_m: f64,
    /// A last step shorter than this ends the alignment [m].
    pub translation_tolerance_m: f64,
    /// A last step turning less than this ends the alignment [rad].
    pub rotation_tolerance: f64,
    /// The least eigenvalue of a direction that counts as constrained, see [`crate::registration::Constraint`].
    pub constrained_eigenvalue: f64,
    /// How many points of a frame share one error: the covariance is that many times the one of independent points.
    pub points_per_independent_error: f64,
    /// A frame with fewer reduced points than this is not aligned.
    pub minimum_points: usize,
    /// A frame of which a smaller share fits the map than this is lost, 0 to 1.
    pub minimum_score: f64,
    /// When the prediction leads nowhere, look for the pose within this distance of the last one, whatever the heading;
    /// 0 switches the search off [m].
    pub search_radius_m: f64,
}

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            threads: 1,
            min_range_m: 0.5,
            max_range_m: 100.0,
            voxel_m: 1.0,
            max_voxels: 120_000,
            deskew: true,
            max_iterations: 50,
            initial_threshold_m: 2.0,
            min_motion_m: 0.1,
            robust_scale_m: 0.1,
            translation_tolerance_m: 5e-4,
            rotation_tolerance: 5e-5,
            constrained_eigenvalue: 0.004,
            points_per_independent_error: 24.0,
            minimum_points: 100,
            minimum_score: 0.3,
            search_radius_m: 4.0,
        }
    }
}

impl OdometryConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("odometry.threads", self.threads as f64, 1.0, 256.0)?;
        ConfigError::check("odometry.min_range_m", self.min_range_m, 0.0, 1e3)?;
        ConfigError::check("odometry.max_range_m", self.max_range_m, self.min_range_m.max(1.0), 1e3)?;
        // A quarter of it, the cell of the reduction, is counted in 16 bits an axis.
        ConfigError::check("odometry.voxel_m", self.voxel_m, (self.max_range_m / 4000.0).max(0.05), 10.0)?;
        ConfigError::check("odometry.max_voxels", self.max_voxels as f64, 1000.0, 1e8)?;
        ConfigError::check("odometry.max_iterations", f64::from(self.max_iterations), 1.0, 10_000.0)?;
        ConfigError::check("odometry.initial_threshold_m", self.initial_threshold_m, 1e-2, 100.0)?;
        ConfigError::check("odometry.min_motion_m", self.min_motion_m, 0.0, 100.0)?;
        ConfigError::check("odometry.robust_scale_m", self.robust_scale_m, 1e-3, 10.0)?;
        ConfigError::check("odometry.translation_tolerance_m", self.translation_tolerance_m, 0.0, 1.0)?;
        ConfigError::check("odometry.rotation_tolerance", self.rotation_tolerance, 0.0, 1.0)?;
        ConfigError::check("odometry.constrained_eigenvalue", self.constrained_eigenvalue, 1e-6, 0.3)?;
        ConfigError::check("odometry.points_per_independent_error", self.points_per_independent_error, 1.0, 1e6)?;
        ConfigError::check("odometry.minimum_points", self.minimum_points as f64, 20.0, 1e6)?;
        ConfigError::check("odometry.minimum_score", self.minimum_score, 0.0, 1.0)?;
        ConfigError::check("odometry.search_radius_m", self.search_radius_m, 0.0, 50.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_toml() {
        let config = OdometryConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<OdometryConfig>(&text).unwrap(), config);
    }

    #[test]
    fn a_field_out_of_range_is_refused_by_name() {
        let config = OdometryConfig { voxel_m: f64::NAN, ..OdometryConfig::default() };
        assert_eq!(config.validate().unwrap_err().field, "odometry.voxel_m");
        assert!(toml::from_str::<OdometryConfig>("voxels = 1").is_err());
    }
}
