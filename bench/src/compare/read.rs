//! Reads a report, and says which field is wrong when it is none.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::CompareError;
use crate::{BenchReport, Row};

/// The report in a file.
pub(super) fn report(path: &Path) -> Result<BenchReport, CompareError> {
    let text = std::fs::read_to_string(path).map_err(|source| CompareError::Read { path: path.into(), source })?;
    let value: Value = serde_json::from_str(&text)
        .map_err(|error| CompareError::NotJson { path: path.into(), reason: error.to_string() })?;
    let wrong = |field: &str, reason: &str| CompareError::NoReport {
        path: path.into(),
        field: field.into(),
        reason: reason.into(),
    };
    let field = |name: &str| value.get(name).ok_or_else(|| wrong(name, "it is missing"));
    let rows = field("rows")?.as_array().ok_or_else(|| wrong("rows", "it is no list"))?;
    let report = BenchReport {
        bench: part(path, "bench", field("bench")?)?,
        machine: part(path, "machine", field("machine")?)?,
        rows: rows
            .iter()
            .enumerate()
            .map(|(k, row)| part(path, &format!("rows[{k}]"), row))
            .collect::<Result<_, _>>()?,
    };
    for (k, row) in report.rows.iter().enumerate() {
        if let Some(field) = out_of_range(row) {
            return Err(wrong(&format!("rows[{k}].{field}"), "it is negative or not finite"));
        }
    }
    Ok(report)
}

fn part<T: DeserializeOwned>(path: &Path, field: &str, value: &Value) -> Result<T, CompareError> {
    serde_json::from_value(value.clone()).map_err(|error| CompareError::NoReport {
        path: path.into(),
        field: field.into(),
        reason: error.to_string(),
    })
}

/// The first figure that no time, rate or ratio can be.
fn out_of_range(row: &Row) -> Option<String> {
    let s = &row.summary;
    let is_wrong = |value: f64| !(value.is_finite() && value >= 0.0);
    let percentiles = [("p50", s.p50), ("p90", s.p90), ("p99", s.p99), ("max", s.max)];
    let percentile = percentiles.into_iter().find(|(_, value)| is_wrong(*value)).map(|(name, _)| name.to_owned());
    percentile.or_else(|| s.samples.iter().position(|v| is_wrong(*v)).map(|k| format!("samples[{k}]")))
}
