//! How far and how long an alignment may go.

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// The limits of one alignment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Most steps taken; 0 only judges the start.
    pub max_iterations: u32,
    /// The farthest partner a point may have at the start [m]. It shrinks to `final_pair_distance_m` of the method's
    /// configuration as the steps get smaller.
    pub pair_distance_m: f64,
    /// d_max of the source (section 3, step 3): the result lies no farther than this from the start [m].
    pub max_translation_m: f64,
    /// The result is turned no farther than this from the start [rad].
    pub max_rotation: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_iterations: 80, pair_distance_m: 2.0, max_translation_m: 4.0, max_rotation: 0.6 }
    }
}

impl Limits {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("limits.max_iterations", f64::from(self.max_iterations), 0.0, 10_000.0)?;
        ConfigError::check("limits.pair_distance_m", self.pair_distance_m, 1e-3, 100.0)?;
        ConfigError::check("limits.max_translation_m", self.max_translation_m, 0.0, 1e4)?;
        ConfigError::check("limits.max_rotation", self.max_rotation, 0.0, std::f64::consts::PI)
    }
}
