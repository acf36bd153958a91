//! On which surfaces a robot could stand: every level of every cell, from the triangles.

use std::ops::Range;

use nalgebra::Vector3;

use super::compiled_scene::CompiledScene;
use super::reachable::{CellKind, ReachConfig, ReachableCells};

/// Directions in which the ground around a level is looked at.
const AROUND: usize = 8;

/// Why a robot cannot stand on a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// It can.
    None,
    /// The surface is too steep.
    Steep,
    /// Something is over it too low, or stands in the cell.
    Occupied,
    /// Something is nearer than the robot's radius, or the ground falls away.
    TooNear,
}

/// A surface at the middle of a cell.
#[derive(Debug, Clone, Copy)]
struct Level {
    height: f64,
    /// Rise along x and y.
    slope: [f64; 2],
    fault: Fault,
}

/// The levels of all cells, of each cell from below.
pub(super) struct Levels {
    levels: Vec<Level>,
    /// Where the levels of each cell begin, and the end of the last.
    first: Vec<usize>,
}

/// A triangle and what its slope means.
struct Face {
    corners: [Vector3<f64>; 3],
    normal: Vector3<f64>,
    is_walkable: bool,
}

impl Levels {
    /// Finds the levels of every cell and what speaks against them.
    pub(super) fn of(scene: &CompiledScene, config: &ReachConfig, cells: &ReachableCells) -> Self {
        let least = config.max_slope_deg.to_radians().cos();
        let faces: Vec<Face> = scene
            .labelled_triangles()
            .map(|(corners, _)| {
                let [a, b, c] = corners;
                let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros);
                Face { corners, normal, is_walkable: normal.z.abs() >= least }
            })
            .collect();
        let mut levels = Self::crossings(&faces, cells);
        levels.check_room(config);
        for face in &faces {
            levels.block(face, config, cells);
        }
        levels.check_support(config, cells);
        levels
    }

    /// Where the vertical line through each cell's middle meets a face.
    fn crossings(faces: &[Face], cells: &ReachableCells) -> Self {
        let mut found: Vec<(usize, Level)> = Vec::new();
        for face in faces.iter().filter(|face| face.normal.z.abs() > 1e-6) {
            let slope = [-face.normal.x / face.normal.z, -face.normal.y / face.normal.z];
            for_cells(cells, &face.corners, 0.0, |cell, [x, y]| {
                if contains(&face.corners, x, y) {
                    let [a, ..] = face.corners;
                    let height = a.z + slope[0] * (x - a.x) + slope[1] * (y - a.y);
                    let fault = if face.is_walkable { Fault::None } else { Fault::Steep };
                    found.push((cell, Level { height, slope, fault }));
                }
            });
        }
        found.sort_by(|(a, p), (b, q)| a.cmp(b).then(p.height.total_cmp(&q.height)));
        let mut first = vec![0; cells.reachable.len() + 1];
        for (cell, _) in &found {
            first[cell + 1] += 1;
        }
        for cell in 0..cells.reachable.len() {
            first[cell + 1] += first[cell];
        }
        Self { levels: found.into_iter().map(|(_, level)| level).collect(), first }
    }

    /// Something over a level, higher than a step and lower than the robot, occupies it. What lies lower is driven over:
    /// the robot stands on the higher of the two.
    fn check_room(&mut self, config: &ReachConfig) {
        for cell in 0..self.first.len() - 1 {
            let range = self.range(cell);
            for level in range.clone() {
                let height = self.levels[level].height;
                let over = |other: &usize| self.levels[*other].height - height;
                let low = (level + 1..range.end).any(|other| over(&other) < config.robot_height_m);
                if low && self.levels[level].fault == Fault::None {
                    self.levels[level].fault = Fault::Occupied;
                }
            }
        }
    }

    /// Marks the levels on which the robot would touch the face.
    fn block(&mut self, face: &Face, config: &ReachConfig, cells: &ReachableCells) {
        // Below half a cell a thin wall would leak between the cells' middles.
        let half = 0.5 * cells.cell_m;
        let reach = config.robot_radius_m.max(half);
        // Ground may rise towards the robot as steeply as it climbs.
        let rise = if face.is_walkable { 2.0 * reach * config.max_slope_deg.to_radians().tan() } else { 0.0 };
        let lowest = config.step_m + rise;
        let (mut polygon, mut scratch) = (Vec::with_capacity(5), Vec::with_capacity(5));
        let top = face.corners.iter().map(|v| v.z).fold(f64::MIN, f64::max);
        let first = self.first.clone();
        let levels = &mut self.levels;
        for_cells(cells, &face.corners, reach, |cell, [x, y]| {
            for level in &mut levels[first[cell]..first[cell + 1]] {
                if !matches!(level.fault, Fault::None | Fault::TooNear) {
                    continue;
                }
                let [gx, gy] = level.slope;
                let height = level.height;
                if top < height + lowest - reach * (gx.abs() + gy.abs()) {
                    continue;
                }
                let over = |v: &Vector3<f64>| v.z - height - gx * (v.x - x) - gy * (v.y - y);
                polygon.clear();
                polygon.extend_from_slice(&face.corners);
                // Of a large face only what is near counts: its plane and the level's may meet far away.
                clip(&mut polygon, &mut scratch, |v| over(v) - lowest);
                clip(&mut polygon, &mut scratch, |v| config.robot_height_m - over(v));
                if polygon.is_empty() {
                    continue;
                }
                let away = distance(&polygon, x, y);
                if away < half {
                    level.fault = Fault::Occupied;
                } else if away < reach {
                    level.fault = Fault::TooNear;
                }
            }
        });
    }

    /// Marks the levels around which the ground falls away.
    fn check_support(&mut self, config: &ReachConfig, cells: &ReachableCells) {
        let radius = config.robot_radius_m;
        let fall = config.step_m + radius * config.max_slope_deg.to_radians().tan();
        let mut unsupported = Vec::new();
        for cell in 0..cells.reachable.len() {
            let [x, y] = cells.centre(cell);
            for level in self.range(cell) {
                if self.levels[level].fault != Fault::None {
                    continue;
                }
                let Level { height, slope, .. } = self.levels[level];
                let falls = (0..AROUND).any(|k| {
                    let (sin, cos) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
                    let (dx, dy) = (radius * cos, radius * sin);
                    let expected = height + slope[0] * dx + slope[1] * dy;
                    // Beyond the area nothing is known.
                    let Some(there) = cells.index(x + dx, y + dy) else { return false };
                    !self.range(there).any(|other| (self.levels[other].height - expected).abs() <= fall)
                });
                if falls {
                    unsupported.push(level);
                }
            }
        }
        for level in unsupported {
            self.levels[level].fault = Fault::TooNear;
        }
    }

    /// The number of levels.
    pub(super) fn count(&self) -> usize {
        self.levels.len()
    }

    /// The levels of a cell.
    pub(super) fn range(&self, cell: usize) -> Range<usize> {
        self.first[cell]..self.first[cell + 1]
    }

    /// The levels of all cells, cell by cell.
    pub(super) fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.first.windows(2).map(|ends| ends[0]..ends[1])
    }

    /// Height of a level [m].
    pub(super) fn height(&self, level: usize) -> f64 {
        self.levels[level].height
    }

    /// What speaks against standing on a level.
    pub(super) fn fault(&self, level: usize) -> Fault {
        self.levels[level].fault
    }

    /// The cell and its free level nearest to a height, within half a metre.
    pub(super) fn free_near(&self, cell: usize, height: f64) -> Option<(usize, usize)> {
        let away = |level: usize| (self.levels[level].height - height).abs();
        let free = self.range(cell).filter(|&level| self.levels[level].fault == Fault::None && away(level) < 0.5);
        free.min_by(|&a, &b| away(a).total_cmp(&away(b))).map(|level| (cell, level))
    }

    /// What a cell is that cannot be reached, from its level on the terrain.
    pub(super) fn kind(&self, range: Range<usize>, ground: f64, config: &ReachConfig) -> CellKind {
        let at_ground = |level: &usize| (self.levels[*level].height - ground).abs() < 1e-3;
        let Some(level) = range.clone().find(at_ground) else { return CellKind::Void };
        let is_covered = range.end > level + 1 && self.levels[range.end - 1].height > ground + config.step_m;
        match self.levels[level].fault {
            // Out of reach under something: inside a solid.
            _ if is_covered => CellKind::Obstacle,
            Fault::None => CellKind::Isolated,
            Fault::Occupied => CellKind::Obstacle,
            Fault::TooNear => CellKind::TooNear,
            Fault::Steep => CellKind::Steep,
        }
    }
}

/// Calls `work` with every cell whose middle is within `reach` of the upright box around the corners.
fn for_cells(cells: &ReachableCells, corners: &[Vector3<f64>; 3], reach: f64, mut work: impl FnMut(usize, [f64; 2])) {
    let span = |axis: usize| {
        let low = corners.iter().map(|v| v[axis]).fold(f64::MAX, f64::min) - reach;
        let high = corners.iter().map(|v| v[axis]).fold(f64::MIN, f64::max) + reach;
        let limit = if axis == 0 { cells.cols } else { cells.rows };
        let cell = |at: f64| ((at - cells.origin[axis]) / cells.cell_m).floor().clamp(0.0, limit as f64) as usize;
        cell(low)..(cell(high) + 1).min(limit)
    };
    let cols = span(0);
    for row in span(1) {
        for col in cols.clone() {
            let cell = row * cells.cols + col;
            work(cell, cells.centre(cell));
        }
    }
}

/// Whether (x, y) lies in the triangle seen from above. Of triangles that share an edge exactly one contains it.
fn contains(corners: &[Vector3<f64>; 3], x: f64, y: f64) -> bool {
    let mut left = 0;
    for k in 0..3 {
        let (mut p, mut q) = (&corners[k], &corners[(k + 1) % 3]);
        // The same sum for both triangles at an edge.
        let turned = (p.x, p.y) > (q.x, q.y);
        if turned {
            (p, q) = (q, p);
        }
        let side = (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
        left += i32::from((side >= 0.0) != turned);
    }
    left == 0 || left == 3
}

/// Keeps the part of a convex polygon where `side` is not negative (Sutherland and Hodgman 1974).
fn clip(polygon: &mut Vec<Vector3<f64>>, scratch: &mut Vec<Vector3<f64>>, side: impl Fn(&Vector3<f64>) -> f64) {
    scratch.clear();
    let mut previous = polygon.last().copied();
    for &vertex in polygon.iter() {
        if let Some(from) = previous {
            let (a, b) = (side(&from), side(&vertex));
            if (a < 0.0) != (b < 0.0) {
                scratch.push(from + (vertex - from) * (a / (a - b)));
            }
            if b >= 0.0 {
                scratch.push(vertex);
            }
        }
        previous = Some(vertex);
    }
    std::mem::swap(polygon, scratch);
}

/// Horizontal distance from (x, y) to a convex polygon, 0 within it [m].
fn distance(polygon: &[Vector3<f64>], x: f64, y: f64) -> f64 {
    let mut least = f64::MAX;
    let (mut left, mut right) = (false, false);
    let mut previous = polygon.last().copied().unwrap_or_default();
    for &vertex in polygon {
        let (ex, ey) = (vertex.x - previous.x, vertex.y - previous.y);
        let (px, py) = (x - previous.x, y - previous.y);
        let length2 = ex * ex + ey * ey;
        let along = if length2 > 0.0 { ((px * ex + py * ey) / length2).clamp(0.0, 1.0) } else { 0.0 };
        least = least.min((px - along * ex).hypot(py - along * ey));
        let cross = ex * py - ey * px;
        left |= cross > 0.0;
        right |= cross < 0.0;
        previous = vertex;
    }
    // Seen edge-on (a wall) the polygon has no inside, and both sides or neither are met.
    if left != right && polygon_area(polygon) > 1e-9 { 0.0 } else { least }
}

/// Twice the horizontal area of a polygon [m^2], always positive.
fn polygon_area(polygon: &[Vector3<f64>]) -> f64 {
    let mut previous = polygon.last().copied().unwrap_or_default();
    let mut sum = 0.0;
    for &vertex in polygon {
        sum += previous.x * vertex.y - previous.y * vertex.x;
        previous = vertex;
    }
    sum.abs()
}
