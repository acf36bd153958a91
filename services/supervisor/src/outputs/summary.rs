//! `summary.json`: all figures of a run under stable keys; what cannot be known is null.

use std::collections::BTreeMap;

use mirador_core::geometry::{Pose, rotation_angle, rows_from_pose};
use mirador_core::simulation::ModelDistance;
use mirador_ipc_schema::messages::{DECISION_STOP, ViewPlanMeta};
use mirador_ipc_schema::text;
use nalgebra::Point3;
use serde::Serialize;

use super::RegistrationTotals;
use super::facts::{RunFacts, ServiceTotals};
use super::histogram::Quantiles;
use super::latency::STAGES;
use super::run_data::{RunData, SourceEnd};
use super::work::WorkQuantiles;

/// All figures of a run.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Heading of the report.
    pub title: String,
    /// Scans recorded.
    pub scans: usize,
    /// Scans with a place in the map.
    pub aligned: usize,
    /// Scans without.
    pub unaligned: usize,
    /// Points with a return, all scans.
    pub points: u64,
    /// Short name of why the run ended.
    pub stop_reason: Option<String>,
    /// The same in words.
    pub stop_reason_text: Option<String>,
    /// Short name of the last decision; null when none was taken.
    pub last_decision: Option<String>,
    /// The same in words.
    pub last_decision_text: Option<String>,
    /// Share of the cells the robot can reach that are known, in [0, 1].
    pub coverage: Option<f64>,
    /// Mean quality of the known cells, in [0, 1].
    pub quality: Option<f64>,
    /// Distance driven [m].
    pub distance_m: f64,
    /// The robot's own time from start to end [s]; null where no robot drove.
    pub mission_s: Option<f64>,
    /// Targets that the robot set out for and did not reach, with the reason.
    pub given_up: Vec<String>,
    /// Whether the robot tipped over; null where no robot drove.
    pub tipped: Option<bool>,
    /// Known cells of the map.
    pub cells_known: Option<u32>,
    /// Side of a cell [m].
    pub cell_m: Option<f64>,
    /// The pose of every scan.
    pub poses: Vec<PoseSummary>,
    /// Errors against the truth.
    pub errors: Option<Errors>,
    /// Distance of the model's points to the true surfaces; null where these are not known.
    pub model_error: Option<ModelDistance>,
    /// Where the times come from: `measured`, all of them in this run.
    pub provenance: &'static str,
    /// Latency of every stage and from scan to plan [ms].
    pub latency_ms: BTreeMap<&'static str, Quantiles>,
    /// The work of every service, by its name: waiting for a busy thread, waking up, taking messages, and computing apart
    /// [ms].
    pub work_ms: BTreeMap<String, WorkQuantiles>,
    /// Payload bytes copied by all services.
    pub copied_payload_bytes: u64,
    /// Messages lost by all services.
    pub lost_messages: u64,
    /// Messages that all services could not deliver.
    pub undelivered_messages: u64,
    /// How a foreign registration did; null where there was none.
    pub registration: Option<RegistrationTotals>,
    /// Restarts of all services.
    pub restarts: u32,
    /// The user ended the run.
    pub interrupted: bool,
    /// Whether the recording was ended in order.
    pub recording_complete: bool,
    /// Duration of the run [s].
    pub wall_time_s: f64,
    /// Every service.
    pub services: Vec<ServiceTotals>,
}

/// The pose of one scan.
#[derive(Debug, Clone, Serialize)]
pub struct PoseSummary {
    /// Number of the scan.
    pub scan: u32,
    /// Place in the folder or scene it came from.
    pub source_index: u32,
    /// Time of the sensor [ns].
    pub stamp_ns: i64,
    /// Row-major 4x4; null when there is none.
    pub map_from_scanner: Option<[f64; 16]>,
    /// `first`, `accepted`, `rejected` or `missing`.
    pub status: &'static str,
    /// Why it is not aligned; null when it is.
    pub reason: Option<String>,
    /// Whether the pose was corrected after its alignment.
    pub corrected: bool,
    /// Share of points with a partner, in [0, 1].
    pub overlap: Option<f64>,
    /// Root mean square residual [m].
    pub residual_m: Option<f64>,
}

/// Absolute trajectory error of the aligned scans, the first of them laid on its true pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Errors {
    /// Root mean square of the translation errors [m].
    pub ate_rmse_m: f64,
    /// Root mean square of the rotation errors [degrees].
    pub ate_rmse_deg: f64,
    /// Largest translation error [m].
    pub max_m: f64,
    /// Scans compared.
    pub n: usize,
}

impl Summary {
    /// Adds up a run.
    #[must_use]
    pub fn of(data: &RunData, facts: &RunFacts, model_error: Option<ModelDistance>) -> Self {
        let aligned = data.scans.iter().filter(|s| s.is_aligned()).count();
        let (stop_reason, stop_reason_text) = stop_reason(data, facts).unzip();
        let (last_decision, last_decision_text) = data.last_plan.as_ref().map(|(plan, _)| words(plan)).unzip();
        let total = |of: fn(&ServiceTotals) -> u64| facts.services.iter().map(of).sum();
        let has_map = !data.map.tiles.is_empty();
        let has_driven = !data.drive.track.is_empty();
        Self {
            title: facts.title.clone(),
            scans: data.scans.len(),
            aligned,
            unaligned: data.scans.len() - aligned,
            points: data.scans.iter().map(|s| u64::from(s.scan.returns)).sum(),
            stop_reason,
            stop_reason_text,
            last_decision,
            last_decision_text,
            coverage: coverage(data, facts),
            quality: quality(data),
            distance_m: data.distance_m(),
            mission_s: has_driven.then_some(data.drive.duration_s),
            given_up: data.drive.given_up.iter().map(|g| format!("after scan {}: {}", g.scan, g.reason)).collect(),
            tipped: has_driven.then_some(data.drive.tipped),
            cells_known: has_map.then_some(data.map.cells_known),
            cell_m: has_map.then_some(data.map.cell_m),
            poses: poses(data),
            errors: errors(data, facts),
            model_error,
            provenance: "measured",
            work_ms: data.work.quantiles(),
            latency_ms: STAGES.iter().map(|stage| (stage.name, stage.quantiles(data))).collect(),
            copied_payload_bytes: total(|s| s.copied_payload_bytes),
            lost_messages: total(|s| s.lost_messages),
            undelivered_messages: total(|s| s.undelivered_messages),
            registration: facts.registration.clone(),
            restarts: facts.restarts,
            interrupted: facts.interrupted,
            recording_complete: data.complete,
            wall_time_s: facts.wall_time.as_secs_f64(),
            services: facts.services.clone(),
        }
    }
}

/// Short name and words of a decision.
fn words(plan: &ViewPlanMeta) -> (String, String) {
    (text::unpack(&plan.reason_code).into(), text::unpack(&plan.reason).into())
}

/// Short name and words of why the run ended. Recorded scans come to their end whatever was decided after them, so the
/// decision to stop is the reason only where nothing else ended the run.
fn stop_reason(data: &RunData, facts: &RunFacts) -> Option<(String, String)> {
    let said = |code: &str, words: &str| Some((code.to_owned(), words.to_owned()));
    if let Some(fault) = &facts.fault {
        return said("fault", fault);
    }
    if facts.interrupted {
        return said("interrupted", "the user ended the run");
    }
    let decided =
        || data.last_plan.as_ref().filter(|(plan, _)| plan.decision == DECISION_STOP).map(|(plan, _)| words(plan));
    match data.source {
        SourceEnd::Ended if data.is_live => {
            decided().or_else(|| said("limit_reached", "as many scans were taken as were asked for"))
        }
        SourceEnd::Ended => said("input_ended", "all scans of the source were processed"),
        SourceEnd::Fault => said("fault", "the source of the scans could not go on"),
        SourceEnd::Open => decided(),
    }
}

fn quality(data: &RunData) -> Option<f64> {
    if !data.map.tiles.is_empty() {
        return Some(data.map.mean_quality);
    }
    data.last_plan.as_ref().map(|(plan, _)| plan.mean_quality)
}

fn poses(data: &RunData) -> Vec<PoseSummary> {
    let of = |s: &super::run_data::ScanRecord| PoseSummary {
        scan: s.number(),
        source_index: s.scan.source_index,
        stamp_ns: s.scan.header.stamp_ns,
        map_from_scanner: s.pose().as_ref().map(rows_from_pose),
        status: s.status(),
        reason: s.reason(),
        corrected: s.corrected.is_some(),
        overlap: s.alignment.map(|a| a.overlap),
        residual_m: s.alignment.map(|a| a.residual_m),
    };
    data.scans.iter().map(of).collect()
}

/// Estimate and truth of every aligned scan that has both.
fn compared(data: &RunData, facts: &RunFacts) -> Vec<(Pose, Pose)> {
    let Some(truth) = &facts.truth else { return Vec::new() };
    let aligned = data.scans.iter().filter(|s| s.is_aligned());
    aligned.filter_map(|s| Some((s.pose()?, *truth.get(&s.scan.source_index)?))).collect()
}

/// The absolute trajectory error, with the first pose laid on its truth.
fn errors(data: &RunData, facts: &RunFacts) -> Option<Errors> {
    let compared = compared(data, facts);
    let (map_from_first, world_from_first) = compared.first()?;
    let map_from_world = map_from_first * world_from_first.inverse();
    let (mut square_m, mut square_deg, mut max_m) = (0.0, 0.0, 0.0_f64);
    for (map_from_scanner, world_from_scanner) in &compared {
        let error = (map_from_world * world_from_scanner).inverse() * map_from_scanner;
        let metres = error.translation.vector.norm();
        square_m += metres * metres;
        square_deg += rotation_angle(&error).to_degrees().powi(2);
        max_m = max_m.max(metres);
    }
    let n = compared.len();
    let root = |square: f64| (square / n as f64).sqrt();
    Some(Errors { ate_rmse_m: root(square_m), ate_rmse_deg: root(square_deg), max_m, n })
}

/// The frame of the truth in the map, the first aligned scan being where it truly was; `None` when none was aligned. Without true
/// poses the two are one.
pub(super) fn map_from_world(data: &RunData, facts: &RunFacts) -> Option<Pose> {
    if facts.truth.is_none() {
        return Some(Pose::identity());
    }
    let compared = compared(data, facts);
    let (map_from_first, world_from_first) = compared.first()?;
    Some(map_from_first * world_from_first.inverse())
}

/// Share of the reachable cells whose centre lies in a known cell of the map.
fn coverage(data: &RunData, facts: &RunFacts) -> Option<f64> {
    let cells = facts.truth_cells.as_ref().filter(|cells| !cells.is_empty())?;
    let map_from_world = map_from_world(data, facts)?;
    let is_known = |[x, y]: &&[f64; 2]| {
        let p = map_from_world * Point3::new(*x, *y, 0.0);
        data.map.at(p.x, p.y).is_some()
    };
    Some(cells.iter().filter(is_known).count() as f64 / cells.len() as f64)
}
