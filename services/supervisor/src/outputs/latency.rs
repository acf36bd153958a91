//! How long the stages of a run took.

use super::histogram::{Latencies, Quantiles};
use super::run_data::{RunData, ScanRecord};

/// One stage of the pipeline.
pub struct Stage {
    /// Name of the stage, as in `summary.json`.
    pub name: &'static str,
    /// What it took for one scan [ns].
    pub of: fn(&ScanRecord) -> Option<u64>,
}

/// The stages in the order of the data flow.
pub const STAGES: [Stage; 7] = [
    Stage { name: "surface", of: |s| Some(s.scored?.surface_ns) },
    Stage { name: "alignment", of: |s| s.alignment.map(|a| a.prepare_ns.saturating_add(a.align_ns)) },
    Stage { name: "scan_to_pose", of: |s| s.alignment?.header.sent_ns.checked_sub(s.scan.header.sent_ns) },
    Stage { name: "analysis", of: |s| Some(s.scored?.analysis_ns) },
    Stage { name: "map", of: |s| Some(s.first_plan?.map_ns) },
    Stage { name: "planning", of: |s| Some(s.first_plan?.planning_ns) },
    Stage { name: "end_to_end", of: |s| s.first_plan?.header.sent_ns.checked_sub(s.scan.header.sent_ns) },
];

impl Stage {
    /// Scan number and duration [ms] for every scan that has one.
    #[must_use]
    pub fn durations(&self, data: &RunData) -> Vec<(u32, f64)> {
        data.scans.iter().filter_map(|s| Some((s.number(), (self.of)(s)? as f64 / 1e6))).collect()
    }

    /// The stage in sum.
    #[must_use]
    pub fn quantiles(&self, data: &RunData) -> Quantiles {
        Latencies::of(data.scans.iter().filter_map(self.of)).quantiles()
    }
}
