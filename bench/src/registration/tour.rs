//! `loop` rows: the source's scanner on a tour around a block, pair, loop detection and correction included.

use std::collections::BTreeMap;

use mirador_core::registration::Registry;
use mirador_core::scan::{Point, ScanView};
use mirador_core::slam6d::global::CorrectionMethod;
use mirador_core::slam6d::trajectory_error;
use serde_json::json;

use super::contest::median_parts;
use super::mapper::{Mapper, Step};
use super::simulated::{SimulatedDrive, tour_around_a_block};
use super::{RegistrationBenchError, RegistrationOptions, THREADS};
use crate::{Provenance, Row, Summary};

/// What the source reports for its 15 scans (its section 3): pair, loop detection and correction [ms].
const SOURCE_MS: f64 = 8500.0;

/// All steps of one contestant, and its last map.
struct Runs {
    steps: Vec<Step>,
    mapper: Mapper,
}

/// The rows of every method, one and two threads in turns.
pub(super) fn rows(
    options: &RegistrationOptions,
    registry: &Registry,
    methods: &[String],
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    say("loop: taking the scans");
    let drive = tour_around_a_block()?;
    let mut scans = Vec::new();
    for k in 0..drive.truth.len() {
        let mut points = Vec::new();
        drive.scan(k, &mut points)?;
        scans.push(points);
    }
    let mut runs: BTreeMap<(&str, usize), Runs> = BTreeMap::new();
    for repetition in 0..options.sequence_repetitions() {
        say(&format!("loop: repetition {}", repetition + 1));
        for (method, threads) in methods.iter().flat_map(|m| THREADS.map(|threads| (m.as_str(), threads))) {
            let mut mapper = Mapper::new(registry, method, threads, CorrectionMethod::PoseGraph)?;
            let mut steps = Vec::new();
            for (points, prior) in scans.iter().zip(&drive.priors) {
                let view = ScanView::with_grid(points, Some(drive.grid()));
                steps.push(mapper.step(view, Some(*prior)));
            }
            // The first scan only defines the map.
            steps.remove(0);
            match runs.get_mut(&(method, threads)) {
                Some(known) => known.steps.extend(steps),
                None => {
                    runs.insert((method, threads), Runs { steps, mapper });
                }
            }
        }
    }
    let mut rows: Vec<Row> =
        runs.iter().filter_map(|((method, threads), runs)| row(&drive, &scans, method, *threads, runs)).collect();
    rows.push(source_row());
    Ok(rows)
}

fn row(drive: &SimulatedDrive, scans: &[Vec<Point>], method: &str, threads: usize, runs: &Runs) -> Option<Row> {
    let times: Vec<f64> = runs.steps.iter().map(|step| step.ms).collect();
    let phases: Vec<BTreeMap<String, f64>> = runs.steps.iter().map(Step::parts).collect();
    let pair: Vec<f64> = runs.steps.iter().map(|step| step.prepare_ms + step.align_ms).collect();
    let returns: usize = scans.iter().flatten().filter(|point| point.is_return()).count();
    let error = trajectory_error(&runs.mapper.poses(), &drive.truth);
    let drift = trajectory_error(&drive.priors, &drive.truth);
    let extra = BTreeMap::from([
        ("scans".to_owned(), json!(scans.len())),
        ("returns".into(), json!(returns / scans.len().max(1))),
        ("pair_p50_ms".into(), json!(Summary::of(&pair).map(|s| s.p50))),
        ("tried_loops".into(), json!(runs.steps.iter().any(|step| step.tried_loop))),
        ("ate_rmse_m".into(), json!(error.map(|e| e.ate_rmse_m))),
        ("ate_rmse_deg".into(), json!(error.map(|e| e.ate_rmse_deg))),
        ("prior_ate_rmse_m".into(), json!(drift.map(|e| e.ate_rmse_m))),
        ("parts".into(), json!(median_parts(&phases.iter().collect::<Vec<_>>()))),
    ]);
    Some(Row {
        name: "loop".into(),
        params: params(&format!("{method} + pose graph"), Some(threads)),
        unit: "ms".into(),
        summary: Summary::of(&times)?,
        provenance: Provenance::Measured,
        extra,
    })
}

fn source_row() -> Row {
    Row {
        name: "loop".into(),
        params: params("the source", None),
        unit: "ms".into(),
        summary: Summary::single(SOURCE_MS),
        provenance: Provenance::Literature,
        extra: BTreeMap::from([("source".to_owned(), json!("its own report, on its own scans and machine"))]),
    }
}

fn params(method: &str, threads: Option<usize>) -> BTreeMap<String, serde_json::Value> {
    BTreeMap::from([
        ("method".to_owned(), json!(method)),
        ("data".into(), json!("tour_of_15")),
        ("threads".into(), json!(threads)),
        ("peer".into(), json!(threads.is_none())),
    ])
}
