//! A grid of directions over a scan without an order (spec section 2): an index beside the cloud, which tells each cell
//! its point. No point is moved and none is made up.

use super::builder::{OutLines, build_lines};
use super::config::SurfaceConfig;
use super::discarded;
use super::quality::QualityScale;
use super::strip::{Rule, Strip};
use super::topology::Topology;
use super::view::{Surface, SurfacePoint};
use crate::scan::{Grid, Point};
use std::f32::consts::{PI, TAU};

/// Points are counted in cells of this side to find how dense they are [rad].
const COARSE: f32 = PI / 90.0;

/// So many points a cell on average, where there are any: with fewer the mesh has holes, with more points are left out.
const POINTS_A_CELL: f32 = 1.3;

/// Forms of a cell that are tried: azimuth over elevation. Spinning lasers have few lines and many points a line.
const ASPECTS: [f32; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// The finest cell [rad], and the most of them.
const STEP_MIN: f32 = 1e-3;
const CELLS_MAX: usize = 1 << 23;

/// Buffers of the index, reused from scan to scan.
#[derive(Debug, Default)]
pub(super) struct SphericalIndex {
    /// Azimuth and elevation of every point; NaN without a return.
    angles: Vec<[f32; 2]>,
    is_taken: Vec<bool>,
    /// How far the point of a cell is from its middle.
    off_centre: Vec<f32>,
    /// The points in the order of the cells.
    points: Vec<Point>,
    shapes: Vec<SurfacePoint>,
}

/// The cells: rows by elevation, columns by azimuth all around.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cells {
    grid: Grid,
    lowest: f32,
    azimuth_step: f32,
    elevation_step: f32,
}

impl Cells {
    /// Cells of about this area and form over elevations from `lowest` to `highest` [rad].
    fn new(area: f32, aspect: f32, lowest: f32, highest: f32) -> Self {
        let cols = (TAU / (area * aspect).sqrt().max(STEP_MIN)).ceil().max(8.0);
        let rows = ((highest - lowest) / (area / aspect).sqrt().max(STEP_MIN)).floor() + 1.0;
        Self {
            grid: Grid { rows: rows as usize, cols: cols as usize },
            lowest,
            azimuth_step: TAU / cols,
            elevation_step: ((highest - lowest) / rows).max(STEP_MIN) * (1.0 + 1e-5),
        }
    }

    /// The cell of a direction and how far it is from the cell's middle, in cells, squared.
    fn cell(&self, [azimuth, elevation]: [f32; 2]) -> Option<(usize, f32)> {
        let (across, up) = ((azimuth + PI) / self.azimuth_step, (elevation - self.lowest) / self.elevation_step);
        if !(across >= 0.0 && up >= 0.0) {
            return None;
        }
        let (col, row) = ((across as usize).min(self.grid.cols - 1), (up as usize).min(self.grid.rows - 1));
        let (x, y) = (across - col as f32 - 0.5, up - row as f32 - 0.5);
        Some((row * self.grid.cols + col, x * x + y * y))
    }
}

impl SphericalIndex {
    /// Meshes a scan without an order: adds triangles, and discarded ones, to a surface that has its points' normals
    /// already, and replaces the areas of all points that the mesh holds.
    pub(super) fn mesh(
        &mut self,
        points: &[Point],
        config: &SurfaceConfig,
        strip: &mut Strip,
        first_discarded: &mut Vec<u32>,
        surface: &mut Surface,
    ) {
        surface.triangles.clear();
        surface.links.clear();
        let Some(cells) = self.choose(points, config.range_min_m as f32) else { return };
        self.fill(points, &cells, &mut surface.point_of_cell);
        let topology = Topology { grid: cells.grid, wraps_rows: false, wraps_cols: true };
        // Points lie anywhere in their cells: the filter, which wants them evenly spaced, would bend the surface.
        let config = SurfaceConfig { filter_radius_m: 0.0, filter_cells_max: 0, ..config.clone() };
        let rule = Rule::new(&config, cells.grid.cols, Some(cells.grid.rows));
        let count = cells.grid.cells();
        surface.triangles.resize(count, 0);
        surface.links.resize(count, 0);
        self.shapes.resize(count, SurfacePoint::default());
        let (triangles, links) = (&mut surface.triangles, &mut surface.links);
        let lines = OutLines { first_row: 0, points: &mut self.shapes, triangles, links };
        build_lines(strip, &rule, &self.points, &topology, &config, lines);
        surface.mesh_topology = Some(topology);
        first_discarded.resize(count, 0);
        let list = &mut surface.discarded;
        discarded::list(strip.discarded.iter(), &surface.triangles, &topology, first_discarded, list);
        for corner in surface.discarded.iter_mut().flat_map(|triangle| &mut triangle.corners) {
            *corner = surface.point_of_cell[*corner as usize];
        }
        let quality = QualityScale::new(&config);
        for (shape, point) in self.shapes.iter().zip(&surface.point_of_cell).filter(|(shape, _)| shape.is_valid()) {
            let known = &mut surface.points[*point as usize];
            if known.is_valid() {
                known.area = shape.area;
                known.quality = quality.of(known.area, known.incidence);
            } else {
                *known = *shape;
            }
        }
    }

    /// The cells that suit the points' density; `None` with too few points to mesh.
    fn choose(&mut self, points: &[Point], range_min: f32) -> Option<Cells> {
        let angles = |point: &Point| {
            let range = point.range();
            if range >= range_min && range <= f32::MAX {
                [point.y.atan2(point.x), (point.z / range).clamp(-1.0, 1.0).asin()]
            } else {
                [f32::NAN; 2]
            }
        };
        self.angles.clear();
        self.angles.extend(points.iter().map(angles));
        let elevations = self.angles.iter().map(|[_, elevation]| *elevation).filter(|e| !e.is_nan());
        let (lowest, highest) = elevations.fold((f32::MAX, f32::MIN), |(low, high), e| (low.min(e), high.max(e)));
        if lowest > highest {
            return None;
        }
        let coarse = Cells::new(COARSE * COARSE, 1.0, lowest, highest);
        let (returns, occupied) = self.count(&coarse);
        if returns < 3 {
            return None;
        }
        let coarse_area = coarse.azimuth_step * coarse.elevation_step;
        let area = POINTS_A_CELL * coarse_area * occupied as f32 / returns as f32;
        let all = ASPECTS.map(|aspect| Cells::new(area, aspect, lowest, highest));
        let possible = all.into_iter().filter(|cells| cells.grid.cells() <= CELLS_MAX);
        // The form that leaves the fewest points without a cell of their own.
        let best = possible.map(|cells| (self.count(&cells).1, cells)).reduce(|a, b| if b.0 > a.0 { b } else { a });
        best.map(|(_, cells)| cells)
    }

    /// The returns, and the cells with any.
    fn count(&mut self, cells: &Cells) -> (usize, usize) {
        self.is_taken.clear();
        self.is_taken.resize(cells.grid.cells(), false);
        let (mut returns, mut occupied) = (0, 0);
        for (cell, _) in self.angles.iter().filter_map(|angles| cells.cell(*angles)) {
            returns += 1;
            occupied += usize::from(!self.is_taken[cell]);
            self.is_taken[cell] = true;
        }
        (returns, occupied)
    }

    /// Gives every cell the point next to its middle, the first of two that are alike.
    fn fill(&mut self, points: &[Point], cells: &Cells, point_of_cell: &mut Vec<u32>) {
        let count = cells.grid.cells();
        point_of_cell.clear();
        point_of_cell.resize(count, u32::MAX);
        self.off_centre.clear();
        self.off_centre.resize(count, f32::INFINITY);
        self.points.clear();
        self.points.resize(count, Point::EMPTY);
        for (index, angles) in self.angles.iter().enumerate() {
            let Some((cell, off_centre)) = cells.cell(*angles) else { continue };
            if off_centre < self.off_centre[cell] {
                self.off_centre[cell] = off_centre;
                point_of_cell[cell] = index as u32;
                self.points[cell] = points[index];
            }
        }
    }
}
