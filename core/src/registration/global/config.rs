//! The settings of alignment without a prior.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;

/// The settings of [`super::GlobalAligner`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GlobalConfig {
    /// Worker threads; results do not depend on it.
    pub threads: usize,
    /// A keypoint is described by the surface within this distance [m].
    pub feature_radius_m: f64,
    /// Keypoints kept of a scan.
    pub keypoints: usize,
    /// Distances between keypoints may differ by so much between the scans [m].
    pub consistency_m: f64,
    /// Cosines of angles between normals may differ by so much.
    pub consistency_cosine: f64,
    /// Matches from which sets of agreeing matches are grown.
    pub seeds: usize,
    /// Poses that are followed up.
    pub hypotheses: usize,
}

impl Default for GlobalConfig {
    fn default() -> Self {
        Self {
            threads: 2,
            feature_radius_m: 2.5,
            keypoints: 1200,
            consistency_m: 0.5,
            consistency_cosine: 0.25,
            seeds: 24,
            hypotheses: 8,
        }
    }
}

impl GlobalConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("global.threads", self.threads as f64, 1.0, 256.0)?;
        ConfigError::check("global.feature_radius_m", self.feature_radius_m, 0.1, 50.0)?;
        // All pairs of matches are compared.
        ConfigError::check("global.keypoints", self.keypoints as f64, 10.0, 10_000.0)?;
        ConfigError::check("global.consistency_m", self.consistency_m, 0.01, 10.0)?;
        ConfigError::check("global.consistency_cosine", self.consistency_cosine, 0.01, 2.0)?;
        ConfigError::check("global.seeds", self.seeds as f64, 1.0, 1000.0)?;
        ConfigError::check("global.hypotheses", self.hypotheses as f64, 1.0, 1000.0)
    }
}
