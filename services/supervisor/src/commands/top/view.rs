//! What is shown at one moment. The names of the fields are the keys of `--json` and do not change.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::outputs::{RegistrationTotals, Usage, WorkQuantiles};

/// A graph at one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Snapshot {
    /// Its domain.
    pub(super) domain: String,
    /// Process id of the supervisor, when there is one.
    pub(super) supervisor_pid: Option<u32>,
    /// How far the run has come.
    pub(super) run: Run,
    /// The services, in the order of the data flow, then others by name.
    pub(super) services: Vec<Service>,
    /// Latency of the stages, for those that were heard of.
    pub(super) stages: Vec<Stage>,
    /// The work of the services: waiting for a busy thread, waking up, taking messages, and computing apart [ms].
    pub(super) work: BTreeMap<String, WorkQuantiles>,
    /// Where all of these times come from: `measured`.
    pub(super) provenance: &'static str,
    /// The latest decision.
    pub(super) decision: Option<Decision>,
    /// How a foreign registration does, where there is one.
    pub(super) registration: Option<RegistrationTotals>,
    /// What could not be shown, and why.
    pub(super) notes: Vec<String>,
}

/// How far a run has come.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Run {
    /// `running`, `ended` or `fault`; `unknown` before the clock was heard.
    pub(super) state: &'static str,
    /// Whether each scan waits for the one before; unknown before the clock was heard.
    pub(super) lockstep: Option<bool>,
    /// Scans planned on; without planning, scans that every service has finished.
    pub(super) scans_done: u32,
    /// Scans the source will deliver, when it knows.
    pub(super) scans_expected: Option<u32>,
    /// Scans skipped because their file could not be read.
    pub(super) scans_failed: u32,
}

/// One service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Service {
    /// Its name.
    pub(super) service: String,
    /// Its process id.
    pub(super) pid: u32,
    /// `starting`, `running`, `stopping` or `failed` as it says; `silent` when not heard for a second, `gone` for
    /// five; `unheard` when it runs but has not reported.
    pub(super) state: &'static str,
    /// Times it was started again.
    pub(super) restarts: u32,
    /// Scans finished, counted from the first of the run.
    pub(super) finished_scans: u32,
    /// CPU time over wall time [percent of one core].
    pub(super) cpu_percent: Option<f64>,
    /// Resident memory [bytes].
    pub(super) resident_bytes: u64,
    /// Page faults, with and without a disk [1/s].
    pub(super) faults_per_second: Option<f64>,
    /// Context switches, voluntary and not [1/s].
    pub(super) switches_per_second: Option<f64>,
    /// CPU time, page faults and context switches since its start.
    #[serde(flatten)]
    pub(super) usage: Usage,
    /// Messages received [1/s].
    pub(super) messages_in_per_second: Option<f64>,
    /// Messages sent [1/s].
    pub(super) messages_out_per_second: Option<f64>,
    /// Messages its process found missing.
    pub(super) lost_messages: u64,
    /// Messages its process could not deliver.
    pub(super) undelivered_messages: u64,
    /// Payload bytes its process copied into or out of shared memory.
    pub(super) copied_payload_bytes: u64,
    /// Time of the last unit of work [ms].
    pub(super) last_work_ms: f64,
    /// Time since its last report [ms].
    pub(super) heard_ms_ago: Option<f64>,
    /// What it is doing, or why it failed.
    pub(super) message: String,
}

/// Latency of one stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Stage {
    /// `alignment`, `analysis`, `map`, `planning` or `end_to_end`.
    pub(super) stage: &'static str,
    /// Of the last scan [ms].
    pub(super) last_ms: f64,
    /// Median over the scans seen [ms]; to three digits beyond the first thousand, as all that follow.
    pub(super) p50_ms: f64,
    /// 90th percentile [ms].
    pub(super) p90_ms: f64,
    /// 99th percentile [ms].
    pub(super) p99_ms: f64,
    /// 99.9th percentile [ms].
    pub(super) p99_9_ms: f64,
    /// The largest [ms].
    pub(super) max_ms: f64,
    /// Scans seen.
    pub(super) scans: u64,
}

/// A decision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Decision {
    /// The newest scan it was taken on.
    pub(super) scan: u32,
    /// `go` or `stop`.
    pub(super) decision: &'static str,
    /// Its typed reason.
    pub(super) reason_code: String,
    /// Its reason in words.
    pub(super) reason: String,
    /// Name of the strategy.
    pub(super) strategy: String,
    /// Number of candidates.
    pub(super) candidates: usize,
    /// Length of the path [m].
    pub(super) path_length_m: f64,
    /// From the scan's sending to the plan's [ms].
    pub(super) end_to_end_ms: f64,
}
