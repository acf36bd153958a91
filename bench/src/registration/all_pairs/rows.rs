//! One row for each method.

use std::collections::BTreeMap;

use serde_json::json;

use super::{AllPairsOptions, Attempt, Entrant};
use crate::{Provenance, Row, Summary};

/// Row `all_pairs` of every method that has tried anything.
pub(super) fn rows(data: &str, options: &AllPairsOptions, entrants: &[Entrant]) -> Vec<Row> {
    entrants.iter().filter_map(|entrant| row(data, options, entrant)).collect()
}

/// Quantiles of what some attempts have.
pub(super) fn summary(attempts: &[Attempt], of: fn(&Attempt) -> Option<f64>) -> Option<Summary> {
    Summary::of(&attempts.iter().filter_map(of).collect::<Vec<_>>())
}

/// Share of the attempts that are successes.
pub(super) fn success_rate(attempts: &[Attempt]) -> f64 {
    attempts.iter().filter(|attempt| attempt.success).count() as f64 / attempts.len().max(1) as f64
}

fn row(data: &str, options: &AllPairsOptions, entrant: &Entrant) -> Option<Row> {
    let attempts = &entrant.attempts;
    let metres = summary(attempts, |a| a.translation_error_m);
    let degrees = summary(attempts, |a| a.rotation_error_deg);
    let iterations = summary(attempts, |a| a.iterations.map(f64::from));
    let median = |s: &Option<Summary>| s.as_ref().map(|s| s.p50);
    let p90 = |s: &Option<Summary>| s.as_ref().map(|s| s.p90);
    Some(Row {
        name: "all_pairs".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(entrant.method)),
            ("data".into(), json!(data)),
            ("threads".into(), json!(options.threads)),
            ("peer".into(), json!(false)),
        ]),
        unit: "ms".into(),
        summary: summary(attempts, |a| Some(a.ms))?,
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("success_rate".to_owned(), json!(success_rate(attempts))),
            ("translation_error_m".into(), json!(median(&metres))),
            ("translation_error_p90_m".into(), json!(p90(&metres))),
            ("rotation_error_deg".into(), json!(median(&degrees))),
            ("rotation_error_p90_deg".into(), json!(p90(&degrees))),
            ("iterations".into(), json!(median(&iterations))),
            ("overlap".into(), json!(median(&summary(attempts, |a| a.overlap)))),
            ("without_pose".into(), json!(attempts.iter().filter(|a| a.translation_error_m.is_none()).count())),
            ("each".into(), json!(attempts)),
        ]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn successes_errors_and_refusals_are_counted() {
        let attempt = |metres: Option<f64>, success| Attempt {
            target: 0,
            source: 1,
            distance_m: 1.0,
            ms: 5.0,
            translation_error_m: metres,
            rotation_error_deg: metres,
            iterations: metres.map(|_| 7),
            overlap: metres,
            success,
        };
        let attempts = vec![attempt(Some(0.01), true), attempt(Some(3.0), false), attempt(None, false)];
        let entrant = Entrant { method: "m".into(), attempts };
        let rows =
            rows("d", &AllPairsOptions::default(), &[entrant, Entrant { method: "idle".into(), attempts: vec![] }]);
        assert_eq!(rows.len(), 1, "who has tried nothing has no row");
        let extra = &rows[0].extra;
        assert!((extra["success_rate"].as_f64().unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!((&extra["translation_error_m"], &extra["translation_error_p90_m"]), (&json!(0.01), &json!(3.0)));
        assert_eq!((&extra["without_pose"], &extra["iterations"]), (&json!(1), &json!(7.0)));
        assert_eq!((rows[0].summary.n, extra["each"].as_array().unwrap().len()), (3, 3));
    }
}
