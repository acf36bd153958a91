//! Why two reports cannot be compared.

use std::path::PathBuf;

use super::Reason;

/// Why two reports cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// An option is outside its range.
    #[error("--{field} {value}: give {right}")]
    BadOption {
        /// Name of the option.
        field: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        right: &'static str,
    },
    /// A file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is no JSON.
    #[error("{path}: not JSON: {reason}")]
    NotJson {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        reason: String,
    },
    /// A file is JSON, but no report of a benchmark.
    #[error("{path}: {field}: {reason}; it is not what `mirador bench WHAT --json FILE` writes")]
    NoReport {
        /// The file.
        path: PathBuf,
        /// The field that is wrong, for example `rows[3]`.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Two rows of one report cannot be told apart.
    #[error("{path}: rows[{first}] and rows[{second}] are both {row}")]
    SameRow {
        /// The file.
        path: PathBuf,
        /// Place of the first.
        first: usize,
        /// Place of the second.
        second: usize,
        /// The row in words.
        row: String,
    },
    /// The reports are of different benchmarks.
    #[error("{old} has bench \"{old_bench}\" and {new} has bench \"{new_bench}\": they measure different things")]
    OtherBench {
        /// The earlier file.
        old: PathBuf,
        /// Its benchmark.
        old_bench: String,
        /// The later file.
        new: PathBuf,
        /// Its benchmark.
        new_bench: String,
    },
    /// A row changed its unit.
    #[error("{row}: unit \"{old_unit}\" in {old}, \"{new_unit}\" in {new}")]
    OtherUnit {
        /// The row in words.
        row: String,
        /// The earlier file.
        old: PathBuf,
        /// Its unit.
        old_unit: String,
        /// The later file.
        new: PathBuf,
        /// Its unit.
        new_unit: String,
    },
    /// No row is in both reports.
    #[error("{old} and {new} have no row with the same name and params: measure both with the same options")]
    NoCommonRow {
        /// The earlier file.
        old: PathBuf,
        /// The later file.
        new: PathBuf,
    },
    /// There are common rows, but none with enough samples.
    #[error("{old} and {new}: nothing can be judged: {reason}")]
    NothingJudged {
        /// The earlier file.
        old: PathBuf,
        /// The later file.
        new: PathBuf,
        /// Why not the first of them.
        reason: Reason,
    },
}
