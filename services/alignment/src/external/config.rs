//! Whom to ask, and how long to wait.

use std::time::Duration;

use mirador_core::registration::ConfigError;
use serde::{Deserialize, Serialize};

/// Settings of `registration = "external"`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExternalConfig {
    /// The program of the graph (`[programs.NAME]`) that answers; its end does not end the run. Empty when it is started
    /// by somebody else.
    pub program: String,
    /// The method that prepares scans, judges answers, and takes the place of one that is wrong, late or absent.
    pub fallback: String,
    /// An answer is worthless after this time [ms].
    pub deadline_ms: u32,
    /// At its start alignment waits so long for the process to be there [ms].
    pub start_timeout_ms: u32,
}

impl Default for ExternalConfig {
    fn default() -> Self {
        Self { program: "registration".into(), fallback: "gicp".into(), deadline_ms: 1000, start_timeout_ms: 10_000 }
    }
}

impl ExternalConfig {
    /// How long the process is waited for at the start.
    pub(crate) fn patience(&self) -> Duration {
        Duration::from_millis(self.start_timeout_ms.into())
    }

    /// Checks every value but the names.
    ///
    /// # Errors
    /// Names the first value that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("external.deadline_ms", f64::from(self.deadline_ms), 1.0, 600_000.0)?;
        ConfigError::check("external.start_timeout_ms", f64::from(self.start_timeout_ms), 0.0, 600_000.0)
    }
}
