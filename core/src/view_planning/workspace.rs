//! What is kept from plan to plan, so that a plan costs what has changed and not what is known.

use super::candidates::{Draw, draw};
use super::config::PlanningConfig;
use super::gain::{GainModel, ScannerView, SweepPool, for_each_place, zones_of};
use super::grid::Extent;
use super::plan::{Candidate, Decision, RawGain, Rejections, StopReason, ViewPlan};
use super::strategy::Situation;
use super::survey::Survey;
use super::turning_place::place_to_turn;
use super::utility::Yardsticks;
use crate::geometry::rows_from_pose;
use crate::information_map::{InformationMap, Zone};
use nalgebra::Point3;

/// Memory of the planner: the map's tiles as planning reads them, the window around the robot, the ways over it, and what
/// the last candidates would bring. It never changes a plan, only its time: asked again with other weights or for another
/// strategy, the same candidates are weighed anew without being looked at again.
///
/// A workspace belongs to one map. Another map is noticed (by its settings, its revision, or where its cells lie in
/// memory) and read anew. Memory: about 10 kB a map tile of 16 x 16 cells within the window, and 14 bytes a cell of the
/// window (`near_m`, when need be `horizon_m`, plus the scanner's range, to all sides); see [`Workspace::bytes`].
#[derive(Debug, Default)]
pub struct Workspace {
    survey: Survey,
    surveyed: Option<Key>,
    view: Option<ScannerView>,
    evaluation: Option<Evaluation>,
    pool: SweepPool,
}

/// What a survey was made for; the map's tiles are watched by the grid.
#[derive(Debug, Clone, PartialEq)]
struct Key {
    map_from_robot: [f64; 16],
    scan_number: u64,
    run_seed: u64,
    config: PlanningConfig,
    reach_m: f64,
}

/// The candidates of a survey and what they would bring.
#[derive(Debug)]
pub(super) struct Evaluation {
    pub draw: Draw,
    pub gains: Vec<RawGain>,
    pub yardsticks: Yardsticks,
    zones: Vec<Zone>,
    /// Which look at the ground this is, from 0.
    look: usize,
}

/// One look at the map: near first, farther only when need be.
pub(super) struct Stage<'a> {
    pub map: &'a InformationMap,
    pub situation: &'a Situation,
    pub config: &'a PlanningConfig,
    /// No farther ground will be looked at.
    pub is_last: bool,
    workspace: &'a mut Workspace,
}

impl Workspace {
    /// Empty: the first plan fills it.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.survey.bytes()
    }

    /// Surveys the map to `reach_m` around the robot. `None` when its pose is not finite or not on the map; else whether
    /// there is more of the map beyond.
    fn prepare(
        &mut self,
        map: &InformationMap,
        situation: &Situation,
        config: &PlanningConfig,
        reach_m: f64,
    ) -> Option<bool> {
        let map_from_robot = rows_from_pose(&situation.map_from_robot);
        if !map_from_robot.iter().all(|v| v.is_finite()) {
            return None;
        }
        let robot = Point3::from(situation.map_from_robot.translation.vector);
        let extent = Extent::new(map, &robot, reach_m, config)?;
        let key = Key {
            map_from_robot,
            scan_number: situation.scan_number,
            run_seed: situation.run_seed,
            config: config.without_preferences(),
            reach_m,
        };
        let has_changed = self.survey.grid.lay_out(map, &extent, &key.config, situation.threads);
        if has_changed || self.surveyed.as_ref() != Some(&key) {
            self.evaluation = None;
            self.surveyed = None;
            let here = self.survey.grid.at(map.cell_containing(robot.x, robot.y)?)?;
            let behind = place_to_turn(&self.survey.grid, map, [robot.x, robot.y], config);
            self.survey.turns_behind = behind.map(|_| here);
            self.survey.grow(behind.unwrap_or(here), robot, config);
            self.surveyed = Some(key);
        }
        Some(extent.leaves_out_some_of(map))
    }

    /// Draws candidates and finds what each would bring, unless that is known.
    fn evaluate(&mut self, map: &InformationMap, situation: &Situation, config: &PlanningConfig, look: usize) {
        if self.evaluation.as_ref().is_some_and(|known| known.look == look && known.zones == map.zones()) {
            return;
        }
        let cell_m = map.cell_m();
        if !self.view.as_ref().is_some_and(|view| view.is_of(&config.scanner, cell_m)) {
            self.view = None;
        }
        let view = self.view.get_or_insert_with(|| ScannerView::new(&config.scanner, cell_m));
        let draw = draw(&self.survey, situation, config, look);
        let model = GainModel { grid: &self.survey.grid, zones: zones_of(&self.survey.grid, map.zones()), view };
        let mut gains = vec![RawGain::default(); draw.places.len()];
        let places: Vec<_> = draw.places.iter().map(|&(at, _)| (at, self.survey.ground_at(at))).collect();
        for_each_place(&places, &mut gains, situation.threads, &self.pool, |sweep, at, ground, gain| {
            *gain = model.evaluate(sweep, at, ground);
        });
        let yardsticks = Yardsticks {
            footprint_cells: view.footprint_cells,
            flat_quality: view.flat_quality,
            zone_area: map.zones().iter().map(|zone| zone.normal.norm()).sum(),
        };
        self.evaluation = Some(Evaluation { draw, gains, yardsticks, zones: map.zones().to_vec(), look });
    }
}

impl Stage<'_> {
    pub fn survey(&self) -> &Survey {
        &self.workspace.survey
    }

    /// The candidates, each with its terms rated, written into the plan with what was rejected; returns their cells.
    pub fn rate_candidates(&mut self, plan: &mut ViewPlan) -> Vec<usize> {
        self.rate_candidates_of(0, plan)
    }

    /// The same for other candidates at every `look`, until there are none: then the plan stays as it is.
    pub fn rate_candidates_of(&mut self, look: usize, plan: &mut ViewPlan) -> Vec<usize> {
        self.workspace.evaluate(self.map, self.situation, self.config, look);
        let Some(evaluation) = &self.workspace.evaluation else { return Vec::new() };
        let survey = &self.workspace.survey;
        let draw = &evaluation.draw;
        if look > 0 && draw.places.is_empty() {
            return Vec::new();
        }
        let pairs = draw.places.iter().zip(&evaluation.gains);
        plan.candidates = pairs.map(|(&(at, cost), &raw)| Candidate { raw, ..survey.candidate(at, cost) }).collect();
        plan.rejected.clone_from(&draw.rejected);
        plan.rejections.clone_from(&draw.rejections);
        super::utility::rate(&mut plan.candidates, &evaluation.yardsticks, self.config);
        draw.places.iter().map(|&(at, _)| at).collect()
    }

    /// Calls `work` with the model and every candidate of the last [`Stage::rate_candidates`], on all threads.
    pub fn for_each_candidate<R: Send + Default>(
        &self,
        work: impl Fn(&GainModel<'_>, &mut super::sweep::Sweep, usize, f64, &mut R) + Sync,
    ) -> Vec<R> {
        let Workspace { survey, view: Some(view), evaluation: Some(evaluation), pool, .. } = &*self.workspace else {
            return Vec::new();
        };
        let model = GainModel { grid: &survey.grid, zones: zones_of(&survey.grid, self.map.zones()), view };
        let places: Vec<_> = evaluation.draw.places.iter().map(|&(at, _)| (at, survey.ground_at(at))).collect();
        let mut results = Vec::new();
        results.resize_with(places.len(), R::default);
        for_each_place(&places, &mut results, self.situation.threads, pool, |sweep, at, ground, result| {
            work(&model, sweep, at, ground, result);
        });
        results
    }

    /// What Q's raw sum would be over flat, never seen ground.
    pub fn flat_quality(&self) -> f64 {
        self.workspace.view.as_ref().map_or(0.0, |view| view.flat_quality)
    }
}

/// Plans on the ground near the robot, and when `decide` is not convinced by what it finds there (it returns false) and
/// the map goes on, once more on all ground within the horizon.
pub(super) fn plan_in_stages(
    name: &str,
    workspace: &mut Workspace,
    map: &InformationMap,
    situation: &Situation,
    config: &PlanningConfig,
    mut decide: impl FnMut(&mut Stage<'_>, &mut ViewPlan) -> bool,
) -> ViewPlan {
    let mut reach_m = config.near_m.min(config.horizon_m);
    loop {
        let mut plan = empty_plan(name, map, situation, config);
        let Some(goes_on) = workspace.prepare(map, situation, config, reach_m) else { return plan };
        workspace.survey.record(&mut plan);
        let is_last = !goes_on || reach_m >= config.horizon_m;
        let is_convinced = decide(&mut Stage { map, situation, config, is_last, workspace }, &mut plan);
        if is_convinced || is_last {
            return plan;
        }
        reach_m = config.horizon_m;
    }
}

/// A plan that says the robot is lost, to be filled in by who knows better.
fn empty_plan(name: &str, map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> ViewPlan {
    ViewPlan {
        strategy: name.to_owned(),
        map_revision: map.revision(),
        scan_number: situation.scan_number,
        run_seed: situation.run_seed,
        map_from_robot: rows_from_pose(&situation.map_from_robot),
        config: config.clone(),
        stop_threshold: config.stop_threshold(),
        mean_quality: None,
        navigable_cells: 0,
        reachable_cells: 0,
        candidates: Vec::new(),
        rejected: Vec::new(),
        rejections: Rejections::default(),
        tour: Vec::new(),
        decision: Decision::Stop { reason: StopReason::LocalisationLost },
        path: Vec::new(),
    }
}
