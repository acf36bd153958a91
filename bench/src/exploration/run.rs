//! One exploration from its first scan to its end, with what was known after every scan.

use std::time::Instant;

use mirador_core::geometry::Pose;
use mirador_core::information_map::{InformationMap, Obstruction};
use mirador_core::scan::{Point, ScanView};
use mirador_core::simulation::{ModelDistance, ModelDistances, ScanSeed, Scanner, ScannerConfig};
use mirador_core::view_planning::{
    Decision, PlanningConfig, Situation, StopReason, Strategy, StrategyRegistry, ViewPlan, WorkArea, Workspace,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::drive::{Drive, GivenUp, most_given_up, obstruction_radius_m};
use super::{ExplorationError, Mapper, World};

/// The mission's clock: the robot drives so fast [m/s].
pub const SPEED_M_S: f64 = 0.8;
/// And a scan takes so long [s]: 720 sweeps of 20 ms (section 5.3 of the source), however coarse the scanner is made.
pub const SCAN_S: f64 = 14.4;

/// One exploration.
#[derive(Debug, Clone)]
pub struct Exploration {
    /// The scanner.
    pub scanner: ScannerConfig,
    /// The strategy and its settings; the world's work area is put in.
    pub planning: PlanningConfig,
    /// Seed of scans and candidates.
    pub seed: u64,
    /// The run is cut off after so many scans.
    pub max_scans: usize,
    /// Worker threads, at least 1; only the times depend on them.
    pub threads: usize,
}

/// What is known after a scan and the plan that follows it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Metres driven until then.
    pub metres: f64,
    /// Share of the truly reachable cells that are known.
    pub coverage: f64,
    /// Mean Q_a of the reachable cells that are known.
    pub quality: f64,
    /// Known cells of the map, reachable or not.
    pub known_cells: usize,
    /// Time of the plan [ms].
    pub planning_ms: f64,
    /// Time of surface, scores, map and plan [ms].
    pub computing_ms: f64,
    /// Driving and scanning until then [s]: see [`SPEED_M_S`] and [`SCAN_S`].
    pub mission_s: f64,
}

/// How an exploration went.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// One a scan.
    pub steps: Vec<Step>,
    /// Where the scans were taken [m, map frame], and between them the way points.
    pub ways: Vec<Vec<[f64; 2]>>,
    /// Why it stopped; `None` when it was cut off or got stuck.
    pub stop: Option<StopReason>,
    /// The targets that were given up.
    pub given_up: Vec<GivenUp>,
    /// It ended because it gave up target after target.
    pub is_stuck: bool,
    /// The model against the true surfaces.
    pub model_error: Option<ModelDistance>,
    /// Time of the whole run, simulation included [s].
    pub wall_s: f64,
    /// The map at the end.
    pub map: InformationMap,
}

impl Outcome {
    /// Scans taken.
    #[must_use]
    pub fn scans(&self) -> usize {
        self.steps.len()
    }

    /// The state at the end; all zero when there was no scan.
    #[must_use]
    pub fn last(&self) -> Step {
        self.steps.last().copied().unwrap_or(Step {
            metres: 0.0,
            coverage: 0.0,
            quality: 0.0,
            known_cells: 0,
            planning_ms: 0.0,
            computing_ms: 0.0,
            mission_s: 0.0,
        })
    }
}

impl Exploration {
    /// Explores a world; `is_cancelled` is asked after every scan.
    ///
    /// # Errors
    /// When the settings are not allowed, or a step of the chain refuses its input.
    pub fn run(
        &self,
        world: &World,
        registry: &StrategyRegistry,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Outcome, ExplorationError> {
        let begin = Instant::now();
        let area = world.scene.scene().area;
        let work_area = WorkArea { min: [area.x_m[0], area.y_m[0]], max: [area.x_m[1], area.y_m[1]] };
        let config = PlanningConfig { work_area: Some(work_area), ..self.planning.clone() };
        config.validate()?;
        let scanner = Scanner::new(self.scanner.clone())?;
        let mut strategy = registry.create(&config.strategy)?;
        let (mut mapper, mut workspace) = (Mapper::new(&self.scanner, self.threads)?, Workspace::new());
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        let start = world.scene.scene().start;
        let (mut place, mut yaw) = ([start.x, start.y, 0.0], start.yaw);
        let (mut steps, mut ways, mut metres) = (Vec::new(), Vec::new(), 0.0);
        let (mut given_up, mut in_a_row) = (Vec::new(), 0);
        let (mut stop, mut distances) = (None, ModelDistances::default());
        while steps.len() < self.max_scans && in_a_row < most_given_up() && !is_cancelled() {
            let Some(map_from_scanner) = world.scanner_pose(place, yaw, self.scanner.height_m) else { break };
            let scan = steps.len();
            let seed = ScanSeed { seed: self.seed, scan: scan as u64 };
            scanner.scan(&world.scene, &map_from_scanner, seed, self.threads, &mut points, None)?;
            let returns = points.iter().filter(|point| point.is_return());
            distances.sample(&world.scene, returns.map(|point| map_from_scanner * point.position()));
            let arrived = Instant::now();
            mapper.take_in(ScanView::with_grid(&points, Some(scanner.grid())), &map_from_scanner)?;
            let situation = Situation {
                threads: self.threads,
                ..situation(&map_from_scanner, self.scanner.height_m, scan, self.seed)
            };
            let (plan, planning_ms) = timed_plan(strategy.as_mut(), &mut workspace, &mapper.map, &situation, &config);
            let computing_ms = arrived.elapsed().as_secs_f64() * 1e3;
            let (quality, coverage) = world.judge(&mapper.map);
            let known_cells = mapper.map.known_cells().count();
            let mission_s = metres / SPEED_M_S + (scan + 1) as f64 * SCAN_S;
            steps.push(Step { metres, coverage, quality, known_cells, planning_ms, computing_ms, mission_s });
            let Some(next) = plan.chosen() else {
                stop = match plan.decision {
                    Decision::Stop { reason } => Some(reason),
                    Decision::Go { .. } => None,
                };
                break;
            };
            let drive = Drive::along(world, place, &plan.path);
            let way = drive.flat();
            metres += drive.metres;
            // As the planning service does: what has carried the robot may carry it back.
            mapper.map.drove(&way);
            ways.push(way);
            yaw = next.heading;
            place = drive.end().unwrap_or(next.position);
            in_a_row = if drive.stopped_at.is_some() { in_a_row + 1 } else { 0 };
            if let Some((position, kind)) = drive.stopped_at {
                mapper.map.obstruct(Obstruction { centre: position, radius_m: obstruction_radius_m() });
                given_up.push(GivenUp::new(scan, position, kind));
            }
        }
        Ok(Outcome {
            steps,
            ways,
            stop,
            is_stuck: in_a_row >= most_given_up(),
            given_up,
            model_error: distances.summary(),
            wall_s: begin.elapsed().as_secs_f64(),
            map: mapper.map,
        })
    }
}

/// The robot's base under a level scanner.
pub(crate) fn situation(map_from_scanner: &Pose, height_m: f64, scan: usize, run_seed: u64) -> Situation {
    let (_, _, yaw) = map_from_scanner.rotation.euler_angles();
    let place = map_from_scanner.translation.vector - Vector3::new(0.0, 0.0, height_m);
    let upright = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Situation {
        map_from_robot: Pose::from_parts(Translation3::from(place), upright),
        scan_number: scan as u64,
        run_seed,
        threads: 2,
    }
}

/// A plan and how long it took [ms].
pub(crate) fn timed_plan(
    strategy: &mut dyn Strategy,
    workspace: &mut Workspace,
    map: &InformationMap,
    situation: &Situation,
    config: &PlanningConfig,
) -> (ViewPlan, f64) {
    let begin = Instant::now();
    let plan = strategy.plan(workspace, map, situation, config);
    (plan, begin.elapsed().as_secs_f64() * 1e3)
}
