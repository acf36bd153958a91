//! The outputs of a run: `summary.json`, `trace.json`, `trajectory.tum`, `model.ply`, `map.png` and `report.html`, all made
//! from `run.mcap` and what the supervisor knows beside it.

mod canvas;
mod drive;
mod facts;
mod histogram;
mod latency;
mod map_image;
mod model;
mod plots;
mod progress_plot;
mod registration;
mod report;
mod run_data;
mod scan_path;
mod scan_picture;
mod summary;
mod timeline;
mod trace;
mod trajectory;
mod work;

#[cfg(test)]
pub(crate) mod testing;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use mirador_core::formats::WriteError;
use mirador_recorder::{RUN_FILE, ReadError, RunReader};

pub use drive::{Drive, GivenUp};
pub use facts::{RunFacts, ServiceTotals};
pub use histogram::{Latencies, Quantiles};
pub use latency::{STAGES, Stage};
pub use registration::RegistrationTotals;
pub use run_data::{FinalMap, RunData, ScanRecord, SourceEnd};
pub use summary::{Errors, PoseSummary, Summary};
pub use timeline::{GAPS, Gap, Timeline};
pub use trace::chrome_trace;
pub use work::{PARTS, ScanUsage, ServiceWork, Usage, WorkLog, WorkQuantiles, WorkTimes};

/// Why an output cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The recording cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The model cannot be written.
    #[error(transparent)]
    Model(#[from] WriteError),
    /// A file cannot be written.
    #[error("cannot write '{path}': {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A picture or plot cannot be drawn.
    #[error("cannot draw {what}: {reason}")]
    Draw {
        /// What was to be drawn.
        what: &'static str,
        /// What the library said.
        reason: String,
    },
}

/// Makes all outputs of the run in `run_dir` and returns its figures.
///
/// # Errors
/// See [`OutputError`]. The outputs made before the error stay.
pub fn write_all(run_dir: &Path, facts: &RunFacts) -> Result<Summary, OutputError> {
    let mut reader = RunReader::open(&run_dir.join(RUN_FILE))?;
    let data = RunData::read(&mut reader)?;
    let facts = &facts.with_truth_of(&data);
    // A model that cannot be written (a full disk) keeps nothing else from being there.
    let model = model::write_model(&mut reader, &data, facts, &run_dir.join("model.ply"));
    let summary = Summary::of(&data, facts, model.as_ref().ok().copied().flatten());
    // A summary of numbers and texts always has a JSON form; a writer in memory cannot fail either.
    let json = serde_json::to_vec_pretty(&summary)
        .map_err(|e| OutputError::Draw { what: "summary.json", reason: e.to_string() })?;
    put(run_dir, "summary.json", &json)?;
    put(run_dir, "trace.json", chrome_trace(&data, 0).to_string().as_bytes())?;
    let mut tum = Vec::new();
    let path = run_dir.join("trajectory.tum");
    trajectory::write_tum(&data, &mut tum).map_err(|source| OutputError::Write { path, source })?;
    put(run_dir, "trajectory.tum", &tum)?;
    let map = map_image::draw(&data).png()?;
    put(run_dir, "map.png", &map)?;
    let report = report::render(&data, facts, &summary, &map)?;
    put(run_dir, "report.html", report.as_bytes())?;
    model?;
    Ok(summary)
}

fn put(run_dir: &Path, name: &str, bytes: &[u8]) -> Result<(), OutputError> {
    let path = run_dir.join(name);
    fs::write(&path, bytes).map_err(|source| OutputError::Write { path, source })
}

/// A text for one line of a file.
fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests;
