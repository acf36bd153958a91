//! How points are scored.

use mirador_core::analysis::{ScoreConfig, ZoneConfig};
use mirador_core::surface::SurfaceConfig;
use serde::{Deserialize, Serialize};

/// How points are scored.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct AnalysisConfig {
    /// Mesh, normals, areas, quality. Its `threads` are those of the service.
    pub surface: SurfaceConfig,
    /// Navigable surface and obstacles. Its `threads` are those of the service.
    pub scores: ScoreConfig,
    /// Zones of interest.
    pub zones: ZoneConfig,
}

impl AnalysisConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), String> {
        self.surface.validate().map_err(|e| format!("analysis.{e}"))?;
        self.scores.validate().map_err(|e| format!("analysis.scores.{e}"))?;
        self.zones.validate().map_err(|e| format!("analysis.zones.{e}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_value_is_named_by_its_key_in_the_graph_file() {
        let mut config = AnalysisConfig::default();
        config.scores.theta_deg = 90.0;
        assert_eq!(config.validate().unwrap_err(), "analysis.scores.theta_deg = 90: allowed is 1 to 60");
        let mut config = AnalysisConfig::default();
        config.surface.gamma_max = 0.5;
        assert_eq!(config.validate().unwrap_err(), "analysis.surface.gamma_max = 0.5: allowed is >= 1");
        let mut config = AnalysisConfig::default();
        config.zones.zone_area_min_m2 = -1.0;
        assert_eq!(config.validate().unwrap_err(), "analysis.zones.zone_area_min_m2 = -1: allowed is >= 0");
    }
}
