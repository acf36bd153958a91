//! `growth` rows: whether a scan takes longer, and how much memory is held, as the map grows.

use std::collections::BTreeMap;

use mirador_core::registration::Registry;
use mirador_core::scan::ScanView;
use mirador_core::slam6d::global::CorrectionMethod;
use mirador_core::slam6d::trajectory_error;
use serde_json::json;

use super::contest::median_parts;
use super::mapper::{Mapper, Step};
use super::simulated::long_drive;
use super::{RegistrationBenchError, RegistrationOptions, THREADS};
use crate::{Provenance, Row, Summary};

/// The sizes of the map at which is looked.
const SIZES: [usize; 4] = [10, 100, 1000, 4000];
/// Scans up to a size whose times are taken together.
const WINDOW: usize = 100;

/// The rows of every method, at the larger number of threads.
pub(super) fn rows(
    options: &RegistrationOptions,
    registry: &Registry,
    methods: &[String],
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let drive = long_drive(options.growth_scans)?;
    let threads = THREADS[THREADS.len() - 1];
    let mut rows = Vec::new();
    for method in methods {
        let mut mapper = Mapper::new(registry, method, threads, CorrectionMethod::PoseGraph)?;
        let (mut steps, mut points) = (Vec::new(), Vec::new());
        for k in 0..drive.truth.len() {
            drive.scan(k, &mut points)?;
            let view = ScanView::with_grid(&points, Some(drive.grid()));
            steps.push(mapper.step(view, drive.priors.get(k).copied()));
            let scans = k + 1;
            if scans % 500 == 0 {
                say(&format!("growth {method}: {scans} of {} scans", drive.truth.len()));
            }
            if SIZES.contains(&scans) {
                let error = trajectory_error(&mapper.poses(), &drive.truth[..scans]);
                rows.extend(row(method, threads, &steps, mapper.bytes(), error.map(|e| e.ate_rmse_m)));
            }
        }
    }
    Ok(rows)
}

/// The last scans of those so far.
fn row(method: &str, threads: usize, steps: &[Step], bytes: usize, error_m: Option<f64>) -> Option<Row> {
    let (scans, window) = (steps.len(), &steps[steps.len().saturating_sub(WINDOW)..]);
    // The first scan of all has nothing to be aligned to.
    let window = if window.len() == scans { &window[1..] } else { window };
    let (looped, plain): (Vec<&Step>, Vec<&Step>) = window.iter().partition(|step| step.tried_loop);
    let times = |steps: &[&Step]| steps.iter().map(|step| step.ms).collect::<Vec<f64>>();
    let phases: Vec<BTreeMap<String, f64>> = plain.iter().map(|step| step.parts()).collect();
    Some(Row {
        name: "growth".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(format!("{method} + pose graph"))),
            ("data".into(), json!("long_drive")),
            ("threads".into(), json!(threads)),
            ("peer".into(), json!(false)),
            ("scans_in_map".into(), json!(scans)),
        ]),
        unit: "ms".into(),
        summary: Summary::of(&times(&plain))?,
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("bytes".to_owned(), json!(bytes)),
            ("bytes_per_scan".into(), json!(bytes / scans.max(1))),
            ("ate_rmse_m".into(), json!(error_m)),
            ("loop_scans".into(), json!(looped.len())),
            ("loop_p50".into(), json!(Summary::of(&times(&looped)).map(|s| s.p50))),
            ("loop_max".into(), json!(Summary::of(&times(&looped)).map(|s| s.max))),
            ("parts".into(), json!(median_parts(&phases.iter().collect::<Vec<_>>()))),
        ]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(ms: f64, tried_loop: bool) -> Step {
        Step { ms, prepare_ms: 1.0, align_ms: 1.0, correction_ms: ms - 2.0, tried_loop }
    }

    #[test]
    fn scans_that_looked_for_a_loop_are_set_apart() {
        let mut steps = vec![step(999.0, false)];
        steps.extend([step(10.0, false), step(80.0, true), step(12.0, false), step(11.0, false)]);
        let row = row("m", 2, &steps, 5000, Some(0.1)).unwrap();
        assert_eq!((row.summary.n, row.summary.p50, row.summary.max), (3, 11.0, 12.0), "the first does not count");
        assert_eq!((&row.extra["loop_scans"], &row.extra["loop_max"]), (&json!(1), &json!(80.0)));
        assert_eq!((&row.params["scans_in_map"], &row.extra["bytes_per_scan"]), (&json!(5), &json!(1000)));
    }

    #[test]
    fn only_the_last_hundred_scans_count() {
        let mut steps = vec![step(500.0, false); 300];
        steps.extend(vec![step(5.0, false); WINDOW]);
        let row = row("m", 2, &steps, 1, None).unwrap();
        assert_eq!((row.summary.n, row.summary.max), (WINDOW, 5.0));
        assert_eq!(row.extra["loop_p50"], serde_json::Value::Null);
    }
}
