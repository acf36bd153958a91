//! A world to explore, and the truth about it.

use mirador_core::geometry::Pose;
use mirador_core::information_map::{CellState, InformationMap};
use mirador_core::scan::{Point, ScanView};
use mirador_core::simulation::{
    CellKind, CompiledScene, ReachConfig, ReachableCells, ScanSeed, Scanner, ScannerConfig, Scene, reachable_cells,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{ExplorationError, Mapper};

/// Side of the cells in which ways are looked at [m]: finer than the map's, since ways pass obstacles closely.
const WAY_CELL_M: f64 = 0.1;
/// What stops a robot on its way: something that its body runs into, by more than half a cell of the map, which cannot say it
/// better; ground so steep that the driver turns back.
const BODY: ReachConfig =
    ReachConfig { cell_m: WAY_CELL_M, robot_radius_m: 0.28, robot_height_m: 1.0, step_m: 0.3, max_slope_deg: 32.0 };
/// And a kerb that it would have to climb; past the end of one a wheel gets by.
const WHEELS: ReachConfig = ReachConfig { robot_radius_m: 0.1, step_m: 0.1, ..BODY };
/// Ways are looked at every so often [m].
const WAY_STEP_M: f64 = 0.05;
/// The ceiling of quality is measured with scans from places so far apart [m] on the reachable cells.
const CEILING_SPACING_M: f64 = 2.0;

/// A world to explore, and what a robot can reach of it.
pub struct World {
    /// Its name.
    pub name: String,
    pub(super) scene: CompiledScene,
    truth: ReachableCells,
    /// Where nothing stops the robot's body, and its wheels.
    free: [ReachableCells; 2],
}

/// What scans from everywhere would find: the ceiling of what an exploration can reach.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WorldQuality {
    /// Scans taken, each on a truly reachable cell.
    pub scans: usize,
    /// No two of them nearer to each other than this [m].
    pub spacing_m: f64,
    /// Mean Q_a of the reachable cells after all of them.
    pub quality: f64,
    /// Share of the reachable cells known.
    pub coverage: f64,
}

impl World {
    /// The names [`World::named`] knows.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        let mut names = Scene::builtin_names();
        names.push("urban");
        names
    }

    /// A built-in scene of the simulator, or `urban`, a block of houses of the benchmark's own.
    ///
    /// # Errors
    /// When there is no such scene.
    pub fn named(name: &str) -> Result<Self, ExplorationError> {
        let scene = match name {
            "urban" => Scene::from_toml(include_str!("urban.toml"), "urban.toml")?,
            other => Scene::builtin(other)?,
        };
        let scene = CompiledScene::new(scene)?;
        let start = scene.scene().start;
        let truth = reachable_cells(&scene, &ReachConfig::default(), &start)?;
        let free = [reachable_cells(&scene, &BODY, &start)?, reachable_cells(&scene, &WHEELS, &start)?];
        Ok(Self { name: name.to_owned(), scene, truth, free })
    }

    /// The pose of a level scanner over a robot that stands at (x, y), on the level nearest to z where there are several;
    /// `None` beyond the ground's edge.
    pub(super) fn scanner_pose(&self, [x, y, z]: [f64; 3], yaw: f64, height_m: f64) -> Option<Pose> {
        let levels = self.truth.index(x, y).and_then(|index| self.truth.heights.get(index));
        let apart = |level: &f64| (level - z).abs();
        let nearest = levels.and_then(|levels| {
            levels.iter().map(|&level| f64::from(level)).min_by(|a, b| apart(a).total_cmp(&apart(b)))
        });
        let terrain = self.scene.ground_height(x, y)?;
        // The heights are those of the cells' middles; on the ground itself it is known better.
        let ground = nearest.filter(|level| (level - terrain).abs() > 0.5).unwrap_or(terrain);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Some(Pose::from_parts(Translation3::new(x, y, ground + height_m), turn))
    }

    /// Mean quality of the known cells among the reachable ones, and their share.
    pub(super) fn judge(&self, map: &InformationMap) -> (f64, f64) {
        let (mut quality, mut known) = (0.0, 0usize);
        let coverage = self.truth.coverage(|x, y| {
            let Some(index) = map.cell_containing(x, y) else { return false };
            let is_known = matches!(map.state(index), CellState::Known(_));
            if let Some(q) = map.cell(index).and_then(|cell| cell.quality()) {
                quality += q;
                known += 1;
            }
            is_known
        });
        (quality / known.max(1) as f64, coverage)
    }

    /// The first place of a straight piece of way where something stops the robot, and what is there.
    pub(super) fn first_stop(&self, from: [f64; 2], to: [f64; 2]) -> Option<([f64; 2], CellKind)> {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        let steps = (length / WAY_STEP_M).ceil().max(1.0) as usize;
        (0..=steps).find_map(|k| {
            let share = k as f64 / steps as f64;
            let place = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
            self.stopped_by(place).map(|kind| (place, kind))
        })
    }

    fn stopped_by(&self, [x, y]: [f64; 2]) -> Option<CellKind> {
        let kind = |cells: &ReachableCells| cells.index(x, y).and_then(|at| cells.kinds.get(at).copied());
        self.free.iter().map(|cells| kind(cells).unwrap_or(CellKind::Void)).find(|kind| *kind != CellKind::Reachable)
    }

    /// Scans from all over the reachable cells: the highest mean quality that this scanner can be hoped to find. Ends early,
    /// with less, when it is cancelled.
    ///
    /// # Errors
    /// When a scan cannot be taken or taken in.
    pub fn ceiling(
        &self,
        config: &ScannerConfig,
        threads: usize,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<WorldQuality, ExplorationError> {
        let scanner = Scanner::new(config.clone())?;
        let mut mapper = Mapper::new(config, threads)?;
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        let mut places: Vec<[f64; 3]> = Vec::new();
        for (index, _) in self.truth.reachable.iter().enumerate().filter(|(_, reachable)| **reachable) {
            let [x, y] = self.truth.centre(index);
            let is_free = |other: &[f64; 3]| (other[0] - x).hypot(other[1] - y) >= CEILING_SPACING_M;
            if places.iter().all(is_free) {
                places.extend(self.truth.heights[index].first().map(|&z| [x, y, f64::from(z)]));
            }
        }
        for (scan, place) in places.iter().enumerate() {
            if is_cancelled() {
                break;
            }
            let Some(pose) = self.scanner_pose(*place, 0.0, config.height_m) else { continue };
            let seed = ScanSeed { seed: 0, scan: scan as u64 };
            scanner.scan(&self.scene, &pose, seed, threads, &mut points, None)?;
            mapper.take_in(ScanView::with_grid(&points, Some(scanner.grid())), &pose)?;
        }
        let (quality, coverage) = self.judge(&mapper.map);
        Ok(WorldQuality { scans: places.len(), spacing_m: CEILING_SPACING_M, quality, coverage })
    }
}
