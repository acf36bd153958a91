//! What the information map needs to know before its first scan.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings of an information map; fixed for the life of a map, since its counts depend on them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// Side of a cell [m], 0.1 to 1.
    pub cell_m: f64,
    /// u_F: a point counts as navigable when F exceeds this, 0 to 1.
    pub navigable_threshold: f32,
    /// u_B: a point counts as an obstacle when B exceeds this, 0 to 1.
    pub obstacle_threshold: f32,
    /// How many navigable points outweigh one obstacle point in r (4.3), 1 to 100. 1 is the literal formula.
    pub obstacle_weight: f64,
    /// A kept triangle gives interpolated evidence to at most this many cells, 1 to 65,536.
    pub max_cells_per_triangle: usize,
    /// Free height in which the robot passes under something [m], 0.5 to 100: what hangs higher over the ground does
    /// not block it, and what can be driven on there is a level of its own.
    pub clearance_m: f64,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.3,
            navigable_threshold: 0.65,
            obstacle_threshold: 0.83,
            obstacle_weight: 3.0,
            max_cells_per_triangle: 256,
            clearance_m: 1.2,
        }
    }
}

/// Why a map's settings are refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MapConfigError {
    /// A number lies outside its range or is not finite.
    #[error("information map: {field} = {value} is not allowed; give {allowed}")]
    OutOfRange {
        /// The field's name in the config.
        field: &'static str,
        /// What was given.
        value: f64,
        /// The allowed range, with units.
        allowed: &'static str,
    },
}

impl MapConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the first field that lies outside its range.
    pub fn validate(&self) -> Result<(), MapConfigError> {
        let check = |inside: bool, field, value, allowed| {
            if inside { Ok(()) } else { Err(MapConfigError::OutOfRange { field, value, allowed }) }
        };
        let (f, b) = (f64::from(self.navigable_threshold), f64::from(self.obstacle_threshold));
        check((0.1..=1.0).contains(&self.cell_m), "cell_m", self.cell_m, "0.1 to 1 m")?;
        check((0.0..1.0).contains(&f), "navigable_threshold", f, "0 to 1, 1 excluded")?;
        check((0.0..1.0).contains(&b), "obstacle_threshold", b, "0 to 1, 1 excluded")?;
        check((1.0..=100.0).contains(&self.obstacle_weight), "obstacle_weight", self.obstacle_weight, "1 to 100")?;
        let cells = self.max_cells_per_triangle;
        check((1..=65_536).contains(&cells), "max_cells_per_triangle", cells as f64, "1 to 65536")?;
        check((0.5..=100.0).contains(&self.clearance_m), "clearance_m", self.clearance_m, "0.5 to 100 m")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_survive_a_config_file() {
        let config = MapConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<MapConfig>(&text).unwrap(), config);
        assert!(toml::from_str::<MapConfig>("cellm = 0.3").is_err());
    }

    #[test]
    fn a_field_outside_its_range_is_named() {
        for cell_m in [0.0, 1.5, f64::NAN] {
            let message = MapConfig { cell_m, ..Default::default() }.validate().unwrap_err().to_string();
            assert!(message.contains("cell_m") && message.contains("0.1 to 1 m"), "{message}");
        }
        assert!(MapConfig { obstacle_weight: 0.0, ..Default::default() }.validate().is_err());
        assert!(MapConfig { clearance_m: 0.3, ..Default::default() }.validate().is_err());
        assert!(MapConfig { max_cells_per_triangle: 0, ..Default::default() }.validate().is_err());
    }
}
