//! A small run for the tests.

use std::path::Path;

use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, AlignmentMeta, Header, Hypothesis, LoopClosingMeta, Point, PointScore, ScanId, ScanMeta,
    ScoredScanMeta, ViewPlanMeta,
};
use mirador_ipc_schema::topics;

use crate::{RecorderConfig, RunWriter};

pub(crate) const IDENTITY: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

/// A header about scan `scan`, sent at `sent_ns`.
pub(crate) fn header(scan: u32, sent_ns: u64) -> Header {
    let id = ScanId { robot: 1, run: 2, scan }.pack();
    Header { id, stamp_ns: i64::from(scan) * 1_000_000_000, sent_ns, sequence: u64::from(scan), ..Header::default() }
}

/// The points of scan `scan`.
pub(crate) fn points(scan: u32, n: usize) -> Vec<Point> {
    let place = |i: usize| (i as f32) * 0.01 + scan as f32;
    (0..n).map(|i| Point { x: place(i), y: -place(i), z: 0.5, intensity: i as u16, time: 0 }).collect()
}

/// Writes scan, alignment, scores and plan of one scan.
pub(crate) fn record_scan(writer: &mut RunWriter, scan: u32, n: usize) {
    let sent = u64::from(scan) * 1_000_000_000 + 1_000;
    let meta = ScanMeta { header: header(scan, sent), rows: 1, cols: n as u32, ..ScanMeta::default() };
    writer.record::<topics::Scan>(&meta, &points(scan, n)).unwrap();
    let alignment = AlignmentMeta {
        header: header(scan, sent + 10),
        map_from_scanner: IDENTITY,
        status: ALIGNMENT_ACCEPTED,
        ..AlignmentMeta::default()
    };
    writer.record::<topics::Alignment>(&alignment, &[Hypothesis::default(); 2]).unwrap();
    let loops = LoopClosingMeta { header: header(scan, sent + 15), ..LoopClosingMeta::default() };
    writer.record::<topics::LoopClosing>(&loops, &[]).unwrap();
    let scored = ScoredScanMeta { header: header(scan, sent + 20), ..ScoredScanMeta::default() };
    let scores = vec![PointScore { quality: 65535, flags: 1, ..PointScore::default() }; n];
    writer.record::<topics::ScoredScan>(&scored, &scores).unwrap();
    let plan = ViewPlanMeta { header: header(scan, sent + 30), ..ViewPlanMeta::default() };
    writer.record::<topics::ViewPlan>(&plan, &[]).unwrap();
    writer.flush().unwrap();
}

/// Writes a run of `scans` scans with `n` points each.
pub(crate) fn record_run(path: &Path, config: &RecorderConfig, scans: u32, n: usize) {
    let mut writer = RunWriter::create(path, config).unwrap();
    for scan in 0..scans {
        record_scan(&mut writer, scan, n);
    }
    writer.finish().unwrap();
}
