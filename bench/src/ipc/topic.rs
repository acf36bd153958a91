//! The topic that is measured.

use mirador_ipc_schema::messages::{Point, ScanMeta};
use mirador_ipc_schema::topics::{Rules, Scan, Topic};

/// Most readers that are measured.
pub(super) const MOST_SUBSCRIBERS: usize = 8;

/// As `scan`, with room for as many readers as are measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeasuredScan;

impl Topic for MeasuredScan {
    type Meta = ScanMeta;
    type Item = Point;
    const RULES: Rules = Rules { name: "bench_scan", subscribers: MOST_SUBSCRIBERS, ..Scan::RULES };
}
