//! How the map is kept and the next view chosen.

use mirador_core::information_map::{InformationMap, MapConfig, ZoneConfig};
use mirador_core::view_planning::{PlanningConfig, StrategyRegistry};
use serde::{Deserialize, Serialize};

/// How the map is kept and the next view chosen.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanningServiceConfig {
    /// The information map.
    pub map: MapConfig,
    /// Zones of interest over several scans.
    pub zones: ZoneConfig,
    /// Candidates, their value, and the stop rule.
    pub view: PlanningConfig,
    /// What candidates are drawn from.
    pub seed: u64,
}

impl PlanningServiceConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), String> {
        InformationMap::new(self.map).map_err(|e| format!("planning.map: {e}"))?;
        self.view.validate().map_err(|e| format!("planning.view: {e}"))?;
        StrategyRegistry::default().create(&self.view.strategy).map_err(|e| format!("planning.view.strategy: {e}"))?;
        Ok(())
    }
}
