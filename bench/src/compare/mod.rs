//! `mirador bench compare OLD.json NEW.json`: what became slower, and what faster, by a statistical test.
//!
//! Rows of the same name, params and unit are compared by their samples. A row is slower when its new samples are
//! greater than the old ones *by more than the threshold*: a one-sided Mann-Whitney test (Mann and Whitney 1947) of the
//! new samples against the old ones times 1 + threshold, likewise for faster. The two tests of all rows form one family,
//! whose p-values are corrected by Holm's method (Holm 1979): the chance that noise alone makes anything at all a
//! regression is at most `alpha`. The size of the change is the median of all ratios of a new to an old sample (Hodges
//! and Lehmann 1963) with its confidence interval.
//!
//! Samples that follow each other resemble each other. Where there are many, they are replaced by the medians of
//! [`BATCHES`] consecutive batches, so that the test does not take them for more than they are. What differs from run to
//! run as a whole (placement in memory, other load) no test of two runs can see: that is what the threshold is for.

mod error;
mod print;
mod read;
mod statistics;
mod verdict;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use error::CompareError;
pub use print::print;
pub use verdict::{Change, Compared, Drift, Reason, Verdict};

use crate::Machine;

/// Batches whose medians stand for many samples.
pub const BATCHES: usize = 30;
/// With fewer samples on either side a row is not judged: the least p-value that the test can give is too large.
pub const FEWEST: usize = 8;

/// How strictly two reports are compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CompareOptions {
    /// Changes up to this share are none.
    pub threshold: f64,
    /// The largest chance that noise alone makes anything a regression.
    pub alpha: f64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { threshold: 0.05, alpha: 0.01 }
    }
}

impl CompareOptions {
    /// Checks both values.
    ///
    /// # Errors
    /// [`CompareError::BadOption`] names the value and what would be right.
    pub fn validate(&self) -> Result<(), CompareError> {
        if !(0.0..=10.0).contains(&self.threshold) {
            return Err(CompareError::BadOption { field: "threshold", value: self.threshold, right: "0 to 10" });
        }
        if !(self.alpha > 0.0 && self.alpha <= 0.5) {
            return Err(CompareError::BadOption { field: "alpha", value: self.alpha, right: "above 0 to 0.5" });
        }
        Ok(())
    }
}

/// One of the two reports.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Side {
    /// Its file.
    pub file: PathBuf,
    /// Where it was measured.
    pub machine: Machine,
}

/// What became of everything that was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Which benchmark.
    pub bench: String,
    /// The earlier report.
    pub old: Side,
    /// The later report.
    pub new: Side,
    /// How strictly they were compared.
    pub options: CompareOptions,
    /// What of the machine differs, in words; empty on the same machine.
    pub machine_differs: Vec<String>,
    /// Rows that both have: slower ones first, then faster ones, each by the size of the change.
    pub rows: Vec<Compared>,
    /// Errors and other figures without samples that grew by more than the threshold; they are shown and judged by nobody.
    pub drifts: Vec<Drift>,
    /// Rows that only the old report has, in words.
    pub only_old: Vec<String>,
    /// Rows that only the new report has, in words.
    pub only_new: Vec<String>,
}

impl Comparison {
    /// The rows with this verdict.
    pub fn of(&self, verdict: Verdict) -> impl Iterator<Item = &Compared> {
        self.rows.iter().filter(move |row| row.verdict == verdict)
    }

    /// Whether anything became slower.
    #[must_use]
    pub fn is_regression(&self) -> bool {
        self.of(Verdict::Slower).next().is_some()
    }
}

/// Compares two files that `mirador bench WHAT --json FILE` has written.
///
/// # Errors
/// See [`CompareError`]: a file cannot be read, is no report, or the two have nothing that can be compared.
pub fn compare(old: &Path, new: &Path, options: &CompareOptions) -> Result<Comparison, CompareError> {
    options.validate()?;
    let (old_report, new_report) = (read::report(old)?, read::report(new)?);
    if old_report.bench != new_report.bench {
        return Err(CompareError::OtherBench {
            old: old.to_path_buf(),
            old_bench: old_report.bench,
            new: new.to_path_buf(),
            new_bench: new_report.bench,
        });
    }
    let pairs = verdict::Pairs::of(&old_report, &new_report, old, new)?;
    let rows = pairs.judge(options);
    if !rows.iter().any(|row| row.change.is_some()) {
        let reason = rows.iter().find_map(|row| row.reason).unwrap_or(Reason::Literature);
        return Err(CompareError::NothingJudged { old: old.to_path_buf(), new: new.to_path_buf(), reason });
    }
    Ok(Comparison {
        drifts: pairs.drifts(options.threshold),
        only_old: pairs.only_old,
        only_new: pairs.only_new,
        machine_differs: differences(&old_report.machine, &new_report.machine),
        bench: old_report.bench,
        old: Side { file: old.to_path_buf(), machine: old_report.machine },
        new: Side { file: new.to_path_buf(), machine: new_report.machine },
        options: *options,
        rows,
    })
}

/// What differs between two machines, in words. Another commit is what a comparison is for.
fn differences(old: &Machine, new: &Machine) -> Vec<String> {
    let fields = [
        ("cpu", old.cpu.clone(), new.cpu.clone()),
        ("cores", old.cores.to_string(), new.cores.to_string()),
        ("os", old.os.clone(), new.os.clone()),
    ];
    let different = fields.into_iter().filter(|(_, old, new)| old != new);
    different.map(|(field, old, new)| format!("{field}: {old} -> {new}")).collect()
}
