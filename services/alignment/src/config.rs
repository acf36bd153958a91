//! How scans are aligned.

use mirador_core::registration::{ConfigError, RegistrationConfig, Registry, RegistryError};
use mirador_core::slam6d::SequentialConfig;
use serde::{Deserialize, Serialize};

/// How scans are aligned.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// Name of the registration method.
    pub registration: String,
    /// Settings of the method. Its `threads` are those of the service.
    pub method: RegistrationConfig,
    /// Which target, how far from the guess, and what is accepted.
    pub sequential: SequentialConfig,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            registration: "gicp".into(),
            method: RegistrationConfig::default(),
            sequential: SequentialConfig::default(),
        }
    }
}

impl AlignmentConfig {
    /// Checks every value but the name of the method.
    ///
    /// # Errors
    /// Names the first value that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.method.validate()?;
        self.sequential.validate()
    }

    /// Checks the name of the method.
    ///
    /// # Errors
    /// Lists the names there are.
    pub fn check(&self, registry: &Registry) -> Result<(), RegistryError> {
        registry.create(&self.registration, &self.method).map(|_| ())
    }
}
