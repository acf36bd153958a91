//! How the map is kept and the next view chosen.

use mirador_core::information_map::{InformationMap, MapConfig, MoveConfig, ZoneConfig};
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
    /// How the map follows corrected poses.
    pub corrections: CorrectionConfig,
    /// What candidates are drawn from.
    pub seed: u64,
}

/// How the map follows corrected poses.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct CorrectionConfig {
    /// How far a pose must be off before its scan is moved in the map.
    pub limits: MoveConfig,
    /// A scan counts as finished once alignment has said what came of older scans after it. Switched off in a graph
    /// whose alignment is foreign.
    pub awaited: bool,
    /// It counts as finished without when that has not come after this time [ms].
    pub patience_ms: u32,
    /// All moves are done before the next scan is taken in, as lockstep asks for. Else a new scan goes first, and the
    /// rest is moved after its plan. Switched off in a graph whose scans are released by time.
    pub before_next_scan: bool,
}

impl Default for CorrectionConfig {
    fn default() -> Self {
        Self { limits: MoveConfig::default(), awaited: true, patience_ms: 20_000, before_next_scan: true }
    }
}

impl PlanningServiceConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), String> {
        InformationMap::new(self.map).map_err(|e| format!("planning.map: {e}"))?;
        self.corrections.limits.validate().map_err(|e| format!("planning.corrections.limits: {e}"))?;
        let patience = self.corrections.patience_ms;
        if patience > 600_000 {
            return Err(format!("planning.corrections.patience_ms = {patience} is not allowed; give 0 to 600000"));
        }
        self.view.validate().map_err(|e| format!("planning.view: {e}"))?;
        StrategyRegistry::default().create(&self.view.strategy).map_err(|e| format!("planning.view.strategy: {e}"))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wrong_value_is_named() {
        PlanningServiceConfig::default().validate().unwrap();
        let wrong = |change: fn(&mut PlanningServiceConfig)| {
            let mut config = PlanningServiceConfig::default();
            change(&mut config);
            config.validate().unwrap_err()
        };
        assert!(wrong(|c| c.map.cell_m = 0.0).contains("cell_m = 0 is not allowed; give 0.1 to 1 m"));
        assert!(wrong(|c| c.map.clearance_m = 0.0).contains("clearance_m"));
        assert!(wrong(|c| c.corrections.limits.min_shift_m = f64::NAN).contains("corrections.limits: min_shift_m"));
        assert!(wrong(|c| c.corrections.patience_ms = 1_000_000).contains("corrections.patience_ms"));
        assert!(
            wrong(|c| c.view.weights.quality = -0.1).contains("weights.quality = -0.1 is not allowed; give 0 to 1")
        );
        let nothing = |c: &mut PlanningServiceConfig| {
            let weights = &mut c.view.weights;
            (weights.information, weights.quality, weights.zones) = (0.0, 0.0, 0.0);
        };
        assert!(wrong(nothing).contains("are all 0; give at least one a value"));
        assert!(wrong(|c| c.view.strategy = "fronteer".into()).contains("planning.view.strategy"));
    }
}
