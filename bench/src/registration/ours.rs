//! Our methods, with the settings that users get unless they change them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mirador_core::geometry::Pose;
use mirador_core::registration::{
    AlignError, Alignment, Limits, PrepareError, PreparedScan, Registration, RegistrationConfig, Registry,
    RegistryError,
};
use mirador_core::scan::ScanView;
use mirador_core::slam6d::{SequentialAligner, SequentialConfig};

use super::RegistrationBenchError;
use super::contest::{Contestant, Sample};
use super::data::{PairData, SequenceData};

/// The method that the alignment service uses unless told otherwise.
pub(super) const DEFAULT_METHOD: &str = "point_to_plane";

fn create(registry: &Registry, method: &str, threads: usize) -> Result<Box<dyn Registration>, RegistryError> {
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

/// What one run over a sequence gave.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SequenceRun {
    /// The time of each scan [ms].
    pub each_ms: Vec<f64>,
    /// The share of each phase, over all scans [ms].
    pub parts: BTreeMap<String, f64>,
    /// `map_from_scanner`, one a scan.
    pub poses: Vec<Pose>,
}

/// Our whole way of aligning a sequence with priors. The one place to change when it is done in another way.
pub(super) fn align_sequence(
    registry: &Registry,
    method: &str,
    threads: usize,
    data: &SequenceData,
) -> Result<SequenceRun, RegistrationBenchError> {
    let clock = Arc::new(PhaseClock::default());
    let timed = Timed { inner: create(registry, method, threads)?, clock: Arc::clone(&clock) };
    let mut aligner = SequentialAligner::new(Box::new(timed), SequentialConfig::default())?;
    let mut each_ms = Vec::with_capacity(data.scans.len());
    for (k, scan) in data.scans.iter().enumerate() {
        let begin = Instant::now();
        aligner.align_next(k as u64, ScanView::unordered(scan), data.priors.get(k).copied());
        each_ms.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    let poses = aligner.state().trajectory.iter().map(|entry| entry.map_from_scanner).collect();
    Ok(SequenceRun { each_ms, parts: clock.parts(), poses })
}

/// The time spent in each call of a method [ns].
#[derive(Debug, Default)]
struct PhaseClock {
    prepare: AtomicU64,
    align: AtomicU64,
}

impl PhaseClock {
    fn parts(&self) -> BTreeMap<String, f64> {
        let ms = |ns: &AtomicU64| ns.load(Ordering::Relaxed) as f64 / 1e6;
        BTreeMap::from([("prepare".into(), ms(&self.prepare)), ("align".into(), ms(&self.align))])
    }
}

/// A method whose calls are timed; otherwise it is the method itself.
struct Timed {
    inner: Box<dyn Registration>,
    clock: Arc<PhaseClock>,
}

impl Timed {
    fn add(total: &AtomicU64, begin: Instant) {
        total.fetch_add(u64::try_from(begin.elapsed().as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

impl Registration for Timed {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        let begin = Instant::now();
        let result = self.inner.prepare(scan);
        Self::add(&self.clock.prepare, begin);
        result
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let begin = Instant::now();
        let result = self.inner.align(target, source, initial_target_from_source, limits);
        Self::add(&self.clock.align, begin);
        result
    }
}
