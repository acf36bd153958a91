//! A foreign registration without the service around it, to be measured beside others: at what it does not answer well it has
//! failed, and nobody takes its place.

use mirador_core::geometry::Pose;
use mirador_core::registration::{
    AlignError, Alignment, Limits, PairIds, PrepareError, PreparedScan, Registration, RegistrationConfig, Registry,
};
use mirador_core::scan::ScanView;
use mirador_ipc_schema::{Participant, text};
use mirador_service_common::ServiceError;

use super::{External, Link, NAME, Rules, Tally};
use crate::AlignmentConfig;

/// A process that registers, asked pair by pair. Preparing scans and judging answers is the fallback method's, as in a run.
pub struct ForeignRegistration {
    external: External,
    tally: Tally,
}

impl ForeignRegistration {
    /// Waits until the process is there, for as long as alignment would at its start.
    ///
    /// # Errors
    /// When the fallback cannot be had, the topics cannot be opened, or nobody has come in time.
    pub fn open(
        participant: &Participant,
        config: &AlignmentConfig,
        threads: usize,
        registry: &Registry,
    ) -> Result<Self, ServiceError> {
        let settings = RegistrationConfig { threads, ..config.method.clone() };
        let fallback = registry.create(&config.external.fallback, &settings);
        let fallback = fallback.map_err(|e| ServiceError::Config(format!("alignment.external.fallback: {e}")))?;
        let tally = Tally::new(fallback.name());
        let link = Link::open(participant, config.external.deadline_ms)?;
        if !link.wait_for_somebody(config.external.patience(), || ()) {
            let ms = config.external.start_timeout_ms;
            return Err(ServiceError::Work(format!("no external registration has come within {ms} ms")));
        }
        Ok(Self { external: External::new(fallback, link, tally.clone(), Rules::of(config)), tally })
    }
}

impl Registration for ForeignRegistration {
    fn name(&self) -> &str {
        NAME
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        self.external.prepare(scan)
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let alignment = self.external.align(target, source, initial_target_from_source, limits)?;
        if self.tally.last_method() == NAME {
            return Ok(alignment);
        }
        // Every pair is asked about: who fails is not spared the next ones.
        self.external.link.forgive();
        let reason = text::unpack(&self.tally.status().last_fault).to_owned();
        Err(AlignError::Method { method: NAME.into(), reason })
    }

    fn name_pair(&mut self, pair: PairIds) {
        self.external.name_pair(pair);
    }
}
