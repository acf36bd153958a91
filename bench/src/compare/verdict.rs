//! Which rows belong together, and what is to be said of each pair.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::statistics::{holm, independent, shift};
use super::{CompareError, CompareOptions, FEWEST};
use crate::{BenchReport, Provenance, Row};

/// Params that say how large something turned out to be, not what was measured: rows are the same without them.
const SIZES: [&str; 3] = ["points", "returns", "triangles"];

/// What became of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Slower by more than the threshold.
    Slower,
    /// Faster by more than the threshold.
    Faster,
    /// Neither can be said.
    Alike,
    /// There is too little to judge by.
    NotJudged,
}

/// Why a row is not judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Nobody has measured it.
    Literature,
    /// A report has no samples of it.
    NoSamples,
    /// There are fewer than [`FEWEST`] samples on a side.
    TooFew,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Literature => f.write_str("it comes from literature"),
            Self::NoSamples => f.write_str("a report has no `samples` (a ratio, or a file of an earlier version)"),
            Self::TooFew => write!(f, "fewer than {FEWEST} samples: measure with more repetitions"),
        }
    }
}

/// How a row has changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Change {
    /// The new time over the old one; for rates the old one over the new one: above 1 is slower.
    pub ratio: f64,
    /// Ends of the confidence interval of the ratio.
    pub interval: [f64; 2],
    /// p-value of being slower by more than the threshold, corrected for the number of tests.
    pub p_slower: f64,
    /// Likewise of being faster.
    pub p_faster: f64,
}

/// A row of both reports.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    /// Name of the row.
    pub name: String,
    /// Its params in the new report.
    pub params: BTreeMap<String, Value>,
    /// Its unit.
    pub unit: String,
    /// What became of it.
    pub verdict: Verdict,
    /// Median in the old report.
    pub old_p50: f64,
    /// Median in the new report.
    pub new_p50: f64,
    /// 99th percentiles of both, shown but not judged: the tail of one run says little.
    pub p99: [f64; 2],
    /// Samples of both.
    pub n: [usize; 2],
    /// How it has changed; none when it is not judged.
    pub change: Option<Change>,
    /// Why it is not judged.
    pub reason: Option<Reason>,
}

/// A figure without samples that grew.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drift {
    /// The row in words.
    pub row: String,
    /// Key of the figure.
    pub figure: String,
    /// Its old value.
    pub old: f64,
    /// Its new value.
    pub new: f64,
}

/// The rows that both reports have, and those that only one has.
pub(super) struct Pairs {
    pairs: Vec<(Row, Row)>,
    pub only_old: Vec<String>,
    pub only_new: Vec<String>,
}

impl Pairs {
    pub fn of(old: &BenchReport, new: &BenchReport, old_path: &Path, new_path: &Path) -> Result<Self, CompareError> {
        let mut olds = by_key(old, old_path)?;
        by_key(new, new_path)?;
        let (mut pairs, mut only_new) = (Vec::new(), Vec::new());
        for row in &new.rows {
            let Some((_, before)) = olds.remove(&key(row)) else {
                only_new.push(words(row));
                continue;
            };
            if before.unit != row.unit {
                return Err(CompareError::OtherUnit {
                    row: words(row),
                    old: old_path.into(),
                    old_unit: before.unit.clone(),
                    new: new_path.into(),
                    new_unit: row.unit.clone(),
                });
            }
            pairs.push((before.clone(), row.clone()));
        }
        if pairs.is_empty() {
            return Err(CompareError::NoCommonRow { old: old_path.into(), new: new_path.into() });
        }
        let mut left: Vec<(usize, &Row)> = olds.into_values().collect();
        left.sort_by_key(|(place, _)| *place);
        Ok(Self { pairs, only_old: left.into_iter().map(|(_, row)| words(row)).collect(), only_new })
    }

    /// The verdict on every pair.
    pub fn judge(&self, options: &CompareOptions) -> Vec<Compared> {
        let mut rows: Vec<Compared> = self.pairs.iter().map(|(old, new)| compared(old, new, options)).collect();
        let judged = |row: &Compared| row.change.map(|change| [change.p_slower, change.p_faster]);
        let family: Vec<f64> = rows.iter().filter_map(judged).flatten().collect();
        let mut adjusted = holm(&family).into_iter();
        for row in &mut rows {
            let Some(change) = &mut row.change else { continue };
            if let (Some(slower), Some(faster)) = (adjusted.next(), adjusted.next()) {
                (change.p_slower, change.p_faster) = (slower, faster);
            }
            row.verdict = match change {
                change if change.p_slower <= options.alpha => Verdict::Slower,
                change if change.p_faster <= options.alpha => Verdict::Faster,
                _ => Verdict::Alike,
            };
        }
        let size = |row: &Compared| row.change.map_or(0.0, |change| change.ratio.max(1e-300).ln().abs());
        rows.sort_by(|a, b| a.verdict.cmp(&b.verdict).then(size(b).total_cmp(&size(a))));
        rows
    }

    /// Errors that grew by more than `threshold`.
    pub fn drifts(&self, threshold: f64) -> Vec<Drift> {
        let mut drifts = Vec::new();
        for (old, new) in &self.pairs {
            let is_error = |key: &str| key.contains("error") || key.starts_with("ate_");
            for (figure, value) in new.extra.iter().filter(|(key, _)| is_error(key)) {
                let (Some(before), Some(now)) = (old.extra.get(figure).and_then(Value::as_f64), value.as_f64()) else {
                    continue;
                };
                // The last digits of a sum in another order are no drift.
                if now > before * (1.0 + threshold) + 1e-9 {
                    drifts.push(Drift { row: words(new), figure: figure.clone(), old: before, new: now });
                }
            }
        }
        drifts
    }
}

/// A report's rows by what they are, with their place.
fn by_key<'a>(report: &'a BenchReport, path: &Path) -> Result<BTreeMap<String, (usize, &'a Row)>, CompareError> {
    let mut rows = BTreeMap::new();
    for (second, row) in report.rows.iter().enumerate() {
        if let Some((first, _)) = rows.insert(key(row), (second, row)) {
            return Err(CompareError::SameRow { path: path.into(), first, second, row: words(row) });
        }
    }
    Ok(rows)
}

fn key(row: &Row) -> String {
    let params: Vec<String> =
        row.params.iter().filter(|(k, _)| !SIZES.contains(&k.as_str())).map(|(k, v)| format!("{k}={v}")).collect();
    format!("{}|{:?}|{}", row.name, row.provenance, params.join("|"))
}

/// A row for people.
fn words(row: &Row) -> String {
    named(&row.name, &row.params)
}

pub(super) fn named(name: &str, params: &BTreeMap<String, Value>) -> String {
    let word = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let params: Vec<String> =
        params.iter().filter(|(_, v)| !v.is_null()).map(|(k, v)| format!("{k} {}", word(v))).collect();
    if params.is_empty() { name.to_owned() } else { format!("{name} ({})", params.join(", ")) }
}

fn compared(old: &Row, new: &Row, options: &CompareOptions) -> Compared {
    let (before, now) = (&old.summary, &new.summary);
    let reason = reason(old, new);
    let change = reason.is_none().then(|| {
        // A rate is the better the greater it is; its inverse is a time.
        let times = |samples: &[f64]| {
            let is_rate = new.unit == "1/s";
            let time = |v: &f64| if is_rate { 1.0 / v.max(f64::MIN_POSITIVE) } else { *v };
            independent(&samples.iter().map(time).collect::<Vec<_>>())
        };
        let shift = shift(&times(&before.samples), &times(&now.samples), options.threshold, 1.0 - options.alpha);
        Change { ratio: shift.ratio, interval: shift.interval, p_slower: shift.p_greater, p_faster: shift.p_smaller }
    });
    Compared {
        name: new.name.clone(),
        params: new.params.clone(),
        unit: new.unit.clone(),
        verdict: Verdict::NotJudged,
        old_p50: before.p50,
        new_p50: now.p50,
        p99: [before.p99, now.p99],
        n: [before.n, now.n],
        change,
        reason,
    }
}

fn reason(old: &Row, new: &Row) -> Option<Reason> {
    let fewest = old.summary.samples.len().min(new.summary.samples.len());
    if old.provenance == Provenance::Literature || new.provenance == Provenance::Literature {
        Some(Reason::Literature)
    } else if fewest == 0 {
        Some(Reason::NoSamples)
    } else if fewest < FEWEST {
        Some(Reason::TooFew)
    } else {
        None
    }
}
