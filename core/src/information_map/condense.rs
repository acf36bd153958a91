//! From a scored scan to its evidence: returns of the same small place are taken together, kept triangles are
//! rasterised over the cells between.
//!
//! Work goes by blocks of 16 x 16 cells of the scan's grid (256 points in a row where there is none): neighbours in the
//! grid are mostly neighbours in the map, and a block's table stays in the first cache. Each block is done by one
//! thread, and blocks are put together in their order: the number of threads does not change a bit.

use super::band::{BAND_POINTS, BAND_ROWS, Band};
use super::block::Thresholds;
use super::config::MapConfig;
use super::index::{CellIndex, LARGEST_COORDINATE, floor};
use super::item::{CELL_UNITS, HEIGHT_UNITS_PER_METRE, Item, PLACE_LIMIT};
use super::scan_evidence::ScanEvidence;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::scan::{Grid, ScanView};
use crate::simd::widest;
use crate::threads;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use thiserror::Error;

/// Why a scan cannot be put into the map; the map is then unchanged.
#[derive(Debug, Clone, PartialEq, Error)]
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
    /// The pose lies beyond the largest map.
    #[error(
        "information map: the pose map_from_scanner is at ({x:.0}, {y:.0}, {z:.0}) m, beyond the largest map of {limit:.0} m around the origin and 500 km in height; give poses relative to a nearer origin"
    )]
    PoseTooFar {
        /// Its position [m].
        x: f64,
        /// Its position [m].
        y: f64,
        /// Its position [m].
        z: f64,
        /// The largest distance [m].
        limit: f64,
    },
    /// The summary was made for cells of another size.
    #[error("information map: the scan was condensed for cells of {found} m, the map's are {expected} m")]
    CellMismatch {
        /// Cells of the summary [m].
        found: f64,
        /// Cells of the map [m].
        expected: f64,
    },
}

/// What was made of one scan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CondenseSummary {
    /// Points that count.
    pub points: usize,
    /// Returns left out because they have no score.
    pub points_without_score: usize,
    /// Returns left out because they are more than 4,096 cells or 8 km from the scanner.
    pub points_outside: usize,
    /// Kept triangles longer than nine tenths of a cell, which were rasterised.
    pub triangles: usize,
    /// Of those, the ones that cover more cells than allowed and were cut off there.
    pub triangles_clipped: usize,
}

/// Condenses one scan after the other. Its buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct Condenser {
    bands: Vec<Band>,
    evidence: Option<ScanEvidence>,
}

impl Condenser {
    /// A condenser without buffers yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Condenses one aligned, scored scan. `scores[i]` belongs to `scan.points[i]`; `map_from_scanner` is the aligned
    /// pose (z up in the map).
    ///
    /// Returns of the same half cell, quarter of a metre in height, and kind (navigable, obstacle) become one item with
    /// their mean place, scores and normal; those that say neither are taken together by whole cells and half metres.
    /// Every kept triangle of an ordered scan with a reachable corner that is longer than nine tenths of a cell gives an
    /// item to each cell whose middle it covers.
    ///
    /// # Errors
    /// See [`InsertError`].
    pub fn condense(
        &mut self,
        scan: ScanView<'_>,
        scores: &[PointScore],
        map_from_scanner: &Pose,
        config: &MapConfig,
        threads: usize,
    ) -> Result<(&ScanEvidence, CondenseSummary), InsertError> {
        check(scan, scores)?;
        check_pose(map_from_scanner, config)?;
        let frame = Frame::new(map_from_scanner, config);
        let bands = match scan.grid {
            Some(grid) => grid.rows.div_ceil(BAND_ROWS),
            None => scan.points.len().div_ceil(BAND_POINTS),
        };
        if self.bands.len() < bands {
            self.bands.resize_with(bands, Band::default);
        }
        threads::for_each(self.bands[..bands].iter_mut().enumerate(), threads, |(k, band)| {
            widest(
                #[inline(always)]
                || match scan.grid {
                    Some(grid) => band.take_rows(scan.points, scores, grid, k * BAND_ROWS, &frame),
                    None => band.take_points(scan.points, scores, k * BAND_POINTS, &frame),
                },
            );
        });
        let is_ordered = scan.grid.is_some();
        let evidence = self.evidence.get_or_insert_with(ScanEvidence::empty);
        frame.describe(map_from_scanner, config, evidence);
        let summary = put_together(&self.bands[..bands], is_ordered, &mut evidence.items);
        Ok((evidence, summary))
    }

    /// The summary of the scan condensed last.
    #[must_use]
    pub fn last(&self) -> Option<&ScanEvidence> {
        self.evidence.as_ref()
    }
}

/// The items of all bands in order, and what became of the points.
fn put_together(bands: &[Band], is_ordered: bool, items: &mut Vec<Item>) -> CondenseSummary {
    let mut summary = CondenseSummary::default();
    items.clear();
    for band in bands {
        items.extend_from_slice(&band.items);
        summary.points += band.found.counted;
        summary.points_without_score += band.found.without_score;
        summary.points_outside += band.found.outside;
    }
    for band in bands.iter().filter(|_| is_ordered) {
        items.extend_from_slice(&band.patches);
        summary.triangles += band.tally.triangles;
        summary.triangles_clipped += band.tally.clipped;
    }
    summary
}

fn check(scan: ScanView<'_>, scores: &[PointScore]) -> Result<(), InsertError> {
    let points = scan.points.len();
    if points != scores.len() {
        return Err(InsertError::CountMismatch { points, scores: scores.len() });
    }
    if let Some(Grid { rows, cols }) = scan.grid
        && rows.checked_mul(cols) != Some(points)
    {
        return Err(InsertError::GridMismatch { rows, cols, points });
    }
    Ok(())
}

/// Whether a scan can be at a pose.
pub(super) fn check_pose(map_from_scanner: &Pose, config: &MapConfig) -> Result<(), InsertError> {
    if map_from_scanner.to_homogeneous().iter().any(|v| !v.is_finite()) {
        return Err(InsertError::PoseNotFinite);
    }
    // So far that no place of the scan leaves the largest map.
    let limit = f64::from(LARGEST_COORDINATE - 4 * (PLACE_LIMIT / CELL_UNITS)) * config.cell_m;
    let highest = f64::from(1 << 28) / HEIGHT_UNITS_PER_METRE;
    let [x, y, z]: [f64; 3] = map_from_scanner.translation.vector.into();
    if x.abs() > limit || y.abs() > limit || z.abs() > highest {
        return Err(InsertError::PoseTooFar { x, y, z, limit });
    }
    Ok(())
}

/// From the scanner's frame to units relative to the summary's anchor; and what the config means for stored scores.
pub(super) struct Frame {
    linear: Matrix3<f64>,
    offset: Vector3<f64>,
    rotation: Matrix3<f32>,
    anchor: CellIndex,
    anchor_height: i32,
    pub thresholds: Thresholds,
    pub max_cells: usize,
}

impl Frame {
    pub fn new(map_from_scanner: &Pose, config: &MapConfig) -> Self {
        let per_metre = f64::from(CELL_UNITS) / config.cell_m;
        let scale = Vector3::new(per_metre, per_metre, HEIGHT_UNITS_PER_METRE);
        let rotation = map_from_scanner.rotation.to_rotation_matrix().into_inner();
        let position = map_from_scanner.translation.vector.component_mul(&scale);
        let units = f64::from(CELL_UNITS);
        let anchor = CellIndex { x: floor(position.x / units), y: floor(position.y / units) };
        let anchor_height = floor(position.z);
        let origin = Vector3::new(f64::from(anchor.x) * units, f64::from(anchor.y) * units, f64::from(anchor_height));
        Self {
            linear: Matrix3::from_diagonal(&scale) * rotation,
            offset: position - origin,
            rotation: rotation.cast(),
            anchor,
            anchor_height,
            thresholds: Thresholds::of(config),
            max_cells: config.max_cells_per_triangle,
        }
    }

    fn describe(&self, map_from_scanner: &Pose, config: &MapConfig, evidence: &mut ScanEvidence) {
        evidence.cell_m = config.cell_m;
        evidence.anchor = self.anchor;
        evidence.anchor_height = self.anchor_height;
        evidence.map_from_scanner = *map_from_scanner;
    }

    /// One axis of a point's place: what its coordinates are multiplied by, what is added, and what more so that it is
    /// rounded. Heights are, places across are in the unit that contains them.
    #[inline(always)]
    pub fn row(&self, axis: usize) -> ([f64; 3], f64, f64) {
        let (m, t) = (&self.linear, &self.offset);
        match axis {
            0 => ([m.m11, m.m12, m.m13], t.x, 0.0),
            1 => ([m.m21, m.m22, m.m23], t.y, 0.0),
            _ => ([m.m31, m.m32, m.m33], t.z, 0.5),
        }
    }

    /// A point in units, not rounded.
    #[cfg(test)]
    pub fn exact(&self, point: &crate::scan::Point) -> [f64; 3] {
        let at = [f64::from(point.x), f64::from(point.y), f64::from(point.z)];
        [0, 1, 2].map(|axis| {
            let (factors, offset, rounding) = self.row(axis);
            factors.iter().zip(&at).map(|(f, x)| f * x).sum::<f64>() + offset + rounding
        })
    }

    /// A vector of the scanner's frame in the map's.
    #[inline(always)]
    pub fn turn(&self, v: &Vector3<f32>) -> Vector3<f32> {
        let m = &self.rotation;
        Vector3::new(
            m.m11 * v.x + m.m12 * v.y + m.m13 * v.z,
            m.m21 * v.x + m.m22 * v.y + m.m23 * v.z,
            m.m31 * v.x + m.m32 * v.y + m.m33 * v.z,
        )
    }
}
