//! `sequence` rows: recorded scans in a row, with drifting odometry or without any.

use std::collections::BTreeMap;

use mirador_core::registration::Registry;
use mirador_core::slam6d::global::CorrectionMethod;
use mirador_core::slam6d::trajectory_error;
use serde_json::{Value, json};

use super::chain_relaxation::align_and_relax;
use super::contest::{median, median_parts};
use super::data::{SequenceData, kitti_error_m, read_handheld, read_kitti};
use super::mapper::{SequenceRun, align_sequence};
use super::peers::Peers;
use super::{RegistrationBenchError, RegistrationOptions, THREADS, literature, odometry};
use crate::{Provenance, Row, Summary};

/// Voxel edges of KISS-ICP [m]: its default outdoors, and half of it for the narrow handheld scenes.
const KISS_VOXEL_M: f64 = 1.0;
const KISS_HANDHELD_VOXEL_M: f64 = 0.5;

/// How older scans are corrected, and what is added to the method's name for it.
const CORRECTIONS: [(CorrectionMethod, &str); 2] =
    [(CorrectionMethod::Off, " chain"), (CorrectionMethod::PoseGraph, " + pose graph")];

/// Whose run, and how.
#[derive(Debug, Clone, PartialEq)]
struct Entrant {
    method: String,
    threads: usize,
    prior: &'static str,
    version: Option<String>,
}

/// The rows of the sequences that are there.
pub(super) fn rows(
    options: &RegistrationOptions,
    registry: &Registry,
    methods: &[String],
    peers: &Peers,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let mut rows = Vec::new();
    let folder = options.data.join("handheld");
    if folder.is_dir() {
        rows.extend(handheld(options, registry, methods, peers, &read_handheld(&folder)?, say)?);
    } else {
        say(&format!("no data at {}: its rows are left out", folder.display()));
    }
    let folder = options.data.join("kitti00_first6");
    if folder.is_dir() {
        rows.extend(kitti(options, peers, &read_kitti(&folder)?, say)?);
    } else {
        say(&format!("no data at {}: its rows are left out", folder.display()));
    }
    Ok(rows)
}

/// The handheld scans: ours and small_gicp's chain in turns, KISS-ICP once (it takes a second a scan), and literature.
fn handheld(
    options: &RegistrationOptions,
    registry: &Registry,
    methods: &[String],
    peers: &Peers,
    data: &SequenceData,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let mut runs: Vec<(Entrant, Vec<SequenceRun>)> = Vec::new();
    for repetition in 0..options.sequence_repetitions() {
        say(&format!("sequence {}: repetition {}", data.name, repetition + 1));
        for threads in THREADS {
            for method in methods {
                for (correction, name) in CORRECTIONS {
                    let run = align_sequence(registry, method, threads, correction, data)?;
                    let method = format!("{method}{name}");
                    add(&mut runs, Entrant { method, threads, prior: "odometry", version: None }, run);
                }
                if let Some(run) = align_and_relax(registry, method, threads, data)? {
                    let method = format!("{method} chain + relaxation");
                    add(&mut runs, Entrant { method, threads, prior: "odometry", version: None }, run);
                }
            }
            add(&mut runs, ours_without_priors(threads), odometry::follow(threads, data)?);
            if let Some(run) = peers.align_chain(threads, data, say) {
                let (method, version) = ("small_gicp GICP chain".into(), peers.small_gicp_version());
                add(&mut runs, Entrant { method, threads, prior: "odometry", version }, run);
            }
        }
    }
    let threads = THREADS[THREADS.len() - 1];
    if peers.kiss_icp_version().is_some() {
        say(&format!("sequence {}: kiss_icp, without odometry", data.name));
    }
    if let Some(run) = peers.odometry(threads, KISS_HANDHELD_VOXEL_M, data, say) {
        let (method, version) = ("kiss_icp".into(), peers.kiss_icp_version());
        add(&mut runs, Entrant { method, threads, prior: "none", version }, run);
    }
    let mut rows: Vec<Row> = runs.iter().filter_map(|(entrant, runs)| whole_row(data, entrant, runs)).collect();
    rows.extend(literature::handheld_rows());
    Ok(rows)
}

/// The frames of KITTI, where what counts is the time of a frame.
fn kitti(
    options: &RegistrationOptions,
    peers: &Peers,
    data: &SequenceData,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let mut runs: Vec<(Entrant, Vec<SequenceRun>)> = Vec::new();
    say(&format!("sequence {}: {} frames", data.name, data.scans.len()));
    for _ in 0..options.repetitions {
        for threads in THREADS {
            add(&mut runs, ours_without_priors(threads), odometry::follow(threads, data)?);
            if let Some(run) = peers.odometry(threads, KISS_VOXEL_M, data, say) {
                let (method, version) = ("kiss_icp".into(), peers.kiss_icp_version());
                add(&mut runs, Entrant { method, threads, prior: "none", version }, run);
            }
        }
    }
    Ok(runs.iter().filter_map(|(entrant, runs)| frame_row(data, entrant, runs)).collect())
}

fn ours_without_priors(threads: usize) -> Entrant {
    Entrant { method: odometry::METHOD.into(), threads, prior: "none", version: None }
}

fn add(runs: &mut Vec<(Entrant, Vec<SequenceRun>)>, entrant: Entrant, run: SequenceRun) {
    match runs.iter_mut().find(|(known, _)| *known == entrant) {
        Some((_, of_entrant)) => of_entrant.push(run),
        None => runs.push((entrant, vec![run])),
    }
}

/// Percentiles of the time for the whole sequence, and the error of the trajectory.
fn whole_row(data: &SequenceData, entrant: &Entrant, runs: &[SequenceRun]) -> Option<Row> {
    let totals: Vec<f64> = runs.iter().map(|run| run.each_ms.iter().sum()).collect();
    let summary = Summary::of(&totals)?;
    let parts: Vec<&BTreeMap<String, f64>> = runs.iter().map(|run| &run.parts).collect();
    // Repetitions of ours are the same to the last bit, those of the peers nearly so.
    let error = trajectory_error(&runs.last()?.poses, &data.truth);
    let p50 = summary.p50;
    let mut row = row(data, entrant, "sequence", summary);
    row.extra.extend([
        ("ms_per_scan".to_owned(), json!(p50 / data.scans.len() as f64)),
        ("ate_rmse_m".into(), json!(error.map(|e| e.ate_rmse_m))),
        ("ate_rmse_deg".into(), json!(error.map(|e| e.ate_rmse_deg))),
        ("max_m".into(), json!(error.map(|e| e.max_m))),
        ("max_deg".into(), json!(error.map(|e| e.max_deg))),
        ("parts".into(), json!(median_parts(&parts))),
    ]);
    Some(row)
}

/// Percentiles of the time of a frame. The first only fills the map and does not count.
fn frame_row(data: &SequenceData, entrant: &Entrant, runs: &[SequenceRun]) -> Option<Row> {
    let times: Vec<f64> = runs.iter().flat_map(|run| run.each_ms.iter().skip(1).copied()).collect();
    let summary = Summary::of(&times)?;
    let parts: Vec<&BTreeMap<String, f64>> = runs.iter().map(|run| &run.parts).collect();
    let error = median(runs.iter().filter_map(|run| kitti_error_m(&run.poses)));
    let p50 = summary.p50;
    let mut row = row(data, entrant, "frame", summary);
    row.extra.extend([
        ("frames_per_second".to_owned(), json!(1e3 / p50)),
        ("translation_error_m".into(), json!(error)),
        ("parts".into(), json!(median_parts(&parts))),
    ]);
    Some(row)
}

fn row(data: &SequenceData, entrant: &Entrant, per: &str, summary: Summary) -> Row {
    let mut extra = BTreeMap::from([("scans".to_owned(), json!(data.scans.len()))]);
    if let Some(version) = &entrant.version {
        extra.insert("version".into(), json!(version));
    }
    Row {
        name: "sequence".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(entrant.method)),
            ("data".into(), json!(data.name)),
            ("threads".into(), json!(entrant.threads)),
            ("peer".into(), Value::Bool(entrant.version.is_some())),
            ("prior".into(), json!(entrant.prior)),
            ("per".into(), json!(per)),
        ]),
        unit: "ms".into(),
        summary,
        provenance: Provenance::Measured,
        extra,
    }
}

#[cfg(test)]
mod tests {
    use mirador_core::geometry::Pose;
    use nalgebra::Vector3;

    use super::*;

    fn pose(x: f64) -> Pose {
        Pose::new(Vector3::new(x, 0.0, 0.0), Vector3::zeros())
    }

    fn entrant() -> Entrant {
        Entrant { method: "m".into(), threads: 1, prior: "odometry", version: None }
    }

    fn run(ms: [f64; 3]) -> SequenceRun {
        let parts = BTreeMap::from([("align".to_owned(), ms[0])]);
        SequenceRun { each_ms: ms.to_vec(), parts, poses: [0.0, 1.0, 2.3].map(pose).to_vec() }
    }

    fn data() -> SequenceData {
        let truth = [0.0, 1.0, 2.0].map(pose).to_vec();
        SequenceData { name: "d".into(), scans: vec![Vec::new(); 3], priors: truth.clone(), truth }
    }

    #[test]
    fn a_sequence_has_its_total_time_and_the_error_of_its_trajectory() {
        let row = whole_row(&data(), &entrant(), &[run([1.0, 2.0, 3.0])]).unwrap();
        assert_eq!((row.summary.p50, &row.extra["ms_per_scan"]), (6.0, &json!(2.0)));
        assert!((row.extra["ate_rmse_m"].as_f64().unwrap() - (0.09_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(row.extra["parts"], json!({"align": 1.0}));
        assert_eq!(
            serde_json::to_value(&row.params).unwrap(),
            json!({"method": "m", "data": "d", "threads": 1, "peer": false, "prior": "odometry", "per": "sequence"})
        );
        assert_eq!(whole_row(&data(), &entrant(), &[]), None);
    }

    #[test]
    fn the_first_frame_does_not_count() {
        let row = frame_row(&data(), &entrant(), &[run([99.0, 4.0, 4.0]), run([99.0, 4.0, 4.0])]).unwrap();
        assert_eq!((row.summary.n, row.summary.p50, row.summary.max), (4, 4.0, 4.0));
        assert_eq!(row.extra["frames_per_second"], json!(250.0));
    }

    #[test]
    fn runs_of_the_same_entrant_are_kept_together() {
        let mut runs = Vec::new();
        for threads in [1, 2, 1] {
            add(&mut runs, Entrant { threads, ..entrant() }, run([1.0; 3]));
        }
        assert_eq!(runs.iter().map(|(_, runs)| runs.len()).collect::<Vec<_>>(), [2, 1]);
    }
}
