//! Our methods, with the settings that users get unless they change them.

use std::collections::BTreeMap;
use std::time::Instant;

use mirador_core::geometry::Pose;
use mirador_core::registration::{Limits, Registration, RegistrationConfig, Registry, RegistryError};
use mirador_core::scan::ScanView;

use super::RegistrationBenchError;
use super::contest::{Contestant, Sample};
use super::data::PairData;

/// The method that the alignment service uses unless told otherwise.
pub(super) const DEFAULT_METHOD: &str = "gicp";

/// The method with the settings that users get.
pub(super) fn create(
    registry: &Registry,
    method: &str,
    threads: usize,
) -> Result<Box<dyn Registration>, RegistryError> {
    registry.create(method, &RegistrationConfig { threads, ..RegistrationConfig::default() })
}

/// One of our methods on a pair.
pub(super) struct OurPair<'a> {
    method: String,
    registration: Box<dyn Registration>,
    data: &'a PairData,
}

impl<'a> OurPair<'a> {
    pub fn new(
        registry: &Registry,
        method: &str,
        threads: usize,
        data: &'a PairData,
    ) -> Result<Self, RegistrationBenchError> {
        Ok(Self { method: method.to_owned(), registration: create(registry, method, threads)?, data })
    }
}

impl Contestant for OurPair<'_> {
    fn label(&self) -> String {
        format!("{} on {}", self.method, self.data.name)
    }

    fn run(&mut self) -> Result<Sample, String> {
        let begin = Instant::now();
        let target = self.registration.prepare(ScanView::unordered(&self.data.target)).map_err(|e| e.to_string())?;
        let target_ready = Instant::now();
        let source = self.registration.prepare(ScanView::unordered(&self.data.source)).map_err(|e| e.to_string())?;
        let source_ready = Instant::now();
        let result = self.registration.align(&*target, &*source, &Pose::identity(), &Limits::default());
        let end = Instant::now();
        let alignment = result.map_err(|e| e.to_string())?;
        let ms = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
        Ok(Sample {
            ms: ms(begin, end),
            parts: BTreeMap::from([
                ("prepare_target".into(), ms(begin, target_ready)),
                ("prepare_source".into(), ms(target_ready, source_ready)),
                ("align".into(), ms(source_ready, end)),
            ]),
            pose: alignment.target_from_source,
            iterations: Some(u64::from(alignment.iterations)),
            overlap: Some(alignment.overlap),
        })
    }
}
