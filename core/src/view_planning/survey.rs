//! What every strategy looks at: the ground as the robot sees it from where it stands.

use super::config::PlanningConfig;
use super::cost_tree::{CostTree, Terrain};
use super::grid::PlanningGrid;
use super::path::waypoints;
use super::plan::{Candidate, Decision, RejectionReason, StopReason, ViewPlan};
use super::relief::ReliefLimits;
use nalgebra::Point3;

/// The window, the terrain and the ways over it.
#[derive(Debug, Default)]
pub(super) struct Survey {
    pub grid: PlanningGrid,
    pub terrain: Terrain,
    pub tree: CostTree,
    /// The robot's position [m, map frame].
    pub robot: Point3<f64>,
    /// The robot's own cell, where its ways begin elsewhere: at a place behind it at which it can turn.
    pub turns_behind: Option<usize>,
    pub ground: Ground,
}

/// The ground that can be driven on, in numbers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ground {
    navigable_cells: usize,
    reachable_cells: usize,
    mean_quality: Option<f64>,
}

impl Survey {
    /// Grows the ways over a grid that has just been laid out.
    pub fn grow(&mut self, start: usize, robot: Point3<f64>, config: &PlanningConfig) {
        self.robot = robot;
        self.lay_terrain(start, config);
        self.tree.grow(&self.terrain, start);
        self.ground = self.count();
    }

    /// Whether a candidate may stand here, apart from its neighbours; if not, why.
    pub fn check(&self, at: usize) -> Result<f64, RejectionReason> {
        if !self.grid.has(&self.grid.area, at) {
            return Err(RejectionReason::OutsideArea);
        }
        if self.grid.has(&self.grid.cramped, at) {
            return Err(RejectionReason::NearObstacle);
        }
        self.tree.cost(at).ok_or(RejectionReason::Unreachable)
    }

    /// Height of the ground [m, map frame]; where it is not known, that under the robot.
    pub fn ground_at(&self, at: usize) -> f64 {
        let known = self.grid.known_cell(at);
        known.map_or(self.robot.z, |(digest, within)| f64::from(digest.cells.ground[within]))
    }

    /// The centre of a cell on the ground [m, map frame].
    pub fn position(&self, at: usize) -> [f64; 3] {
        let [x, y] = self.grid.centre(at);
        [x, y, self.ground_at(at)]
    }

    /// A candidate without any gain yet.
    pub fn candidate(&self, at: usize, cost: f64) -> Candidate {
        let before = self.tree.parent(at).map(|before| self.grid.centre(before));
        let to = self.grid.centre(at);
        let heading = before.map_or(0.0, |from| (to[1] - from[1]).atan2(to[0] - from[0]));
        Candidate { position: self.position(at), heading, cost, ..Candidate::default() }
    }

    /// An empty record that knows the ground; its decision is the reason why there are no candidates.
    pub fn record(&self, plan: &mut ViewPlan) {
        let Ground { navigable_cells, reachable_cells, mean_quality } = self.ground;
        (plan.navigable_cells, plan.reachable_cells) = (navigable_cells, reachable_cells);
        plan.mean_quality = mean_quality;
        let reason = match (navigable_cells, reachable_cells) {
            (0, _) => StopReason::NoNavigableGround,
            (_, 0) => StopReason::NothingReachable,
            _ => StopReason::NoCandidate,
        };
        plan.decision = Decision::Stop { reason };
    }

    /// The way to a cell as waypoints; where the robot cannot turn as it stands the first piece leads straight back.
    pub fn path_to(&self, at: usize) -> Vec<[f64; 3]> {
        let here = self.turns_behind.map(|cell| self.position(cell));
        here.into_iter().chain(waypoints(self, &self.tree.path_to(at))).collect()
    }

    fn count(&self) -> Ground {
        let (mut navigable_cells, mut reachable_cells, mut quality) = (0, 0, 0.0);
        for at in self.grid.navigable.ones() {
            navigable_cells += 1;
            if self.tree.cost(at).is_some()
                && let Some((digest, within)) = self.grid.known_cell(at)
            {
                reachable_cells += 1;
                quality += f64::from(digest.cells.quality[within]);
            }
        }
        let mean_quality = (reachable_cells > 0).then(|| quality / reachable_cells as f64);
        Ground { navigable_cells, reachable_cells, mean_quality }
    }

    /// Ground that can be driven on: in the work area, C_nc over the threshold, room for the footprint; and what the robot has
    /// driven over, at the cost of ground that it must get away from. Around the start
    /// the robot has proven the ground by standing there, so whatever is not an obstacle or a step passes, at the cost of ground
    /// that just passes; without this the blind spot under the scanner would lock the robot in. Between no two neighbours
    /// that pass the ground differs by more than the robot masters.
    fn lay_terrain(&mut self, start: usize, config: &PlanningConfig) {
        let grid = &self.grid;
        let terrain = &mut self.terrain;
        (terrain.width, terrain.cell_m) = (grid.width, grid.cell_m);
        terrain.slowness.clear();
        terrain.slowness.resize(grid.len(), f32::INFINITY);
        let dearer = dearer(config);
        let worst = 1.0 / config.navigable_threshold as f32;
        let ground =
            grid.navigable.words.iter().zip(&grid.cramped.words).zip(grid.driven.words.iter().zip(&grid.area.words));
        for (word, ((navigable, cramped), (driven, area))) in ground.enumerate() {
            let mut free = (navigable & !cramped | driven) & area;
            while free != 0 {
                let at = word * super::bits::WORD + free.trailing_zeros() as usize;
                free &= free - 1;
                let proven = grid.known_cell(at).filter(|_| grid.has(&grid.navigable, at));
                let slowness = proven.map_or(worst, |(digest, within)| 1.0 / digest.cells.navigability[within]);
                terrain.slowness[at] = dearer[usize::from(grid.closeness(at))] * slowness;
            }
        }
        self.terrain.slowness[start] = self.terrain.slowness[start].min(worst);
        for at in self.around_start(start, config.start_clearance_m) {
            if self.terrain.slowness[at].is_infinite() && self.is_even_with_ground_around(at, start, config) {
                self.terrain.slowness[at] = worst * dearer[usize::from(self.grid.closeness(at))];
            }
        }
    }

    /// The cells that pass because the robot stands there, the nearest first.
    fn around_start(&self, start: usize, clearance_m: f64) -> Vec<usize> {
        let mut disc: Vec<_> = self.grid.disc(clearance_m).into_iter().map(|o| start.wrapping_add_signed(o)).collect();
        disc.retain(|&at| !self.grid.has(&self.grid.blocks, at) && !self.grid.has(&self.grid.held, at));
        disc.sort_by_key(|&at| (self.grid.square_distance(at, start), at));
        disc
    }

    /// Whether no step leads from a cell near the start to a neighbour that passes already. Ground that was never seen is
    /// taken to be as the robot's, as far as the steepest slope allows.
    fn is_even_with_ground_around(&self, at: usize, start: usize, config: &PlanningConfig) -> bool {
        let limits = ReliefLimits::new(config, self.grid.cell_m);
        let ground = |at| self.grid.ground(at);
        let robot = self.robot.z as f32;
        let is_robots = |height: f32, at: usize| {
            let distance = (self.grid.square_distance(at, start) as f64).sqrt() * self.grid.cell_m;
            (height - robot).abs() <= limits.step + distance as f32 * limits.slope
        };
        let is_even = |next: usize, limit: f32| {
            !self.terrain.is_passable(next)
                || match (ground(at), ground(next)) {
                    (Some(here), Some(there)) => (here - there).abs() <= limit,
                    (Some(here), None) => is_robots(here, at),
                    (None, Some(there)) => is_robots(there, next),
                    (None, None) => true,
                }
        };
        self.grid
            .neighbours(at)
            .all(|(next, is_beside)| is_even(next, if is_beside { limits.beside } else { limits.diagonal }))
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.grid.bytes() + self.tree.bytes() + 4 * self.terrain.slowness.capacity()
    }
}

/// By which the cost of a metre grows with the closeness to what the robot keeps away from. Where its footprint touches that,
/// which it may only where it stands already, it gets away the shortest way.
fn dearer(config: &PlanningConfig) -> [f32; 4] {
    let weight = if config.clearance_m > 0.0 { config.clearance_weight as f32 } else { 0.0 };
    [1.0, 1.0 + weight / 3.0, 1.0 + weight, 1.0 + 2.0 * weight]
}
