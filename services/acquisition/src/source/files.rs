//! Scans from files.

use std::path::PathBuf;

use mirador_core::formats::{CloudFormat, ScanFiles, StampedPose, count_points, list_scans, open_cloud, read_poses};
use mirador_core::scan::{Grid, Point};

use super::{ScanInfo, Source, SourceError, Written, limited, prior_at};
use crate::AcquisitionConfig;
use crate::config::parse_grid;

/// Time between scans whose poses carry no time [ns].
const STEP_NS: i64 = 1_000_000_000;

/// A file or a folder of scan files of one format.
pub(super) struct FileSource {
    files: Vec<PathBuf>,
    format: CloudFormat,
    cells: Vec<usize>,
    priors: Vec<StampedPose>,
    grid: Option<Grid>,
    chunk: Vec<Point>,
}

impl FileSource {
    pub(super) fn open(config: &AcquisitionConfig) -> Result<Self, SourceError> {
        let ScanFiles { format, mut files } = list_scans(&config.path)?;
        let priors = priors(config, format, files.len())?;
        files.truncate(limited(files.len(), config));
        let grid = config.grid.as_deref().map(parse_grid).transpose()?;
        let mut cells = Vec::with_capacity(files.len());
        for path in &files {
            let points = count_points(path)?;
            if let Some(Grid { rows, cols }) = grid.filter(|g| g.cells() != points) {
                return Err(SourceError::GridMismatch { path: path.clone(), points, rows, cols, cells: rows * cols });
            }
            cells.push(points);
        }
        Ok(Self { files, format, cells, priors, grid, chunk: Vec::new() })
    }
}

/// The prior poses: the configured file, else the `.pose` files beside 3DTK scans, else none.
fn priors(config: &AcquisitionConfig, format: CloudFormat, scans: usize) -> Result<Vec<StampedPose>, SourceError> {
    let beside = config.path.is_dir() && format == CloudFormat::Tdtk && has_pose_files(&config.path);
    let path = match &config.poses {
        Some(path) => path.clone(),
        None if beside => config.path.clone(),
        None => return Ok(Vec::new()),
    };
    let poses = read_poses(&path)?;
    if poses.len() == scans { Ok(poses) } else { Err(SourceError::PoseCount { path, poses: poses.len(), scans }) }
}

fn has_pose_files(folder: &std::path::Path) -> bool {
    let Ok(entries) = std::fs::read_dir(folder) else { return false };
    entries.flatten().any(|e| e.path().extension().is_some_and(|e| e == "pose"))
}

impl Source for FileSource {
    fn describe(&self) -> String {
        let first = self.files.first().map_or_else(String::new, |f| f.display().to_string());
        format!("{} {:?} file(s) from {first}", self.files.len(), self.format)
    }

    fn scans(&self) -> usize {
        self.files.len()
    }

    fn info(&self, index: usize) -> Option<ScanInfo> {
        let cells = *self.cells.get(index)?;
        let prior = self.priors.get(index);
        let recorded = prior.and_then(|p| p.stamp_s).map(|s| (s * 1e9).round() as i64);
        let stamp_ns = recorded.unwrap_or_else(|| i64::try_from(index).unwrap_or(0).saturating_mul(STEP_NS));
        Some(ScanInfo { cells, stamp_ns, prior: prior.map(|p| prior_at(&p.map_from_scanner)) })
    }

    fn write(&mut self, index: usize, out: &mut [Point]) -> Result<Written, SourceError> {
        let scans = self.files.len();
        let path = self.files.get(index).ok_or(SourceError::NoSuchScan { index, scans })?;
        let mut reader = open_cloud(path)?;
        let mut filled = 0;
        while reader.next_chunk(&mut self.chunk)? > 0 {
            if let Some(place) = out.get_mut(filled..filled + self.chunk.len()) {
                place.copy_from_slice(&self.chunk);
            }
            filled += self.chunk.len();
        }
        if filled != out.len() {
            return Err(SourceError::CountChanged { path: path.clone(), found: filled, expected: out.len() });
        }
        Ok(Written { origin: reader.origin(), grid: self.grid.or(reader.grid()), duration_ns: 0, filtered: None })
    }
}
