//! Our way of mapping scan after scan: the pair, then loops and the correction of older scans. The one place to change
//! when it is done in another way.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mirador_core::geometry::Pose;
use mirador_core::registration::{
    AlignError, Alignment, Limits, PairIds, PreparationConfig, PrepareError, PreparedScan, Registration, Registry,
};
use mirador_core::scan::ScanView;
use mirador_core::slam6d::SequentialConfig;
use mirador_core::slam6d::global::{CorrectionMethod, GlobalAligner, GlobalConfig, PairKind};

use super::RegistrationBenchError;
use super::data::SequenceData;
use super::ours::create;

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

/// What one scan took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Everything [ms].
    pub ms: f64,
    /// Preparing the scan [ms].
    pub prepare_ms: f64,
    /// The rest of the pair, after which its pose is published [ms].
    pub align_ms: f64,
    /// Overlaps, loops and the correction of older scans [ms].
    pub correction_ms: f64,
    /// Whether a loop was tried.
    pub tried_loop: bool,
}

impl Step {
    /// The phases by name [ms].
    pub fn parts(&self) -> BTreeMap<String, f64> {
        [("prepare", self.prepare_ms), ("align", self.align_ms), ("correction", self.correction_ms)]
            .map(|(name, ms)| (name.to_owned(), ms))
            .into()
    }
}

/// Maps scan after scan, with the clock on.
pub(super) struct Mapper {
    aligner: GlobalAligner,
    clock: Arc<PhaseClock>,
    /// The pose of each scan as first published.
    published: Vec<Pose>,
}

impl Mapper {
    /// With the settings that users get, apart from how older scans are corrected.
    pub fn new(
        registry: &Registry,
        method: &str,
        threads: usize,
        correction: CorrectionMethod,
    ) -> Result<Self, RegistrationBenchError> {
        let clock = Arc::new(PhaseClock::default());
        let timed = Timed { inner: create(registry, method, threads)?, clock: Arc::clone(&clock) };
        let config = GlobalConfig { method: correction, ..GlobalConfig::default() };
        let spacing_m = PreparationConfig::default().voxel_m;
        let aligner = GlobalAligner::new(Box::new(timed), SequentialConfig::default(), config, spacing_m)?;
        Ok(Self { aligner, clock, published: Vec::new() })
    }

    /// The next scan: its pair at once, then all that is due about older ones.
    pub fn step(&mut self, scan: ScanView<'_>, prior: Option<Pose>) -> Step {
        let [prepare_before, _] = self.clock.now();
        let begin = Instant::now();
        let record = self.aligner.align_next(self.published.len() as u64, scan, prior);
        let aligned = Instant::now();
        let prepare_ms = self.clock.now()[0] - prepare_before;
        let mut tried_loop = false;
        while self.aligner.is_correction_due() {
            let Some(correction) = self.aligner.correct(&|| false) else { break };
            tried_loop |= correction.pairs.iter().any(|pair| pair.kind == PairKind::Loop);
        }
        let end = Instant::now();
        self.published.push(record.map_from_scanner);
        let ms = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
        Step {
            ms: ms(begin, end),
            prepare_ms,
            align_ms: ms(begin, aligned) - prepare_ms,
            correction_ms: ms(aligned, end),
            tried_loop,
        }
    }

    /// The pose of each scan as known now; as first published where it is not in the map.
    pub fn poses(&self) -> Vec<Pose> {
        let mut poses = self.published.clone();
        for (scan_id, pose) in self.aligner.poses() {
            if let Some(known) = usize::try_from(scan_id).ok().and_then(|scan| poses.get_mut(scan)) {
                *known = *pose;
            }
        }
        poses
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        self.aligner.bytes()
    }
}

/// A whole sequence with priors.
pub(super) fn align_sequence(
    registry: &Registry,
    method: &str,
    threads: usize,
    correction: CorrectionMethod,
    data: &SequenceData,
) -> Result<SequenceRun, RegistrationBenchError> {
    let mut mapper = Mapper::new(registry, method, threads, correction)?;
    let (mut each_ms, mut parts) = (Vec::with_capacity(data.scans.len()), BTreeMap::new());
    for (k, scan) in data.scans.iter().enumerate() {
        let step = mapper.step(ScanView::unordered(scan), data.priors.get(k).copied());
        each_ms.push(step.ms);
        for (name, ms) in step.parts() {
            *parts.entry(name).or_insert(0.0) += ms;
        }
    }
    Ok(SequenceRun { each_ms, parts, poses: mapper.poses() })
}

/// The time spent in each call of a method [ns].
#[derive(Debug, Default)]
struct PhaseClock {
    prepare: AtomicU64,
    align: AtomicU64,
}

impl PhaseClock {
    /// Time of both calls so far [ms].
    fn now(&self) -> [f64; 2] {
        [&self.prepare, &self.align].map(|ns| ns.load(Ordering::Relaxed) as f64 / 1e6)
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

    fn name_pair(&mut self, pair: PairIds) {
        self.inner.name_pair(pair);
    }
}
