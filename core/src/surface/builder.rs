//! The builder: a scan in one piece, cut into blocks for several threads, or sweep by sweep as it comes.

use super::cloud::Cloud;
use super::config::{SurfaceConfig, SurfaceConfigError};
use super::discarded::{self, Found};
use super::spherical_index::SphericalIndex;
use super::strip::{Finished, Rule, Strip};
use super::topology::Topology;
use super::view::{Surface, SurfacePoint};
use crate::scan::{Grid, Point, ScanView};
use crate::simd::widest;
use crate::threads::for_each;

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
    /// Sweeps were given before [`SurfaceBuilder::begin`], or after another scan was built.
    #[error("no scan is under way: call begin before the first sweep")]
    NotBegun,
    /// The points of a scan under way do not end with a sweep, or are fewer than before.
    #[error("{points} points are not whole sweeps of {cols} beams, or fewer than the {before} points given before")]
    NotWholeSweeps {
        /// Points given, from the first sweep on.
        points: usize,
        /// Beams of a sweep.
        cols: usize,
        /// Points given before.
        before: usize,
    },
    /// A setting outside its range.
    #[error(transparent)]
    Config(#[from] SurfaceConfigError),
}

/// Builds the surface of one scan after the other. Buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct SurfaceBuilder {
    surface: Surface,
    strips: Vec<Strip>,
    first_discarded: Vec<u32>,
    cloud: Cloud,
    index: SphericalIndex,
    under_way: Option<UnderWay>,
}

/// A scan that comes sweep by sweep.
#[derive(Debug)]
struct UnderWay {
    config: SurfaceConfig,
    cols: usize,
    /// Lines taken so far.
    lines: usize,
    /// Whether sweeps are full circles, as the first ones say; `None` while these are too few.
    is_closed: Option<bool>,
}

/// So many sweeps tell whether they are full circles.
const SWEEPS_TO_JUDGE: usize = 16;

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
        self.under_way = None;
        let points = scan.points.len();
        check_size(points)?;
        match scan.grid {
            Some(Grid { rows, cols }) if rows.checked_mul(cols) != Some(points) => {
                return Err(SurfaceError::GridMismatch { points, rows, cols });
            }
            Some(grid) => self.build_ordered(scan.points, grid, config),
            None => self.build_unordered(scan.points, config),
        }
        Ok(&self.surface)
    }

    /// Begins a scan that comes sweep by sweep, of `cols` beams each; how many sweeps there will be need not be known.
    ///
    /// # Errors
    /// [`SurfaceError::Config`] when a setting is wrong.
    pub fn begin(&mut self, cols: usize, config: &SurfaceConfig) -> Result<(), SurfaceError> {
        config.validate()?;
        self.surface.clear();
        self.under_way = Some(UnderWay { config: config.clone(), cols, lines: 0, is_closed: None });
        Ok(())
    }

    /// Takes the sweeps that are new since the last call: `points` are all points of the scan so far, in the order of
    /// the grid, a whole number of sweeps. What they allow to be finished is finished. Works on the caller's thread.
    ///
    /// # Errors
    /// [`SurfaceError`] when no scan is under way, or the points are not whole sweeps or fewer than before; nothing is
    /// taken then.
    pub fn advance(&mut self, points: &[Point]) -> Result<(), SurfaceError> {
        let Some(under_way) = &mut self.under_way else { return Err(SurfaceError::NotBegun) };
        let UnderWay { cols, lines, .. } = *under_way;
        let (given, before) = (points.len(), lines * cols);
        check_size(given)?;
        let is_whole = given.checked_rem(cols).map_or(given == 0, |rest| rest == 0);
        if !is_whole || given < before {
            return Err(SurfaceError::NotWholeSweeps { points: given, cols, before });
        }
        let rows = given.checked_div(cols).unwrap_or(0);
        if rows < SWEEPS_TO_JUDGE {
            return Ok(());
        }
        let config = &under_way.config;
        let least = config.range_min_m as f32;
        let strip = first_of(&mut self.strips);
        let is_closed = *under_way.is_closed.get_or_insert_with(|| {
            let is_closed = Topology::of(points, Grid { rows, cols }, least).wraps_cols;
            strip.reset(config, cols, is_closed);
            is_closed
        });
        under_way.lines = rows;
        self.surface.resize(given);
        let rule = Rule::new(config, cols, None);
        let topology = Topology { grid: Grid { rows, cols }, wraps_rows: false, wraps_cols: is_closed };
        let (lead, delay) = (Strip::lead(config), Strip::delay(config));
        widest(
            #[inline(always)]
            || {
                for row in lines..rows {
                    // The first lines may follow the last ones: they are finished at the end.
                    let out = row.checked_sub(delay).filter(|done| *done >= lead);
                    let out = out.map(|done| self.surface.finished(&topology, done));
                    strip.advance(&rule, &points[row * cols..(row + 1) * cols], out);
                }
            },
        );
        Ok(())
    }

    /// Takes the rest of the scan and finishes its surface: the same, bit for bit, as [`SurfaceBuilder::build`] of all
    /// `points` at once. Some twenty sweeps' work is left when all but the last sweep were taken before.
    ///
    /// # Errors
    /// As [`SurfaceBuilder::advance`].
    pub fn finish(&mut self, points: &[Point]) -> Result<&Surface, SurfaceError> {
        self.advance(points)?;
        let Some(UnderWay { config, cols, lines, is_closed }) = self.under_way.take() else {
            return Err(SurfaceError::NotBegun);
        };
        let grid = Grid { rows: points.len().checked_div(cols).unwrap_or(0), cols };
        let least = config.range_min_m as f32;
        // Grids so small that the filter might meet itself, and sweeps that turn out to be circles after all, are rare.
        let is_small = grid.rows <= 2 * Rule::reach(&config) + SWEEPS_TO_JUDGE;
        let topology = Topology::of(points, grid, least);
        if is_small || is_closed != Some(topology.wraps_cols) || lines != grid.rows {
            self.build_ordered(points, grid, &config);
            return Ok(&self.surface);
        }
        let rule = Rule::new(&config, cols, Some(grid.rows));
        let (lead, delay) = (Strip::lead(&config), Strip::delay(&config));
        if self.strips.len() < 2 {
            self.strips.resize_with(2, Strip::default);
        }
        if let [rest, start, ..] = self.strips.as_mut_slice() {
            let surface = &mut self.surface;
            widest(
                #[inline(always)]
                || {
                    for row in grid.rows..grid.rows + delay {
                        let next = line_of(points, &topology, row as isize);
                        rest.advance(&rule, next, Some(surface.finished(&topology, row - delay)));
                    }
                },
            );
            let lines = OutLines {
                first_row: 0,
                points: &mut surface.points[..lead * cols],
                triangles: &mut surface.triangles[..lead * cols],
                links: &mut surface.links[..lead * cols],
            };
            build_lines(start, &rule, points, &topology, &config, lines);
            let found = start.discarded.iter().chain(&rest.discarded);
            surface.end(topology, found, &mut self.first_discarded);
        }
        Ok(&self.surface)
    }

    /// The surface of the last scan. While a scan is under way it is that of none.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    fn build_unordered(&mut self, points: &[Point], config: &SurfaceConfig) {
        self.surface.clear();
        self.surface.resize(points.len());
        self.cloud.build(points, config, &mut self.surface);
        self.index.mesh(points, config, first_of(&mut self.strips), &mut self.first_discarded, &mut self.surface);
    }

    fn build_ordered(&mut self, points: &[Point], grid: Grid, config: &SurfaceConfig) {
        self.surface.renew(points.len());
        let topology = Topology::of(points, grid, config.range_min_m as f32);
        let rule = Rule::new(config, grid.cols, Some(grid.rows));
        if points.is_empty() {
            self.surface.end(topology, [].iter(), &mut self.first_discarded);
            return;
        }
        let blocks = config.threads.min(grid.rows).max(1);
        let rows_a_block = grid.rows.div_ceil(blocks);
        let chunk = rows_a_block * grid.cols;
        let blocks = grid.rows.div_ceil(rows_a_block);
        if self.strips.len() < blocks {
            self.strips.resize_with(blocks, Strip::default);
        }
        let surface = &mut self.surface;
        let out = surface.points.chunks_mut(chunk).zip(surface.triangles.chunks_mut(chunk));
        let out = out.zip(surface.links.chunks_mut(chunk)).enumerate().map(|(block, ((points, triangles), links))| {
            OutLines { first_row: block * rows_a_block, points, triangles, links }
        });
        for_each(self.strips.iter_mut().zip(out), config.threads, |(strip, lines)| {
            build_lines(strip, &rule, points, &topology, config, lines);
        });
        let found = self.strips[..blocks].iter().flat_map(|strip| &strip.discarded);
        surface.end(topology, found, &mut self.first_discarded);
    }
}

fn check_size(points: usize) -> Result<(), SurfaceError> {
    // Twice as many triangles as points must fit as well.
    if points > (u32::MAX / 2) as usize { Err(SurfaceError::TooLarge { points }) } else { Ok(()) }
}

/// The first strip, made if need be.
fn first_of(strips: &mut Vec<Strip>) -> &mut Strip {
    if strips.is_empty() {
        strips.push(Strip::default());
    }
    &mut strips[0]
}

/// Some consecutive lines of the surface.
pub(super) struct OutLines<'a> {
    pub(super) first_row: usize,
    pub(super) points: &'a mut [SurfacePoint],
    pub(super) triangles: &'a mut [u8],
    pub(super) links: &'a mut [u8],
}

/// The points of a line, which may lie beyond an end of the grid: across the seam if it is closed, none otherwise.
fn line_of<'a>(points: &'a [Point], topology: &Topology, row: isize) -> &'a [Point] {
    let Grid { rows, cols } = topology.grid;
    let inside = if topology.wraps_rows { row.rem_euclid(rows as isize) } else { row };
    usize::try_from(inside).ok().filter(|row| *row < rows).map_or(&[], |row| &points[row * cols..(row + 1) * cols])
}

/// Builds some lines of the surface.
pub(super) fn build_lines(
    strip: &mut Strip,
    rule: &Rule,
    points: &[Point],
    topology: &Topology,
    config: &SurfaceConfig,
    out: OutLines<'_>,
) {
    let cols = topology.grid.cols;
    strip.reset(config, cols, topology.wraps_cols);
    let (lead, delay) = (Strip::lead(config), Strip::delay(config));
    let mut lines = out.points.chunks_mut(cols).zip(out.triangles.chunks_mut(cols)).zip(out.links.chunks_mut(cols));
    let count = lines.len();
    widest(
        #[inline(always)]
        || {
            for step in 0..lead + count + delay {
                let next = line_of(points, topology, (out.first_row + step) as isize - lead as isize);
                let done = if step >= lead + delay { lines.next() } else { None };
                let done = done.map(|((points, triangles), links)| {
                    let row = out.first_row + step - lead - delay;
                    let next_cell = topology.row_after(row).unwrap_or(0) * cols;
                    Finished { first_cell: row * cols, next_cell, points, triangles, links }
                });
                strip.advance(rule, next, done);
            }
        },
    );
}

impl Surface {
    /// Forgets the last scan.
    fn clear(&mut self) {
        self.renew(0);
    }

    /// Forgets the last scan, but keeps what every line is written over anyway: to clear it first is to write all of it
    /// twice.
    fn renew(&mut self, points: usize) {
        self.topology = None;
        self.mesh_topology = None;
        self.point_of_cell.clear();
        self.discarded.clear();
        self.lists.clear();
        self.list_of_point.clear();
        self.resize(points);
    }

    /// Makes room for so many points.
    fn resize(&mut self, points: usize) {
        self.points.resize(points, SurfacePoint::default());
        self.triangles.resize(points, 0);
        self.links.resize(points, 0);
    }

    /// Where a finished line goes.
    fn finished(&mut self, topology: &Topology, row: usize) -> Finished<'_> {
        let cols = topology.grid.cols;
        let (first_cell, next_cell) = (row * cols, topology.row_after(row).unwrap_or(0) * cols);
        let cells = first_cell..first_cell + cols;
        Finished {
            first_cell,
            next_cell,
            points: &mut self.points[cells.clone()],
            triangles: &mut self.triangles[cells.clone()],
            links: &mut self.links[cells],
        }
    }

    /// Ends an ordered scan whose lines are all finished.
    fn end<'a>(
        &mut self,
        topology: Topology,
        found: impl Iterator<Item = &'a Found> + Clone,
        first_discarded: &mut Vec<u32>,
    ) {
        self.topology = Some(topology);
        self.mesh_topology = Some(topology);
        self.set_link_steps(&topology);
        first_discarded.resize(self.triangles.len(), 0);
        discarded::list(found, &self.triangles, &topology, first_discarded, &mut self.discarded);
    }
}
