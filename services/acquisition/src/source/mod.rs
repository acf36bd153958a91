//! What delivers scans: one trait, four sources.

mod capture;
mod files;
mod recording;

mod scene;

#[cfg(test)]
mod conformance;

use std::path::PathBuf;

use mirador_core::formats::{CaptureError, FormatError};
use mirador_core::geometry::{Pose, rows_from_pose};
use mirador_core::scan::{Grid, Point};
use mirador_ipc_schema::messages::PoseEstimate;

use crate::{AcquisitionConfig, ConfigError, SourceKind};
pub use scene::{scene_of, true_poses};

/// What is known of a scan before its points are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanInfo {
    /// Cells of the scan: the number of points that will be written.
    pub cells: usize,
    /// Time of the scan [ns], recorded or simulated.
    pub stamp_ns: i64,
    /// Prior pose, if the source has one: as it goes out, since a pose that is turned into a matrix, back and again into
    /// a matrix does not come out with the same bits.
    pub prior: Option<PoseEstimate>,
}

/// A recorded or simulated pose map_from_scanner as a prior.
fn prior_at(map_from_scanner: &Pose) -> PoseEstimate {
    PoseEstimate { map_from_scanner: rows_from_pose(map_from_scanner), ..PoseEstimate::default() }
}

/// What is known of a scan once its points are written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Written {
    /// What to add to the points to get the file's own coordinates [m].
    pub origin: [f64; 3],
    /// The order of the points.
    pub grid: Option<Grid>,
    /// How long the scan took [ns], 0 when unknown.
    pub duration_ns: u64,
    /// How the points were filtered already, when the source is a recording.
    pub filtered: Option<Filtered>,
}

/// A filter that was applied when the scan was first taken in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filtered {
    /// The shortest range that was kept [m].
    pub range_min_m: f32,
    /// The longest range that was kept [m].
    pub range_max_m: f32,
    /// Number of returns that were emptied.
    pub emptied: u32,
}

/// A source of scans, known in number and size from the start. Scans can be written in any order and any number of
/// times, always with the same bits: a restarted reader may ask for an old one again.
pub trait Source {
    /// In words, for the log.
    fn describe(&self) -> String;
    /// Number of scans.
    fn scans(&self) -> usize;
    /// What is known of scan `index`; `None` beyond the last.
    fn info(&self, index: usize) -> Option<ScanInfo>;
    /// Writes the points of scan `index` in the scanner's frame. `out` has exactly its cells.
    ///
    /// # Errors
    /// Names the file and what is wrong with it.
    fn write(&mut self, index: usize, out: &mut [Point]) -> Result<Written, SourceError>;

    /// Cells of the largest scan.
    fn largest_scan(&self) -> usize {
        (0..self.scans()).filter_map(|i| self.info(i)).map(|i| i.cells).max().unwrap_or(0)
    }
}

/// Why a source cannot deliver.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// A file or folder is not what it should be.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A capture of packets is not what it should be.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The scene cannot be had.
    #[error("{0}")]
    Scene(String),
    /// The recording cannot be read.
    #[error("{0}")]
    Recording(String),
    /// There is not one prior pose per scan.
    #[error("{path}: {poses} poses for {scans} scans; it needs one line per scan")]
    PoseCount {
        /// The pose file.
        path: PathBuf,
        /// Poses in it.
        poses: usize,
        /// Scans of the source.
        scans: usize,
    },
    /// The grid does not fit the number of points.
    #[error(
        "{path}: {points} points do not fill the grid {rows}x{cols} = {cells}; give the right --grid ROWSxCOLS, or none"
    )]
    GridMismatch {
        /// The scan file.
        path: PathBuf,
        /// Its points.
        points: usize,
        /// Rows asked for.
        rows: usize,
        /// Columns asked for.
        cols: usize,
        /// Their product.
        cells: usize,
    },
    /// A file changed between counting and reading, or a scan was asked for that does not exist.
    #[error("{path}: {found} points where {expected} were counted; the file changed or is damaged")]
    CountChanged {
        /// The scan file.
        path: PathBuf,
        /// Points read.
        found: usize,
        /// Points counted.
        expected: usize,
    },
    /// No scan of this number.
    #[error("there is no scan {index}; the source has {scans}")]
    NoSuchScan {
        /// The number asked for.
        index: usize,
        /// Scans of the source.
        scans: usize,
    },
}

/// Opens the configured source; every scan is counted, none is read.
///
/// # Errors
/// See [`SourceError`].
pub fn open_source(config: &AcquisitionConfig, threads: usize) -> Result<Box<dyn Source>, SourceError> {
    config.validate()?;
    match config.source {
        SourceKind::Scene => Ok(Box::new(scene::SceneSource::open(config, threads)?)),
        SourceKind::Replay if config.path.extension().is_some_and(|e| e == "mcap") => {
            Ok(Box::new(recording::RecordingSource::open(config)?))
        }
        SourceKind::Replay if config.path.extension().is_some_and(|e| e == "pcap" || e == "pcapng") => {
            Ok(Box::new(capture::CaptureSource::open(config)?))
        }
        SourceKind::Replay => Ok(Box::new(files::FileSource::open(config)?)),
        SourceKind::Robot => Err(SourceError::Scene("scans of a robot are not known before they are taken".into())),
    }
}

/// The number of scans after the limit of the configuration.
fn limited(scans: usize, config: &AcquisitionConfig) -> usize {
    if config.max_scans == 0 { scans } else { scans.min(config.max_scans as usize) }
}
