//! How scans are aligned.

use mirador_core::odometry::{KeyframeConfig, OdometryConfig};
use mirador_core::registration::{ConfigError, RegistrationConfig, Registry, RegistryError};
use mirador_core::slam6d::SequentialConfig;
use mirador_core::slam6d::continuous::{ContinuousConfig, RelocalisationConfig};
use mirador_core::slam6d::global::GlobalConfig;
use serde::{Deserialize, Serialize};

use crate::ExternalConfig;

/// What a scan is aligned to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AlignmentMode {
    /// The last accepted scan: for scans that are taken standing.
    #[default]
    Scan,
    /// The local map of an odometry: for scanners in motion.
    Continuous,
}

/// How scans are aligned.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// What a scan is aligned to.
    pub mode: AlignmentMode,
    /// Name of the registration method; `external` asks another process.
    pub registration: String,
    /// Which process, and what happens when its answer is wrong, late or absent.
    pub external: ExternalConfig,
    /// Older scans are corrected after the plan of the newest, which then has the cores to itself. Switched off in a
    /// graph without planning.
    pub correct_after_plan: bool,
    /// They are corrected without it when the plan has not come after this time [ms].
    pub plan_patience_ms: u32,
    /// Settings of the method. Its `threads` are those of the service.
    pub method: RegistrationConfig,
    /// Which target, how far from the guess, and what is accepted.
    pub sequential: SequentialConfig,
    /// Loop closing and the correction of older scans.
    pub global: GlobalConfig,
    /// `continuous`: scan to local map. Its `threads` are those of the service.
    pub odometry: OdometryConfig,
    /// `continuous`: which scans are nodes of the map.
    pub keyframes: KeyframeConfig,
    /// `continuous`: what happens when the odometry is lost.
    pub relocalisation: RelocalisationConfig,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            mode: AlignmentMode::Scan,
            registration: "gicp".into(),
            external: ExternalConfig::default(),
            correct_after_plan: true,
            plan_patience_ms: 1000,
            method: RegistrationConfig::default(),
            sequential: SequentialConfig::default(),
            global: GlobalConfig::default(),
            odometry: OdometryConfig::default(),
            keyframes: KeyframeConfig::default(),
            relocalisation: RelocalisationConfig::default(),
        }
    }
}

impl AlignmentConfig {
    /// Checks every value but the name of the method.
    ///
    /// # Errors
    /// Names the first value that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("plan_patience_ms", f64::from(self.plan_patience_ms), 0.0, 60_000.0)?;
        self.external.validate()?;
        self.method.validate()?;
        self.sequential.validate()?;
        self.global.validate()?;
        self.odometry.validate()?;
        self.keyframes.validate()?;
        self.relocalisation.validate()
    }

    /// The settings of the continuous mode, with this number of threads.
    #[must_use]
    pub fn continuous(&self, threads: usize) -> ContinuousConfig {
        let (mut odometry, mut relocalisation) = (self.odometry.clone(), self.relocalisation.clone());
        (odometry.threads, relocalisation.search.threads) = (threads, threads);
        ContinuousConfig { odometry, keyframes: self.keyframes.clone(), relocalisation }
    }

    /// Whether another process is asked.
    #[must_use]
    pub fn is_external(&self) -> bool {
        self.registration == crate::EXTERNAL
    }

    /// Name of the method that is called in this process: it takes the place of another one's that fails.
    #[must_use]
    pub fn own_method(&self) -> &str {
        if self.is_external() { &self.external.fallback } else { &self.registration }
    }

    /// Checks the name of the method.
    ///
    /// # Errors
    /// Lists the names there are.
    pub fn check(&self, registry: &Registry) -> Result<(), RegistryError> {
        registry.create(self.own_method(), &self.method).map(|_| ())
    }
}
