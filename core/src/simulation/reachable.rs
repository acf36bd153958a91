//! Which cells of the work area a robot can drive to: the truth that coverage is measured against.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::compiled_scene::CompiledScene;
use super::scene::{Label, ScanPose};

/// The robot, as far as it decides where it can go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReachConfig {
    /// Side of the cells [m].
    pub cell_m: f64,
    /// The robot is a disc of this radius [m].
    pub robot_radius_m: f64,
    /// What is higher does not touch it [m].
    pub robot_height_m: f64,
    /// What is lower is driven over [m].
    pub step_m: f64,
    /// The steepest ground it climbs [deg].
    pub max_slope_deg: f64,
}

impl Default for ReachConfig {
    fn default() -> Self {
        // Cells as in section 6; half the robot's width of 0.85 m; 1 m tall (section 1).
        Self { cell_m: 0.3, robot_radius_m: 0.43, robot_height_m: 1.0, step_m: 0.1, max_slope_deg: 15.0 }
    }
}

/// Why the reachable cells cannot be told.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ReachError {
    /// A field is outside its range.
    #[error("reach.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// The robot cannot stand where it starts.
    #[error("the start x = {x}, y = {y} is outside the work area, blocked by an object, or too steep")]
    BlockedStart {
        /// Asked for [m].
        x: f64,
        /// Asked for [m].
        y: f64,
    },
}

/// A grid over the work area: which cells the robot's middle can reach from the start.
#[derive(Debug, Clone, PartialEq)]
pub struct ReachableCells {
    /// The corner of cell (0, 0) with the lowest coordinates, map frame [m].
    pub origin: [f64; 2],
    /// Side of the cells [m].
    pub cell_m: f64,
    /// Cells along x.
    pub cols: usize,
    /// Cells along y.
    pub rows: usize,
    /// One a cell, index `row * cols + col`.
    pub reachable: Vec<bool>,
}

impl ReachableCells {
    /// The index of the cell that holds (x, y), or `None` outside the grid.
    #[must_use]
    pub fn index(&self, x: f64, y: f64) -> Option<usize> {
        let (u, v) = ((x - self.origin[0]) / self.cell_m, (y - self.origin[1]) / self.cell_m);
        let inside = u >= 0.0 && v >= 0.0 && u < self.cols as f64 && v < self.rows as f64;
        inside.then(|| v as usize * self.cols + u as usize)
    }

    /// Whether the robot can reach (x, y).
    #[must_use]
    pub fn contains(&self, x: f64, y: f64) -> bool {
        self.index(x, y).and_then(|index| self.reachable.get(index).copied()).unwrap_or(false)
    }

    /// The middle of a cell [m].
    #[must_use]
    pub fn centre(&self, index: usize) -> [f64; 2] {
        let (row, col) = (index / self.cols, index % self.cols);
        [self.origin[0] + (col as f64 + 0.5) * self.cell_m, self.origin[1] + (row as f64 + 0.5) * self.cell_m]
    }

    /// The number of reachable cells.
    #[must_use]
    pub fn count(&self) -> usize {
        self.reachable.iter().filter(|&&reachable| reachable).count()
    }

    /// The share of reachable cells for which `known` holds, 0 to 1; `known` gets the cell's middle [m].
    #[must_use]
    pub fn coverage(&self, mut known: impl FnMut(f64, f64) -> bool) -> f64 {
        let cells = self.reachable.iter().enumerate().filter(|(_, reachable)| **reachable);
        let covered = cells.filter(|(index, _)| {
            let [x, y] = self.centre(*index);
            known(x, y)
        });
        covered.count() as f64 / self.count().max(1) as f64
    }
}

/// Fills the work area from `start` over the cells on which the robot can stand: four-connected cells whose ground is
/// not too steep and from whose middle every object surface between `step_m` and `robot_height_m` over the ground is
/// at least `robot_radius_m` away. Ramps count as objects: the robot is taken to stay on the terrain.
///
/// # Errors
/// When a field of the config is out of range, or the robot cannot stand at the start.
pub fn reachable_cells(
    scene: &CompiledScene,
    config: &ReachConfig,
    start: &ScanPose,
) -> Result<ReachableCells, ReachError> {
    let area = scene.scene().area;
    let span = [area.x_m[1] - area.x_m[0], area.y_m[1] - area.y_m[0]];
    config.validate(span)?;
    let [cols, rows] = span.map(|length| (length / config.cell_m - 1e-9).ceil().max(1.0) as usize);
    let mut cells = ReachableCells {
        origin: [area.x_m[0], area.y_m[0]],
        cell_m: config.cell_m,
        cols,
        rows,
        reachable: vec![false; cols * rows],
    };
    let mut free = level_cells(scene, config, &cells);
    for (triangle, label) in scene.object_triangles() {
        block_cells(scene, config, &cells, &triangle, label, &mut free);
    }
    let first = cells.index(start.x, start.y).filter(|&index| free.get(index).copied().unwrap_or(false));
    let first = first.ok_or(ReachError::BlockedStart { x: start.x, y: start.y })?;
    flood(&free, first, &mut cells);
    Ok(cells)
}

impl ReachConfig {
    /// Checks every field for a work area of these sides [m].
    fn validate(&self, span: [f64; 2]) -> Result<(), ReachError> {
        let cells = (span[0] / self.cell_m) * (span[1] / self.cell_m);
        let checks = [
            (self.cell_m > 0.0, "cell_m", self.cell_m, "must be above 0"),
            (cells <= 1e8, "cell_m", self.cell_m, "gives more than 100 million cells; make it larger"),
            (self.robot_radius_m >= 0.0, "robot_radius_m", self.robot_radius_m, "must be 0 or more"),
            (self.step_m >= 0.0, "step_m", self.step_m, "must be 0 or more"),
            (self.robot_height_m > self.step_m, "robot_height_m", self.robot_height_m, "must be above step_m"),
            (
                self.max_slope_deg > 0.0 && self.max_slope_deg < 90.0,
                "max_slope_deg",
                self.max_slope_deg,
                "must lie in 0 < max_slope_deg < 90",
            ),
        ];
        match checks.into_iter().find(|(holds, ..)| !holds) {
            None => Ok(()),
            Some((_, field, value, allowed)) => Err(ReachError::OutOfRange { field, value, allowed }),
        }
    }
}

/// The cells whose ground is not too steep.
fn level_cells(scene: &CompiledScene, config: &ReachConfig, cells: &ReachableCells) -> Vec<bool> {
    let least = config.max_slope_deg.to_radians().cos();
    let level = |index| {
        let [x, y] = cells.centre(index);
        scene.terrain().normal(x, y).is_some_and(|normal| normal.z >= least)
    };
    (0..cells.reachable.len()).map(level).collect()
}

/// Takes from `free` the cells in which the robot would touch the triangle.
fn block_cells(
    scene: &CompiledScene,
    config: &ReachConfig,
    cells: &ReachableCells,
    triangle: &[Vector3<f64>; 3],
    label: Label,
    free: &mut [bool],
) {
    // Below half a cell a thin wall would leak between the cells' middles.
    let reach = config.robot_radius_m.max(0.5 * cells.cell_m);
    let span = |axis: usize| {
        let low = triangle.iter().map(|v| v[axis]).fold(f64::MAX, f64::min) - reach;
        let high = triangle.iter().map(|v| v[axis]).fold(f64::MIN, f64::max) + reach;
        let limit = if axis == 0 { cells.cols } else { cells.rows };
        let cell = |at: f64| ((at - cells.origin[axis]) / cells.cell_m).floor().clamp(0.0, limit as f64) as usize;
        cell(low)..(cell(high) + 1).min(limit)
    };
    let mut polygon = Vec::with_capacity(5);
    let mut scratch = Vec::with_capacity(5);
    for row in span(1) {
        for col in span(0) {
            let index = row * cells.cols + col;
            let [x, y] = cells.centre(index);
            let (Some(ground), Some(free)) = (scene.ground_height(x, y), free.get_mut(index)) else { continue };
            if !*free {
                continue;
            }
            // A ramp's foot is lower than a step yet leads off the terrain, so all of it counts.
            let lowest = if label == Label::Ramp { 0.0 } else { config.step_m };
            polygon.clear();
            polygon.extend_from_slice(triangle);
            clip(&mut polygon, &mut scratch, |v| v.z - (ground + lowest));
            clip(&mut polygon, &mut scratch, |v| ground + config.robot_height_m - v.z);
            if !polygon.is_empty() && distance(&polygon, x, y) < reach {
                *free = false;
            }
        }
    }
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

/// Marks all free cells connected with `first`.
fn flood(free: &[bool], first: usize, cells: &mut ReachableCells) {
    let (cols, rows) = (cells.cols, cells.rows);
    let mut open = vec![first];
    while let Some(index) = open.pop() {
        let (Some(true), Some(reached)) = (free.get(index), cells.reachable.get_mut(index)) else { continue };
        if std::mem::replace(reached, true) {
            continue;
        }
        let (row, col) = (index / cols, index % cols);
        if col > 0 {
            open.push(index - 1);
        }
        if col + 1 < cols {
            open.push(index + 1);
        }
        if row > 0 {
            open.push(index - cols);
        }
        if row + 1 < rows {
            open.push(index + cols);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Scene;

    const START: ScanPose = ScanPose { x: -8.0, y: 0.0, yaw: 0.0 };

    fn reach(tail: &str, config: &ReachConfig) -> ReachableCells {
        let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-10, 10], y_m = [-10, 10] }\n";
        let scene = CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "test").unwrap()).unwrap();
        reachable_cells(&scene, config, &START).unwrap()
    }

    fn wall(to_y: f64, height: f64) -> String {
        format!("[[wall]]\nfrom_m = [0, -10]\nto_m = [0, {to_y}]\nheight_m = {height}\nthickness_m = 0.2\n")
    }

    #[test]
    fn all_of_an_empty_plane_is_reached() {
        let cells = reach("", &ReachConfig::default());
        assert_eq!((cells.cols, cells.rows), (67, 67));
        assert_eq!(cells.count(), 67 * 67);
        assert!((cells.coverage(|x, _| x < 0.05) - 34.0 / 67.0).abs() < 1e-9);
    }

    #[test]
    fn a_wall_across_the_area_hides_the_far_half_and_a_gap_opens_it() {
        let closed = reach(&wall(10.0, 2.0), &ReachConfig::default());
        assert!(!closed.contains(5.0, 0.0) && closed.contains(-5.0, 0.0));
        assert!(!closed.contains(-0.4, 0.0), "nearer than the robot's radius");
        assert!(closed.contains(-1.0, 0.0));
        let open = reach(&wall(8.0, 2.0), &ReachConfig::default());
        assert!(open.contains(5.0, 0.0));
        let narrow = reach(&wall(9.6, 2.0), &ReachConfig::default());
        assert!(!narrow.contains(5.0, 0.0), "the gap is narrower than the robot");
    }

    #[test]
    fn low_steps_are_driven_over_and_high_beams_under() {
        assert!(reach(&wall(10.0, 0.05), &ReachConfig::default()).contains(5.0, 0.0));
        let beam =
            "[[box]]\nlabel = \"other\"\nx_m = 0\ny_m = 0\nz_m = 1.2\nlength_m = 1\nwidth_m = 20\nheight_m = 1\n";
        assert!(reach(beam, &ReachConfig::default()).contains(0.0, 0.0));
        let tall = ReachConfig { robot_height_m: 1.5, ..ReachConfig::default() };
        assert!(!reach(beam, &tall).contains(5.0, 0.0));
    }

    #[test]
    fn steep_ground_is_not_climbed() {
        let hill = "terrain = { bumps = [{ x_m = 0, y_m = 0, height_m = 3, radius_m = 2 }] }\n";
        let cells = reach(hill, &ReachConfig::default());
        assert!(!cells.contains(2.0, 0.0) && !cells.contains(0.0, 0.0) && cells.contains(8.0, 0.0));
        let climber = ReachConfig { max_slope_deg: 50.0, ..ReachConfig::default() };
        assert_eq!(reach(hill, &climber).count(), 67 * 67);
    }

    #[test]
    fn the_inside_of_a_solid_is_out_of_reach() {
        let cells = reach(
            "[[house]]\nx_m = 3\ny_m = 2\nyaw_deg = 30\nlength_m = 6\nwidth_m = 4\nwall_height_m = 2.5\nroof_height_m = 1\n",
            &ReachConfig::default(),
        );
        assert!(!cells.contains(3.0, 2.0) && cells.contains(-5.0, 5.0) && cells.contains(8.0, 2.0));
    }

    #[test]
    fn a_start_within_an_object_is_an_error() {
        let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
        let inside = ScanPose { x: -8.0, y: -3.0, yaw: 0.0 };
        let answer = reachable_cells(&scene, &ReachConfig::default(), &inside);
        assert_eq!(answer, Err(ReachError::BlockedStart { x: -8.0, y: -3.0 }));
        let config = ReachConfig { cell_m: 0.0, ..ReachConfig::default() };
        let text = reachable_cells(&scene, &config, &inside).unwrap_err().to_string();
        assert!(text.starts_with("reach.cell_m = 0 is out of range"), "{text}");
    }
}
