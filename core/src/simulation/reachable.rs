//! Which cells of the work area a robot can drive to, and what the others are: the truth that coverage and scores are
//! measured against.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::compiled_scene::CompiledScene;
use super::scene::ScanPose;
use super::standing::{Fault, Levels};

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
    #[error("{place}the start x = {x}, y = {y} is outside the work area, blocked by an object, or too steep")]
    BlockedStart {
        /// File and line of the start, or nothing.
        place: String,
        /// Asked for [m].
        x: f64,
        /// Asked for [m].
        y: f64,
    },
    /// The robot can stand where it starts, but hardly leave.
    #[error(
        "{place}the area cannot be explored from the start x = {x}, y = {y}: only {reached_m2:.1} m^2 can be reached; \
         move the start or open a way"
    )]
    Enclosed {
        /// File and line of the area, or nothing.
        place: String,
        /// The start [m].
        x: f64,
        /// The start [m].
        y: f64,
        /// What can be reached.
        reached_m2: f64,
    },
}

/// What a cell is to the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellKind {
    /// The robot can drive there.
    Reachable,
    /// It could stand there, but no way leads there.
    Isolated,
    /// Nothing stands in it, but something nearer than the robot's radius, or the ground falls away there.
    TooNear,
    /// Something stands in it, or over it too low.
    Obstacle,
    /// The ground is too steep.
    Steep,
    /// There is no ground.
    Void,
}

/// Less than this is no exploration [m^2].
const LEAST_REACHED_M2: f64 = 4.0;

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
    /// As `reachable`: what each cell is.
    pub kinds: Vec<CellKind>,
    /// As `reachable`: on which heights the robot can stand there [m], from below; under and on a bridge there are two.
    pub heights: Vec<Vec<f32>>,
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

/// Fills the work area from `start` over the places on which the robot can stand. A cell may have several, one above the
/// other: on a bridge and under it. The robot stands on a surface that is not too steep, with room over it up to
/// `robot_height_m`, from whose middle everything steep that rises between `step_m` and `robot_height_m` over it is at
/// least `robot_radius_m` away, and which does not fall away within that radius. It moves between neighbouring cells
/// (four a cell) whose heights differ by no more than a step and the steepest slope.
///
/// # Errors
/// When a field of the config is out of range, the robot cannot stand at the start, or can hardly leave it.
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
        kinds: vec![CellKind::Void; cols * rows],
        heights: vec![Vec::new(); cols * rows],
    };
    let levels = Levels::of(scene, config, &cells);
    let origin = &scene.scene().origin;
    let place = |line: usize| if line == 0 { String::new() } else { format!("{}, line {line}: ", origin.file) };
    let ground = scene.ground_height(start.x, start.y);
    let first = cells.index(start.x, start.y).zip(ground).and_then(|(cell, ground)| levels.free_near(cell, ground));
    let (x, y) = (start.x, start.y);
    let first = first.ok_or_else(|| ReachError::BlockedStart { place: place(origin.start_line), x, y })?;
    let reached = flood(&levels, config, first, &cells);
    for (cell, range) in levels.ranges().enumerate() {
        let reached_here = range.clone().filter(|&level| reached[level]);
        cells.heights[cell] = reached_here.map(|level| levels.height(level) as f32).collect();
        cells.reachable[cell] = !cells.heights[cell].is_empty();
        cells.kinds[cell] = if cells.reachable[cell] {
            CellKind::Reachable
        } else {
            let [x, y] = cells.centre(cell);
            scene.ground_height(x, y).map_or(CellKind::Void, |ground| levels.kind(range, ground, config))
        };
    }
    let reached_m2 = cells.count() as f64 * config.cell_m * config.cell_m;
    if reached_m2 < LEAST_REACHED_M2 && span[0] * span[1] > 2.0 * LEAST_REACHED_M2 {
        return Err(ReachError::Enclosed { place: place(origin.area_line), x, y, reached_m2 });
    }
    Ok(cells)
}

/// Which levels are connected with `first` through free ones.
fn flood(levels: &Levels, config: &ReachConfig, first: (usize, usize), cells: &ReachableCells) -> Vec<bool> {
    let climb = config.step_m + config.cell_m * config.max_slope_deg.to_radians().tan();
    let mut reached = vec![false; levels.count()];
    let mut open = vec![first];
    reached[first.1] = true;
    while let Some((cell, level)) = open.pop() {
        let (row, col) = (cell / cells.cols, cell % cells.cols);
        let neighbours = [
            (col > 0).then(|| cell - 1),
            (col + 1 < cells.cols).then(|| cell + 1),
            (row > 0).then(|| cell - cells.cols),
            (row + 1 < cells.rows).then(|| cell + cells.cols),
        ];
        for neighbour in neighbours.into_iter().flatten() {
            for next in levels.range(neighbour) {
                let rise = (levels.height(next) - levels.height(level)).abs();
                if !reached[next] && levels.fault(next) == Fault::None && rise <= climb {
                    reached[next] = true;
                    open.push((neighbour, next));
                }
            }
        }
    }
    reached
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
        let text = answer.unwrap_err().to_string();
        assert!(text.starts_with("built-in scene simple, line 10: the start x = -8, y = -3 is outside"), "{text}");
        let config = ReachConfig { cell_m: 0.0, ..ReachConfig::default() };
        let text = reachable_cells(&scene, &config, &inside).unwrap_err().to_string();
        assert!(text.starts_with("reach.cell_m = 0 is out of range"), "{text}");
    }

    #[test]
    fn a_bridge_is_driven_over_and_under() {
        // Ramps of 10 deg lead up to a deck with 1.2 m of room under it.
        let ramp = |x: f64, yaw: f64| {
            format!("[[ramp]]\nx_m = {x}\ny_m = 0\nyaw_deg = {yaw}\nlength_m = 8\nwidth_m = 3\nheight_m = 1.41\n")
        };
        let deck =
            "[[box]]\nlabel = \"ramp\"\nx_m = 2\ny_m = 0\nz_m = 1.21\nlength_m = 3\nwidth_m = 3\nheight_m = 0.2\n";
        let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-10, 14], y_m = [-6, 6] }\n";
        let text = format!("{head}{}{}{deck}", ramp(-3.5, 0.0), ramp(7.5, 180.0));
        let scene = CompiledScene::new(Scene::from_toml(&text, "test").unwrap()).unwrap();
        let cells = reachable_cells(&scene, &ReachConfig::default(), &START).unwrap();
        let heights = |x, y| cells.heights[cells.index(x, y).unwrap()].clone();
        assert_eq!(heights(2.0, 0.0).len(), 2, "{:?}", heights(2.0, 0.0));
        assert!((heights(2.0, 0.0)[1] - 1.41).abs() < 1e-4 && heights(2.0, 0.0)[0].abs() < 1e-4);
        let on_ramp = heights(-3.5, 0.0);
        assert!(on_ramp.len() == 1 && (on_ramp[0] - 0.705).abs() < 0.05, "{on_ramp:?}");
        assert_eq!(heights(2.0, 4.0).len(), 1);
        // Beside the ramp the robot would touch it, on its edge it would fall.
        assert!(heights(-1.0, 1.7).is_empty() && heights(-1.0, 1.3).is_empty());
        let low = ReachConfig { robot_height_m: 1.3, ..ReachConfig::default() };
        let cells = reachable_cells(&scene, &low, &START).unwrap();
        assert_eq!(cells.heights[cells.index(2.0, 0.0).unwrap()].len(), 1, "too tall to pass under it");
    }

    #[test]
    fn every_cell_is_told_what_it_is() {
        let tail = "terrain = { bumps = [{ x_m = 6, y_m = 6, height_m = 3, radius_m = 1.5 }] }\n\
                    [[box]]\nlabel = \"vehicle\"\nx_m = 0\ny_m = 0\nlength_m = 4\nwidth_m = 2\nheight_m = 1.5\n\
                    [[wall]]\nfrom_m = [5, -10]\nto_m = [5, -5]\nheight_m = 2\nthickness_m = 0.3\n\
                    [[wall]]\nfrom_m = [5, -5]\nto_m = [10, -5]\nheight_m = 2\nthickness_m = 0.3\n";
        let cells = reach(tail, &ReachConfig::default());
        let kind = |x, y| cells.kinds[cells.index(x, y).unwrap()];
        assert_eq!(kind(-5.0, 0.0), CellKind::Reachable);
        assert_eq!(kind(0.0, 0.0), CellKind::Obstacle);
        assert_eq!(kind(1.9, 0.9), CellKind::Obstacle);
        assert_eq!(kind(-2.3, 0.0), CellKind::TooNear);
        assert_eq!(kind(7.4, 6.0), CellKind::Steep);
        assert_eq!(kind(7.5, -7.5), CellKind::Isolated);
    }

    #[test]
    fn a_start_between_walls_is_an_error_that_names_the_area() {
        let ring = [
            ((-9.0, -1.0), (-7.0, -1.0)),
            ((-7.0, -1.0), (-7.0, 1.0)),
            ((-7.0, 1.0), (-9.0, 1.0)),
            ((-9.0, 1.0), (-9.0, -1.0)),
        ];
        let wall = |((x0, y0), (x1, y1)): ((f64, f64), (f64, f64))| {
            format!("[[wall]]\nfrom_m = [{x0}, {y0}]\nto_m = [{x1}, {y1}]\nheight_m = 2\nthickness_m = 0.2\n")
        };
        let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-10, 10], y_m = [-10, 10] }\n";
        let text = format!("{head}{}", ring.map(wall).concat());
        let scene = CompiledScene::new(Scene::from_toml(&text, "a.toml").unwrap()).unwrap();
        let error = reachable_cells(&scene, &ReachConfig::default(), &START).unwrap_err().to_string();
        assert!(error.starts_with("a.toml, line 3: the area cannot be explored from the start x = -8"), "{error}");
    }
}
