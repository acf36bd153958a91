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
        self.surface.validate().map_err(|e| format!("analysis.surface: {e}"))?;
        self.scores.validate().map_err(|e| format!("analysis.scores: {e}"))?;
        self.zones.validate().map_err(|e| format!("analysis.zones: {e}"))
    }
}
