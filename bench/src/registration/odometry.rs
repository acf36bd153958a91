//! Our continuous mode: every frame against a local map, without priors. The one place to change when it is done in
//! another way.

use std::collections::BTreeMap;
use std::time::Instant;

use mirador_core::odometry::{Odometry, OdometryConfig};
use mirador_core::scan::ScanView;

use super::RegistrationBenchError;
use super::data::SequenceData;
use super::mapper::SequenceRun;

/// The method's name in the report.
pub(super) const METHOD: &str = "odometry";

/// A whole sequence, with the settings that users get.
pub(super) fn follow(threads: usize, data: &SequenceData) -> Result<SequenceRun, RegistrationBenchError> {
    let mut odometry = Odometry::new(OdometryConfig { threads, ..OdometryConfig::default() })?;
    let (mut each_ms, mut poses) = (Vec::with_capacity(data.scans.len()), Vec::with_capacity(data.scans.len()));
    for scan in &data.scans {
        let begin = Instant::now();
        let record = odometry.register_frame(ScanView::unordered(scan), None, None);
        each_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        poses.push(record.map_from_scanner);
    }
    let parts = BTreeMap::from([("frames".to_owned(), each_ms.iter().sum())]);
    Ok(SequenceRun { each_ms, parts, poses })
}
