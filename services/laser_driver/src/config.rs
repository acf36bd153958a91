//! Which device is spoken to, and how long it may be silent.

use serde::{Deserialize, Serialize};

/// Which device is spoken to, and how long it may be silent.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct LaserDriverConfig {
    /// Host and port of the device; LMS1xx listen on 2111.
    pub address: String,
    /// Longest range of the device [m].
    pub range_max_m: f64,
    /// A device that says nothing for this long counts as gone [s].
    pub silence_s: f64,
    /// Between two tries to connect [s].
    pub retry_s: f64,
}

impl Default for LaserDriverConfig {
    fn default() -> Self {
        Self { address: "192.168.0.1:2111".into(), range_max_m: 50.0, silence_s: 0.5, retry_s: 1.0 }
    }
}

/// A value of the table `laser_driver` is wrong.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LaserDriverConfigError {
    /// A number is outside its range.
    #[error("laser_driver.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// The address is not of the form HOST:PORT.
    #[error("laser_driver.address = '{0}' is not HOST:PORT, for example 192.168.0.1:2111")]
    Address(String),
}

impl LaserDriverConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), LaserDriverConfigError> {
        let has_port = self
            .address
            .rsplit_once(':')
            .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0));
        if !has_port {
            return Err(LaserDriverConfigError::Address(self.address.clone()));
        }
        let checks = [
            ("range_max_m", self.range_max_m, 0.1..=1000.0, "0.1 to 1000"),
            ("silence_s", self.silence_s, 0.05..=60.0, "0.05 to 60"),
            ("retry_s", self.retry_s, 0.01..=60.0, "0.01 to 60"),
        ];
        for (field, value, range, allowed) in checks {
            if !range.contains(&value) {
                return Err(LaserDriverConfigError::OutOfRange { field, value, allowed });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_every_wrong_value_is_named() {
        let default = LaserDriverConfig::default();
        default.validate().unwrap();
        for address in ["", "host", "host:", ":2111", "host:0", "host:70000"] {
            let config = LaserDriverConfig { address: address.into(), ..default.clone() };
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(&format!("'{address}'")) && error.contains("HOST:PORT"), "{error}");
        }
        let config = LaserDriverConfig { silence_s: f64::NAN, ..default };
        assert!(config.validate().unwrap_err().to_string().contains("laser_driver.silence_s"));
    }
}
