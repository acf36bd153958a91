//! What every strategy does first: lay out the map, grow the cost tree, start the record.

use super::config::PlanningConfig;
use super::cost_tree::{CostTree, Terrain};
use super::grid::PlanningGrid;
use super::path::waypoints;
use super::plan::{Candidate, Decision, RejectionReason, Rejections, StopReason, ViewPlan};
use super::strategy::Situation;
use crate::geometry::rows_from_pose;
use crate::information_map::InformationMap;
use nalgebra::Point3;

/// The ground as the robot sees it from where it stands.
pub(super) struct Survey {
    pub grid: PlanningGrid,
    pub terrain: Terrain,
    pub tree: CostTree,
    /// The robot's position [m, map frame].
    pub robot: Point3<f64>,
}

impl Survey {
    /// Lays out the map around the robot. `None` when the pose is not finite or not on the map.
    pub fn new(map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> Option<Self> {
        let robot = Point3::from(situation.map_from_robot.translation.vector);
        if !rows_from_pose(&situation.map_from_robot).iter().all(|v| v.is_finite()) {
            return None;
        }
        let grid = PlanningGrid::new(map, &robot, config)?;
        let start = grid.at(map.cell_containing(robot.x, robot.y)?)?;
        let terrain = terrain(&grid, start, config);
        let tree = CostTree::grow(&terrain, start);
        Some(Self { grid, terrain, tree, robot })
    }

    /// Whether a candidate may stand here, apart from its neighbours; if not, why.
    pub fn check(&self, at: usize) -> Result<f64, RejectionReason> {
        if !self.grid.has(at, PlanningGrid::IN_AREA) {
            return Err(RejectionReason::OutsideArea);
        }
        if self.grid.has(at, PlanningGrid::CRAMPED) {
            return Err(RejectionReason::NearObstacle);
        }
        self.tree.cost(at).ok_or(RejectionReason::Unreachable)
    }

    /// Height of the ground [m, map frame]; where it is not known, that under the robot.
    pub fn ground(&self, at: usize) -> f64 {
        self.grid.known(at).map_or(self.robot.z, |known| f64::from(known.ground))
    }

    /// The centre of a cell on the ground [m, map frame].
    pub fn position(&self, at: usize) -> [f64; 3] {
        let [x, y] = self.grid.centre(at);
        [x, y, self.ground(at)]
    }

    /// A candidate without any gain yet.
    pub fn candidate(&self, at: usize, cost: f64) -> Candidate {
        let path = self.tree.path_to(at);
        let heading = match path.as_slice() {
            [.., before, last] => {
                let (from, to) = (self.grid.centre(*before), self.grid.centre(*last));
                (to[1] - from[1]).atan2(to[0] - from[0])
            }
            _ => 0.0,
        };
        Candidate {
            position: self.position(at),
            heading,
            information: 0.0,
            quality: 0.0,
            zones: 0.0,
            cost,
            utility: 0.0,
            raw: Default::default(),
        }
    }

    /// An empty record that knows the ground; its decision is the reason why there are no candidates.
    pub fn record(&self, plan: &mut ViewPlan) {
        let (mut navigable, mut reachable, mut quality) = (0, 0, 0.0);
        for at in self.grid.with(PlanningGrid::NAVIGABLE) {
            navigable += 1;
            if let (Some(_), Some(known)) = (self.tree.cost(at), self.grid.known(at)) {
                reachable += 1;
                quality += f64::from(known.quality);
            }
        }
        plan.navigable_cells = navigable;
        plan.reachable_cells = reachable;
        plan.mean_quality = (reachable > 0).then(|| quality / reachable as f64);
        let reason = match (navigable, reachable) {
            (0, _) => StopReason::NoNavigableGround,
            (_, 0) => StopReason::NothingReachable,
            _ => StopReason::NoCandidate,
        };
        plan.decision = Decision::Stop { reason };
    }

    /// The way to a cell as waypoints.
    pub fn path_to(&self, at: usize) -> Vec<[f64; 3]> {
        waypoints(self, &self.tree.path_to(at))
    }
}

/// A plan that says the robot is lost, to be filled in by who knows better.
pub(super) fn empty_plan(name: &str, map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> ViewPlan {
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
        decision: Decision::Stop { reason: StopReason::LocalisationLost },
        path: Vec::new(),
    }
}

/// Ground that can be driven on: in the work area, C_nc over the threshold, room for the footprint. Around the start
/// the robot has proven the ground by standing there, so whatever is not an obstacle passes, at the cost of ground
/// that just passes; without this the blind spot under the scanner would lock the robot in.
fn terrain(grid: &PlanningGrid, start: usize, config: &PlanningConfig) -> Terrain {
    let is_free = |flags: u8| {
        let asked = PlanningGrid::NAVIGABLE | PlanningGrid::IN_AREA;
        flags & asked == asked && flags & PlanningGrid::CRAMPED == 0
    };
    let mut slowness: Vec<f64> =
        grid.flags.iter().map(|&flags| if is_free(flags) { 1.0 } else { f64::INFINITY }).collect();
    for (at, slowness) in slowness.iter_mut().enumerate().filter(|(_, slowness)| slowness.is_finite()) {
        *slowness = grid.known(at).map_or(f64::INFINITY, |known| 1.0 / f64::from(known.navigability));
    }
    let worst = 1.0 / config.navigable_threshold;
    for offset in grid.disc(config.start_clearance_m.min(grid.margin as f64 * grid.cell_m)) {
        let at = start.wrapping_add_signed(offset);
        if slowness.get(at).is_some_and(|s| s.is_infinite()) && !grid.has(at, PlanningGrid::BLOCKS) {
            slowness[at] = worst;
        }
    }
    slowness[start] = slowness[start].min(worst);
    Terrain { width: grid.width, height: grid.height, cell_m: grid.cell_m, slowness }
}
