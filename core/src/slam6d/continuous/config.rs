//! The settings of continuous alignment.

use serde::{Deserialize, Serialize};

use crate::odometry::{KeyframeConfig, OdometryConfig};
use crate::registration::{ConfigError, global};

/// How a scanner that is lost is found again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelocalisationConfig {
    /// Look for the scanner among the keyframes when so many frames in a row are lost.
    pub after_frames: u32,
    /// Keyframes that a lost frame is compared with, those first that look most alike; the next frame goes on with those
    /// behind. 0 switches it off.
    pub keyframes_per_frame: usize,
    /// Keyframes around the place found of which the local map is made anew.
    pub map_keyframes: usize,
    /// The search.
    pub search: global::GlobalConfig,
}

impl Default for RelocalisationConfig {
    fn default() -> Self {
        Self { after_frames: 2, keyframes_per_frame: 2, map_keyframes: 12, search: global::GlobalConfig::default() }
    }
}

impl RelocalisationConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("relocalisation.after_frames", f64::from(self.after_frames), 1.0, 1e6)?;
        ConfigError::check("relocalisation.keyframes_per_frame", self.keyframes_per_frame as f64, 0.0, 12.0)?;
        ConfigError::check("relocalisation.map_keyframes", self.map_keyframes as f64, 1.0, 1e3)?;
        self.search.validate().map_err(|error| ConfigError { field: search_field(error.field), ..error })
    }
}

/// Where a setting of the search stands here.
fn search_field(field: &'static str) -> &'static str {
    match field {
        "global.threads" => "relocalisation.search.threads",
        "global.feature_radius_m" => "relocalisation.search.feature_radius_m",
        "global.keypoints" => "relocalisation.search.keypoints",
        "global.consistency_m" => "relocalisation.search.consistency_m",
        "global.consistency_cosine" => "relocalisation.search.consistency_cosine",
        "global.seeds" => "relocalisation.search.seeds",
        "global.hypotheses" => "relocalisation.search.hypotheses",
        other => other,
    }
}

/// The settings of continuous alignment, beside those of the map.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContinuousConfig {
    /// Scan to local map.
    pub odometry: OdometryConfig,
    /// Which frames are keyframes.
    pub keyframes: KeyframeConfig,
    /// What happens when the odometry is lost.
    pub relocalisation: RelocalisationConfig,
}

impl ContinuousConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.odometry.validate()?;
        self.keyframes.validate()?;
        self.relocalisation.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_out_of_range_is_refused_by_the_name_it_has_here() {
        RelocalisationConfig::default().validate().unwrap();
        let search = global::GlobalConfig { keypoints: 1, ..global::GlobalConfig::default() };
        let error = RelocalisationConfig { search, ..RelocalisationConfig::default() }.validate().unwrap_err();
        assert_eq!(error.field, "relocalisation.search.keypoints");
    }
}
