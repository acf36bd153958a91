//! What a benchmark found: rows of percentiles, as JSON with stable names and as a table.

use std::collections::BTreeMap;
use std::io::{self, Write};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Machine;

/// Where a figure comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Provenance {
    /// Measured in this run on this machine.
    Measured,
    /// Taken from a publication.
    Literature,
}

/// Percentiles of one quantity, as exact order statistics (nearest rank): the p-th percentile is the smallest sample
/// that at least p % of the samples do not exceed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of samples.
    pub n: usize,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile; none in files from before it was kept, and in literature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p99_9: Option<f64>,
    /// Largest sample.
    pub max: f64,
    /// The samples themselves in the order in which they were measured, to six digits; of more than
    /// [`Summary::KEPT`] every second, third, ... one. Empty where there are none: in literature and in ratios of
    /// percentiles.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub samples: Vec<f64>,
}

impl Summary {
    /// The largest number of samples that is kept.
    pub const KEPT: usize = 1000;

    /// A single figure, as publications give it.
    #[must_use]
    pub fn single(value: f64) -> Self {
        Self { n: 1, p50: value, p90: value, p99: value, p99_9: None, max: value, samples: Vec::new() }
    }

    /// The percentiles of durations in ns, in us; none without samples.
    #[must_use]
    pub fn of_ns_in_us(samples: &[u64]) -> Option<Self> {
        let in_us: Vec<f64> = samples.iter().map(|ns| *ns as f64 / 1e3).collect();
        Self::of(&in_us)
    }

    /// The percentiles of samples in any unit; none without samples.
    #[must_use]
    pub fn of(samples: &[f64]) -> Option<Self> {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let rank = |permille: usize| {
            let position = (sorted.len() * permille).div_ceil(1000).saturating_sub(1);
            sorted.get(position).copied()
        };
        let every = samples.len().div_ceil(Self::KEPT).max(1);
        Some(Self {
            n: sorted.len(),
            p50: rank(500)?,
            p90: rank(900)?,
            p99: rank(990)?,
            p99_9: rank(999),
            max: rank(1000)?,
            samples: samples.iter().step_by(every).copied().map(six_digits).collect(),
        })
    }

    /// This over `other`, percentile by percentile. `n` is the smaller of the two.
    #[must_use]
    pub fn over(&self, other: &Self) -> Self {
        Self {
            n: self.n.min(other.n),
            p50: self.p50 / other.p50,
            p90: self.p90 / other.p90,
            p99: self.p99 / other.p99,
            p99_9: self.p99_9.zip(other.p99_9).map(|(a, b)| a / b),
            max: self.max / other.max,
            samples: Vec::new(),
        }
    }
}

/// The value to six digits: more would be the clock's noise, and would make the files twice as long.
fn six_digits(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// One line of a report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// What was measured; stable.
    pub name: String,
    /// Under which conditions; the keys are stable.
    pub params: BTreeMap<String, Value>,
    /// Unit of the percentiles.
    pub unit: String,
    /// The percentiles.
    #[serde(flatten)]
    pub summary: Summary,
    /// Where the figures come from.
    pub provenance: Provenance,
    /// Further figures of this kind of row, for example errors of a registration.
    #[serde(flatten)]
    pub extra: BTreeMap<String, Value>,
}

/// The result of one benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchReport {
    /// Which benchmark.
    pub bench: String,
    /// Where it ran.
    pub machine: Machine,
    /// What it found.
    pub rows: Vec<Row>,
}

impl BenchReport {
    /// The rows of this name whose params agree with all of `params`.
    #[must_use]
    pub fn find(&self, name: &str, params: &[(&str, Value)]) -> Vec<&Row> {
        let agrees = |row: &Row| params.iter().all(|(key, value)| row.params.get(*key) == Some(value));
        self.rows.iter().filter(|row| row.name == name && agrees(row)).collect()
    }

    /// Prints the report as text: one table for each name, one column for each param.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn print_table(&self, out: &mut dyn Write) -> io::Result<()> {
        let m = &self.machine;
        writeln!(out, "{}: {}, {} cores, {}, commit {}", self.bench, m.cpu, m.cores, m.os, m.commit)?;
        let mut names: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !names.contains(&row.name.as_str()) {
                names.push(&row.name);
            }
        }
        for name in names {
            let rows: Vec<&Row> = self.rows.iter().filter(|row| row.name == name).collect();
            writeln!(out, "\n{name} [{}]", rows.first().map_or("", |row| row.unit.as_str()))?;
            print_aligned(out, &cells(&rows))?;
        }
        Ok(())
    }
}

/// Head line and lines of the table of rows of one name.
fn cells(rows: &[&Row]) -> Vec<Vec<String>> {
    let keys = |of: fn(&Row) -> &BTreeMap<String, Value>| {
        let set: std::collections::BTreeSet<&str> =
            rows.iter().flat_map(|r| of(r).keys().map(String::as_str)).collect();
        set.into_iter().collect::<Vec<_>>()
    };
    let (params, mut extra) = (keys(|r| &r.params), keys(|r| &r.extra));
    // Lists are for programs.
    extra.retain(|key| !rows.iter().any(|row| row.extra.get(*key).is_some_and(Value::is_array)));
    let mut head: Vec<String> = params.iter().map(ToString::to_string).collect();
    head.extend(["n", "p50", "p90", "p99", "p99.9", "max"].map(String::from));
    head.extend(extra.iter().map(ToString::to_string));
    let literature = rows.iter().any(|row| row.provenance == Provenance::Literature);
    if literature {
        head.push("provenance".into());
    }
    let mut lines = vec![head];
    for row in rows {
        let s = &row.summary;
        let mut line: Vec<String> = params.iter().map(|key| text(row.params.get(*key))).collect();
        line.push(s.n.to_string());
        line.extend([s.p50, s.p90, s.p99].map(number));
        line.push(s.p99_9.map_or_else(|| "-".into(), number));
        line.push(number(s.max));
        line.extend(extra.iter().map(|key| text(row.extra.get(*key))));
        if literature {
            line.push(format!("{:?}", row.provenance).to_lowercase());
        }
        lines.push(line);
    }
    lines
}

fn text(value: Option<&Value>) -> String {
    match value {
        None => "-".into(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(n)) if n.is_f64() => number(n.as_f64().unwrap_or(f64::NAN)),
        Some(Value::Null) => "-".into(),
        Some(Value::Object(parts)) => {
            let parts: Vec<String> = parts.iter().map(|(key, part)| format!("{key} {}", text(Some(part)))).collect();
            parts.join(", ")
        }
        Some(other) => other.to_string(),
    }
}

/// Two or more significant digits, never an exponent: figures of one column are to be compared by eye.
pub(crate) fn number(x: f64) -> String {
    match x.abs() {
        a if a >= 100.0 => format!("{x:.0}"),
        a if a >= 10.0 => format!("{x:.1}"),
        a if !(1e-9..0.1).contains(&a) => format!("{x:.2}"),
        a => format!("{x:.*}", 1 + (-a.log10()).ceil() as usize),
    }
}

pub(crate) fn print_aligned(out: &mut dyn Write, lines: &[Vec<String>]) -> io::Result<()> {
    let columns = lines.first().map_or(0, Vec::len);
    let width = |c: usize| lines.iter().filter_map(|line| line.get(c)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|c| width(c).unwrap_or(0)).collect();
    for line in lines {
        for (cell, width) in line.iter().zip(&widths) {
            write!(out, "  {cell:>width$}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report() -> BenchReport {
        let row = |transport: &str, p50: f64| Row {
            name: "hop".into(),
            params: BTreeMap::from([("transport".into(), json!(transport)), ("payload_bytes".into(), json!(64))]),
            unit: "us".into(),
            summary: Summary { n: 10, p50, p90: 2.0, p99: 3.0, p99_9: Some(4.0), max: 1234.5, samples: vec![p50, 2.0] },
            provenance: Provenance::Measured,
            extra: BTreeMap::new(),
        };
        let machine = Machine { cpu: "a".into(), cores: 2, os: "b".into(), commit: "c".into() };
        BenchReport { bench: "ipc".into(), machine, rows: vec![row("mirador", 1.5), row("pipe", 20.25)] }
    }

    #[test]
    fn percentiles_are_nearest_rank() {
        let samples: Vec<u64> = (1..=200).rev().map(|i| i * 1000).collect();
        let s = Summary::of_ns_in_us(&samples).unwrap();
        assert_eq!((s.n, s.p50, s.p90, s.p99, s.max), (200, 100.0, 180.0, 198.0, 200.0));
        let one = Summary::of_ns_in_us(&[7000]).unwrap();
        assert_eq!((one.p50, one.p99, one.max), (7.0, 7.0, 7.0));
        assert_eq!(Summary::of_ns_in_us(&[]), None);
    }

    #[test]
    fn samples_are_kept_in_their_order_and_thinned_evenly() {
        let few = Summary::of(&[3.0, 1.0, 2.000_000_4]).unwrap();
        assert_eq!(few.samples, [3.0, 1.0, 2.0]);
        let many: Vec<f64> = (0..2500).map(f64::from).collect();
        let kept = Summary::of(&many).unwrap();
        assert_eq!((kept.n, kept.samples.len(), kept.p99_9), (2500, 834, Some(2497.0)));
        assert_eq!(kept.samples[..3], [0.0, 3.0, 6.0]);
    }

    #[test]
    fn a_row_from_before_samples_were_kept_is_read() {
        let old = json!({"name": "hop", "params": {}, "unit": "us", "n": 3, "p50": 1.0, "p90": 2.0, "p99": 2.0,
                         "max": 2.0, "provenance": "measured"});
        let row: Row = serde_json::from_value(old).unwrap();
        assert!(row.summary.samples.is_empty() && row.summary.p99_9.is_none() && row.extra.is_empty());
    }

    #[test]
    fn small_numbers_keep_two_digits() {
        let shown = [0.0, 0.00062, 0.0123, 0.5, 0.987, 1.234, 56.78, 1234.5, -0.004].map(number);
        assert_eq!(shown, ["0.00", "0.00062", "0.012", "0.50", "0.99", "1.23", "56.8", "1234", "-0.0040"]);
    }

    #[test]
    fn parts_are_printed_as_words() {
        assert_eq!(text(Some(&json!({"prepare": 12.345, "align": 6.0}))), "align 6.00, prepare 12.3");
        assert_eq!(text(Some(&Value::Null)), "-");
    }

    #[test]
    fn the_json_has_the_agreed_keys_on_one_level() {
        let value = serde_json::to_value(report()).unwrap();
        assert_eq!(value["bench"], "ipc");
        assert_eq!(value["machine"], json!({"cpu": "a", "cores": 2, "os": "b", "commit": "c"}));
        assert_eq!(
            value["rows"][0],
            json!({"name": "hop", "params": {"transport": "mirador", "payload_bytes": 64}, "unit": "us", "n": 10,
                   "p50": 1.5, "p90": 2.0, "p99": 3.0, "p99_9": 4.0, "max": 1234.5, "samples": [1.5, 2.0],
                   "provenance": "measured"})
        );
    }

    #[test]
    fn a_report_survives_json() {
        let mut report = report();
        report.rows[0].extra.insert("iterations".into(), json!(7));
        let text = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<BenchReport>(&text).unwrap(), report);
    }

    #[test]
    fn rows_are_found_by_their_params() {
        let report = report();
        assert_eq!(report.find("hop", &[("transport", json!("pipe"))]), [&report.rows[1]]);
        assert!(report.find("hop", &[("payload_bytes", json!(65))]).is_empty());
    }

    #[test]
    fn the_table_has_a_column_for_each_param() {
        let mut out = Vec::new();
        report().print_table(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "ipc: a, 2 cores, b, commit c");
        assert_eq!(lines[2], "hop [us]");
        assert_eq!(lines[3].split_whitespace().collect::<Vec<_>>()[..3], ["payload_bytes", "transport", "n"]);
        assert_eq!(
            lines[4].split_whitespace().collect::<Vec<_>>(),
            ["64", "mirador", "10", "1.50", "2.00", "3.00", "4.00", "1234"]
        );
    }
}
