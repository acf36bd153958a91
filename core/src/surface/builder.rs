//! The builder: one pass after the other over reused buffers.

use super::cloud::Cloud;
use super::config::{SurfaceConfig, SurfaceConfigError};
use super::discarded;
use super::filter::{Line, Smoother};
use super::legs::{LegTest, Sample};
use super::mesh::Mesh;
use super::quality::QualityScale;
use super::topology::Topology;
use super::view::{Surface, SurfacePoint};
use crate::scan::{Grid, Point, ScanView};
use crate::threads::{for_blocks, for_blocks2};

/// Why a scan has no surface.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// The view was put together by hand with a grid that is not that of its points.
    #[error("the scan has {points} points, but its grid has {rows} x {cols} cells: they must be equal")]
    GridMismatch {
        /// Points of the scan.
        points: usize,
        /// Rows of the grid.
        rows: usize,
        /// Columns of the grid.
        cols: usize,
    },
    /// Indices of points are stored in 32 bits, with the highest standing for none.
    #[error("the scan has {points} points: at most 2147483647 can be indexed")]
    TooLarge {
        /// Points of the scan.
        points: usize,
    },
    /// A setting outside its range.
    #[error(transparent)]
    Config(#[from] SurfaceConfigError),
}

/// Builds the surface of one scan after the other. Buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct SurfaceBuilder {
    surface: Surface,
    directions: Vec<[f32; 3]>,
    inverse_ranges: Vec<f32>,
    smoothed: Vec<f32>,
    samples: Vec<Sample>,
    legs: Vec<u8>,
    first_discarded: Vec<u32>,
    cloud: Cloud,
}

impl SurfaceBuilder {
    /// An empty builder.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The surface of a scan, in the scanner's frame (z nominally up). It is valid until the next call and can be read
    /// again by [`SurfaceBuilder::surface`].
    ///
    /// # Errors
    /// [`SurfaceError`] when the grid is not that of the points, the scan cannot be indexed or a setting is wrong.
    pub fn build(&mut self, scan: ScanView<'_>, config: &SurfaceConfig) -> Result<&Surface, SurfaceError> {
        config.validate()?;
        let points = scan.points.len();
        // Twice as many triangles as points must fit as well.
        if points > (u32::MAX / 2) as usize {
            return Err(SurfaceError::TooLarge { points });
        }
        self.surface.points.resize(points, SurfacePoint::default());
        match scan.grid {
            Some(Grid { rows, cols }) if rows.checked_mul(cols) != Some(points) => {
                return Err(SurfaceError::GridMismatch { points, rows, cols });
            }
            Some(grid) => self.build_ordered(scan.points, grid, config),
            None => self.build_unordered(scan.points, config),
        }
        Ok(&self.surface)
    }

    /// The surface of the last scan.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    fn build_unordered(&mut self, points: &[Point], config: &SurfaceConfig) {
        self.surface.topology = None;
        self.surface.triangles.clear();
        self.surface.links.clear();
        self.surface.discarded.clear();
        self.cloud.build(points, config, &mut self.surface);
    }

    fn build_ordered(&mut self, points: &[Point], grid: Grid, config: &SurfaceConfig) {
        let cells = grid.cells();
        self.directions.resize(cells, [0.0; 3]);
        self.inverse_ranges.resize(cells, 0.0);
        self.smoothed.resize(cells, 0.0);
        self.samples.resize(cells, [0.0; 4]);
        self.legs.resize(cells, 0);
        self.first_discarded.resize(cells, 0);
        self.surface.triangles.resize(cells, 0);
        self.surface.links.resize(cells, 0);
        self.surface.lists.clear();
        self.surface.list_of_point.clear();

        self.split_rays(points, grid, config);
        let topology = Topology::of(&self.directions, grid);
        self.smooth(&topology, config);
        self.judge_legs(&topology, config);
        let mesh = Mesh { samples: &self.samples, legs: &self.legs, topology, quality: QualityScale::new(config) };
        mesh.build(&mut self.surface.points, &mut self.surface.triangles, config.threads);
        self.surface.topology = Some(topology);
        self.surface.link_neighbours(&topology, config.threads);
        let out = &mut self.surface.discarded;
        discarded::list(&self.samples, &self.surface.triangles, &topology, &mut self.first_discarded, out);
    }

    /// Splits every return into its direction and 1/range; both are zero in an empty cell.
    fn split_rays(&mut self, points: &[Point], grid: Grid, config: &SurfaceConfig) {
        let (least, cols) = (config.range_min_m as f32, grid.cols);
        for_blocks2(
            &mut self.directions,
            &mut self.inverse_ranges,
            cols,
            config.threads,
            |first_row, directions, inverse| {
                let rays = directions.iter_mut().zip(inverse);
                for (point, (direction, q)) in points[first_row * cols..].iter().zip(rays) {
                    let range = point.range();
                    // Comparisons with NaN are false: an empty cell fails the first, an infinite one the second.
                    let there = range >= least && range <= f32::MAX;
                    *q = if there { 1.0 / range } else { 0.0 };
                    *direction = if there { [point.x * *q, point.y * *q, point.z * *q] } else { [0.0; 3] };
                }
            },
        );
    }

    /// Filters 1/range along the rows, then along the columns, and puts the points where it says.
    fn smooth(&mut self, topology: &Topology, config: &SurfaceConfig) {
        let Grid { rows, cols } = topology.grid;
        let (smoother, directions, raw) = (Smoother::new(config), &self.directions, &self.inverse_ranges);
        let step = |here: &[f32; 3], next: Option<&[f32; 3]>, previous: Option<&[f32; 3]>| {
            let ahead = next.map_or(0.0, |d| chord(here, d));
            if ahead > 0.0 { ahead } else { previous.map_or(0.0, |d| chord(here, d)) }
        };
        for_blocks(&mut self.smoothed, cols, config.threads, |first_row, block| {
            for (offset, values) in block.chunks_mut(cols).enumerate() {
                let base = (first_row + offset) * cols;
                let line = Line { base, stride: 1, len: cols, wraps: topology.wraps_cols };
                let rays = &directions[base..base + cols];
                for (col, (value, here)) in values.iter_mut().zip(rays).enumerate() {
                    let width = step(here, rays.get(col + 1), rays.get(col.wrapping_sub(1)));
                    *value = smoother.smooth(raw, line, col, width);
                }
            }
        });
        let smoothed = &self.smoothed;
        for_blocks(&mut self.samples, cols, config.threads, |first_row, block| {
            for (offset, samples) in block.chunks_mut(cols).enumerate() {
                let (row, first) = (first_row + offset, (first_row + offset) * cols);
                for (col, sample) in samples.iter_mut().enumerate() {
                    let (cell, here) = (first + col, &directions[first + col]);
                    let line = Line { base: col, stride: cols, len: rows, wraps: topology.wraps_rows };
                    let width = step(here, directions.get(cell + cols), directions.get(cell.wrapping_sub(cols)));
                    let q = smoother.smooth(smoothed, line, row, width);
                    let range = 1.0 / q;
                    *sample = if q > 0.0 { [here[0] * range, here[1] * range, here[2] * range, q] } else { [0.0; 4] };
                }
            }
        });
    }

    /// Judges the legs to the right of and below every cell.
    fn judge_legs(&mut self, topology: &Topology, config: &SurfaceConfig) {
        let cols = topology.grid.cols;
        let (test, samples) = (LegTest::new(config), &self.samples);
        let at = |row: Option<usize>, col: Option<usize>| -> &Sample {
            row.zip(col).map_or(&[0.0; 4], |(r, c)| &samples[r * cols + c])
        };
        for_blocks(&mut self.legs, cols, config.threads, |first_row, block| {
            for (offset, row_legs) in block.chunks_mut(cols).enumerate() {
                let row = first_row + offset;
                let (above, below) = (topology.row_before(row), topology.row_after(row));
                let further = below.and_then(|r| topology.row_after(r));
                for (col, legs) in row_legs.iter_mut().enumerate() {
                    let here = at(Some(row), Some(col));
                    if here[3] <= 0.0 {
                        *legs = 0;
                        continue;
                    }
                    let (left, right) = (topology.col_before(col), topology.col_after(col));
                    let beyond = right.and_then(|c| topology.col_after(c));
                    let on_row = |c: Option<usize>| at(Some(row), c);
                    let across = test.judge(here, on_row(right), || [*on_row(left), *on_row(beyond)]);
                    let on_col = |r: Option<usize>| at(r, Some(col));
                    let down = test.judge(here, on_col(below), || [*on_col(above), *on_col(further)]);
                    *legs = across.bits() | down.bits() << 2;
                }
            }
        });
    }
}

/// The distance between two unit directions; zero when one is missing.
fn chord(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    if *a == [0.0; 3] || *b == [0.0; 3] {
        return 0.0;
    }
    let square = |i: usize| (a[i] - b[i]) * (a[i] - b[i]);
    (square(0) + square(1) + square(2)).sqrt()
}
