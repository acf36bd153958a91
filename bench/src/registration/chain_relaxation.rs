//! A sequence aligned pair by pair, then relaxed as a whole: every scan against all that overlap it, the source's way.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use mirador_core::registration::{PreparationConfig, PreparedCloud, PreparedScan, Registry};
use mirador_core::scan::ScanView;
use mirador_core::slam6d::relaxation::{RelaxationConfig, relax};
use mirador_core::slam6d::{SequentialAligner, SequentialConfig};

use super::RegistrationBenchError;
use super::data::SequenceData;
use super::mapper::SequenceRun;
use super::ours::create;

/// The chain with the given method and the relaxation of all its scans. `None` when a scan was not aligned, or when the
/// method keeps its scans in a form of its own, which relaxation cannot read.
pub(super) fn align_and_relax(
    registry: &Registry,
    method: &str,
    threads: usize,
    data: &SequenceData,
) -> Result<Option<SequenceRun>, RegistrationBenchError> {
    let spacing_m = PreparationConfig::default().voxel_m;
    let registration = create(registry, method, threads)?;
    let mut aligner = SequentialAligner::new(registration, SequentialConfig::default(), spacing_m)?;
    let (mut each_ms, mut poses) = (Vec::with_capacity(data.scans.len()), Vec::with_capacity(data.scans.len()));
    let mut keyframes: Vec<Arc<dyn PreparedScan>> = Vec::with_capacity(data.scans.len());
    for (k, scan) in data.scans.iter().enumerate() {
        let begin = Instant::now();
        let record = aligner.align_next(k as u64, ScanView::unordered(scan), data.priors.get(k).copied());
        each_ms.push(milliseconds(begin));
        poses.push(record.map_from_scanner);
        match aligner.keyframe() {
            Some(keyframe) if record.is_accepted() => keyframes.push(Arc::clone(keyframe)),
            _ => return Ok(None),
        }
    }
    let begin = Instant::now();
    let clouds: Option<Vec<&PreparedCloud>> = keyframes.iter().map(|scan| scan.as_any().downcast_ref()).collect();
    let Some(clouds) = clouds else { return Ok(None) };
    relax(&clouds, &mut poses, &RelaxationConfig { threads, ..RelaxationConfig::default() })?;
    let relax_ms = milliseconds(begin);
    let parts = BTreeMap::from([("chain".to_owned(), each_ms.iter().sum()), ("relaxation".to_owned(), relax_ms)]);
    if let Some(last) = each_ms.last_mut() {
        *last += relax_ms;
    }
    Ok(Some(SequenceRun { each_ms, parts, poses }))
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
