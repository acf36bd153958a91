//! Projecting a scan into the map (4.1): points count in their cell, kept triangles fill the cells between.

use super::frame::Frame;
use super::index::CellIndex;
use super::map::InformationMap;
use super::projection::Projection;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::scan::{Grid, ScanView};
use serde::Serialize;
use thiserror::Error;

/// Why a scan cannot be projected; the map is then unchanged.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum InsertError {
    /// Scores belong to points by index, so there must be one each.
    #[error("information map: the scan has {points} points but {scores} scores; give one score a point")]
    CountMismatch {
        /// Points of the scan.
        points: usize,
        /// Scores given.
        scores: usize,
    },
    /// The grid of an ordered scan does not multiply up to its points.
    #[error("information map: a grid of {rows} x {cols} does not hold {points} points")]
    GridMismatch {
        /// Lines of the grid.
        rows: usize,
        /// Points a line.
        cols: usize,
        /// Points of the scan.
        points: usize,
    },
    /// The pose holds a value that is not finite.
    #[error("information map: the pose map_from_scanner is not finite")]
    PoseNotFinite,
}

/// What one scan brought.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct InsertSummary {
    /// Points counted in a cell.
    pub points: usize,
    /// Returns left out because they have no score.
    pub points_without_score: usize,
    /// Returns left out because they lie beyond the largest map.
    pub points_outside: usize,
    /// Kept triangles that reach over cells without a corner of theirs and were rasterised.
    pub triangles: usize,
    /// Of those, the ones that cover more cells than allowed and were cut off there.
    pub triangles_clipped: usize,
    /// Different cells that received evidence.
    pub cells_touched: usize,
    /// Of those, the ones that were unknown before.
    pub new_cells: usize,
    /// Tiles that received evidence.
    pub tiles_changed: usize,
}

/// Reused between scans.
#[derive(Debug, Clone, Default)]
pub(super) struct InsertBuffers {
    /// The cell of every point.
    cells: Vec<CellIndex>,
}

impl InformationMap {
    /// Projects one aligned, scored scan. Every scored point counts in its cell; every kept triangle of an ordered
    /// scan with a reachable corner gives interpolated evidence, with the mean scores of its corners, to the cells it
    /// covers that hold none of its corners. `scores[i]` belongs to `scan.points[i]`; `map_from_scanner` is the
    /// aligned pose (z up in the map).
    ///
    /// The sums are integers: inserting the same scans in another order gives the same cells, bit for bit.
    ///
    /// # Errors
    /// See [`InsertError`]; the map is then unchanged.
    pub fn insert(
        &mut self,
        scan: ScanView<'_>,
        scores: &[PointScore],
        map_from_scanner: &Pose,
    ) -> Result<InsertSummary, InsertError> {
        check(scan, scores, map_from_scanner)?;
        self.revision += 1;
        let mut cells = std::mem::take(&mut self.buffers.cells);
        let frame = Frame::new(map_from_scanner, &self.config);
        let mut projection = Projection::new(&mut self.tiles, &mut self.slots, self.revision);
        projection.add_points(scan.points, scores, &frame, &mut cells);
        if let Some(grid) = scan.grid {
            projection.add_triangles(scan.points, scores, grid, &frame, &cells);
        }
        let summary = projection.summary;
        self.buffers.cells = cells;
        Ok(summary)
    }
}

fn check(scan: ScanView<'_>, scores: &[PointScore], map_from_scanner: &Pose) -> Result<(), InsertError> {
    let points = scan.points.len();
    if points != scores.len() {
        return Err(InsertError::CountMismatch { points, scores: scores.len() });
    }
    if let Some(Grid { rows, cols }) = scan.grid
        && rows.checked_mul(cols) != Some(points)
    {
        return Err(InsertError::GridMismatch { rows, cols, points });
    }
    if map_from_scanner.to_homogeneous().iter().any(|v| !v.is_finite()) {
        return Err(InsertError::PoseNotFinite);
    }
    Ok(())
}

#[cfg(test)]
#[path = "insert_tests.rs"]
mod tests;
