//! How long the stages of a run took.

use serde::Serialize;

use super::run_data::{RunData, ScanRecord};

/// Order statistics of a stage [ms]; null where nothing was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Number of measurements.
    pub n: usize,
}

impl Quantiles {
    /// The smallest value that at least the share p of all values does not exceed (nearest rank), so every figure was
    /// really measured.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let k = (share * values.len() as f64).ceil() as usize;
            values.get(k.saturating_sub(1)).copied()
        };
        Self { p50: rank(0.5), p99: rank(0.99), max: values.last().copied(), n: values.len() }
    }
}

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
        Quantiles::of(self.durations(data).into_iter().map(|(_, ms)| ms).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_were_measured() {
        let q = Quantiles::of((1..=200).rev().map(f64::from).collect());
        assert_eq!(q, Quantiles { p50: Some(100.0), p99: Some(198.0), max: Some(200.0), n: 200 });
        assert_eq!(Quantiles::of(vec![7.0]).p99, Some(7.0));
        assert_eq!(Quantiles::of(Vec::new()), Quantiles::default());
    }
}
