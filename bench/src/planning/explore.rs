//! A whole exploration in one process, without processes, motion or errors of localisation: scan, surface, scores, map,
//! plan, and a jump along the path to the next view. Deterministic: the same world, settings and seed give the same run.

use std::time::Instant;

use mirador_core::analysis::{GroundHeight, PointScore, ScoreConfig, Scorer, ZoneConfig, ZoneFinder};
use mirador_core::geometry::Pose;
use mirador_core::information_map::{self, CellState, InformationMap, MapConfig};
use mirador_core::scan::{Point, ScanView};
use mirador_core::simulation::{
    CompiledScene, ReachConfig, ReachableCells, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene, reachable_cells,
};
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig};
use mirador_core::view_planning::{
    Decision, PlanningConfig, Situation, StopReason, Strategy, StrategyRegistry, ViewPlan, WorkArea, Workspace,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::PlanningBenchError;

/// A world to explore, and what a robot can reach of it.
pub struct World {
    /// Its name.
    pub name: String,
    scene: CompiledScene,
    truth: ReachableCells,
}

impl World {
    /// A built-in scene of the simulator, or `urban`, a block of houses of the benchmark's own.
    ///
    /// # Errors
    /// When there is no such scene.
    pub fn named(name: &str) -> Result<Self, PlanningBenchError> {
        let scene = match name {
            "urban" => Scene::from_toml(include_str!("urban.toml"), "urban.toml")?,
            other => Scene::builtin(other)?,
        };
        let scene = CompiledScene::new(scene)?;
        let truth = reachable_cells(&scene, &ReachConfig::default(), &scene.scene().start)?;
        Ok(Self { name: name.to_owned(), scene, truth })
    }
}

/// From points to scores to the map: what alignment, analysis and planning do with a scan whose pose is known.
pub(super) struct Mapper {
    surface: SurfaceBuilder,
    surface_config: SurfaceConfig,
    scores: ScoreConfig,
    scorer: Scorer,
    finder: ZoneFinder,
    records: Vec<PointScore>,
    pub map: InformationMap,
    scans: u64,
}

impl Mapper {
    /// A mapper for scans of this scanner.
    pub fn new(scanner: &ScannerConfig) -> Result<Self, PlanningBenchError> {
        Ok(Self {
            surface: SurfaceBuilder::new(),
            surface_config: SurfaceConfig { threads: 2, area_max_m2: max_area_m2(scanner), ..SurfaceConfig::default() },
            scores: ScoreConfig { threads: 2, scanner_height_m: Some(scanner.height_m), ..ScoreConfig::default() },
            scorer: Scorer::new(),
            finder: ZoneFinder::new(),
            records: Vec::new(),
            map: InformationMap::new(MapConfig::default())?,
            scans: 0,
        })
    }

    /// Takes in a scan.
    pub fn take_in(&mut self, scan: ScanView<'_>, map_from_scanner: &Pose) -> Result<(), PlanningBenchError> {
        let surface = self.surface.build(scan, &self.surface_config)?;
        let level = &map_from_scanner.rotation;
        let ground = GroundHeight::resolve(&self.scores, scan, surface, level);
        self.records.resize(scan.points.len(), PointScore::NONE);
        self.scorer.score(scan, surface, level, ground, &self.scores, &mut self.records)?;
        let mut found = Vec::new();
        self.finder.find(surface, scan, &ZoneConfig::default(), &mut found)?;
        self.map.insert(scan, &self.records, map_from_scanner)?;
        let in_map: Vec<_> = found
            .iter()
            .map(|zone| information_map::Zone {
                centre: map_from_scanner * zone.centre.cast::<f64>(),
                normal: map_from_scanner.rotation * zone.normal.cast::<f64>(),
            })
            .collect();
        self.map.update_zones(self.scans, &in_map, map_from_scanner, &information_map::ZoneConfig::default());
        self.scans += 1;
        Ok(())
    }
}

/// A_max grows with the scanner's steps, so that a coarse scanner finds the same quality at the same distance.
fn max_area_m2(scanner: &ScannerConfig) -> f64 {
    0.0025 * (scanner.beam_step_deg / 0.5) * (scanner.turn_deg / scanner.sweeps as f64 / 0.5)
}

/// The source's scanner with both angular steps this much coarser, at least 1.
#[must_use]
pub fn scanner(coarser: usize) -> ScannerConfig {
    let fine = ScannerConfig::default();
    let coarser = coarser.max(1);
    ScannerConfig {
        beam_step_deg: fine.beam_step_deg * coarser as f64,
        beams: (fine.beams - 1) / coarser + 1,
        sweeps: fine.sweeps / coarser,
        ..fine
    }
}

/// The planner's settings for this scanner.
#[must_use]
pub fn planning_config(scanner: &ScannerConfig) -> PlanningConfig {
    let mut config = PlanningConfig::default();
    config.scanner.range_m = scanner.range_max_m;
    config.scanner.height_m = scanner.height_m;
    config.scanner.azimuth_step_deg = scanner.turn_deg / scanner.sweeps as f64;
    config.scanner.elevation_step_deg = scanner.beam_step_deg;
    // The fan begins so far under the horizon.
    config.scanner.lowest_elevation_deg = scanner.first_beam_deg.max(-90.0);
    config.scanner.max_area_m2 = max_area_m2(scanner);
    config
}

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
}

/// How an exploration went.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Scans taken.
    pub scans: usize,
    /// Metres driven.
    pub metres: f64,
    /// Mean Q_a of the reachable cells that are known.
    pub mean_quality: f64,
    /// Share of the truly reachable cells that are known.
    pub coverage: f64,
    /// Why it stopped; `None` when it was cut off.
    pub stop: Option<StopReason>,
    /// Time of every plan [ms].
    pub plan_ms: Vec<f64>,
}

impl Exploration {
    /// Explores a world.
    ///
    /// # Errors
    /// When the settings are not allowed, or a step of the chain refuses its input.
    pub fn run(&self, world: &World, registry: &StrategyRegistry) -> Result<Outcome, PlanningBenchError> {
        let area = world.scene.scene().area;
        let work_area = WorkArea { min: [area.x_m[0], area.y_m[0]], max: [area.x_m[1], area.y_m[1]] };
        let config = PlanningConfig { work_area: Some(work_area), ..self.planning.clone() };
        config.validate()?;
        let scanner = Scanner::new(self.scanner.clone())?;
        let mut strategy = registry.create(&config.strategy)?;
        let (mut mapper, mut workspace) = (Mapper::new(&self.scanner)?, Workspace::new());
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        let mut pose = world.scene.scene().start;
        let mut outcome =
            Outcome { scans: 0, metres: 0.0, mean_quality: 0.0, coverage: 0.0, stop: None, plan_ms: Vec::new() };
        while outcome.scans < self.max_scans {
            let Some(map_from_scanner) = world.scene.level_scanner_pose(&pose, self.scanner.height_m) else { break };
            let seed = ScanSeed { seed: self.seed, scan: outcome.scans as u64 };
            scanner.scan(&world.scene, &map_from_scanner, seed, 2, &mut points, None)?;
            mapper.take_in(ScanView { points: &points, grid: Some(scanner.grid()) }, &map_from_scanner)?;
            let situation = situation(&map_from_scanner, self.scanner.height_m, outcome.scans, self.seed);
            outcome.scans += 1;
            let (plan, ms) = timed_plan(strategy.as_mut(), &mut workspace, &mapper.map, &situation, &config);
            outcome.plan_ms.push(ms);
            let Some(next) = plan.chosen() else {
                outcome.stop = match plan.decision {
                    Decision::Stop { reason } => Some(reason),
                    Decision::Go { .. } => None,
                };
                break;
            };
            outcome.metres += length([pose.x, pose.y], &plan.path);
            pose = ScanPose { x: next.position[0], y: next.position[1], yaw: next.heading };
        }
        (outcome.mean_quality, outcome.coverage) = judge(&mapper.map, &world.truth);
        Ok(outcome)
    }
}

/// The robot's base under a level scanner.
pub(super) fn situation(map_from_scanner: &Pose, height_m: f64, scan: usize, run_seed: u64) -> Situation {
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
pub(super) fn timed_plan(
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

fn length(from: [f64; 2], path: &[[f64; 3]]) -> f64 {
    let places: Vec<[f64; 2]> = std::iter::once(from).chain(path.iter().map(|p| [p[0], p[1]])).collect();
    places.windows(2).map(|pair| (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1])).sum()
}

/// Mean quality of the known cells among the reachable ones, and their share.
fn judge(map: &InformationMap, truth: &ReachableCells) -> (f64, f64) {
    let (mut quality, mut known) = (0.0, 0usize);
    let coverage = truth.coverage(|x, y| {
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
