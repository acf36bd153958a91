//! Configuration of the gateway.

use serde::{Deserialize, Serialize};

/// Where viewers find the run, and how much they are sent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GatewayConfig {
    /// TCP port on 127.0.0.1; 0 takes one that is free and says which in the service's health.
    pub port: u16,
    /// Most points of a scan.
    pub points: usize,
    /// Drawings that wait for a client; the oldest give way.
    pub backlog: usize,
}

impl Default for GatewayConfig {
    fn default() -> Self {
        Self { port: 8765, points: 100_000, backlog: 64 }
    }
}

impl GatewayConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The text names the key, its value and its range.
    pub fn validate(&self) -> Result<(), String> {
        let range = |field, value: usize, least: usize, most: usize| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!("gateway.{field} = {value} is outside {least} to {most}"))
            }
        };
        range("points", self.points, 1, 10_000_000)?;
        // A client that comes late is sent every channel at once.
        range("backlog", self.backlog, 32, 4096)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_survives_toml() {
        let config = GatewayConfig::default();
        config.validate().unwrap();
        assert_eq!(toml::from_str::<GatewayConfig>(&toml::to_string(&config).unwrap()).unwrap(), config);
    }

    #[test]
    fn a_value_out_of_range_names_its_field_and_an_unknown_key_is_refused() {
        let config = GatewayConfig { backlog: 3, ..GatewayConfig::default() };
        assert!(config.validate().unwrap_err().contains("gateway.backlog = 3"));
        assert!(toml::from_str::<GatewayConfig>("host = \"0.0.0.0\"").is_err());
        assert!(toml::from_str::<GatewayConfig>("port = 70000").is_err());
    }
}
