//! What every strategy looks at: the ground as the robot sees it from where it stands.

use super::config::PlanningConfig;
use super::cost_tree::{CostTree, Terrain};
use super::grid::PlanningGrid;
use super::path::waypoints;
use super::plan::{Candidate, Decision, RejectionReason, StopReason, ViewPlan};
use nalgebra::Point3;

/// The window, the terrain and the ways over it.
#[derive(Debug, Default)]
pub(super) struct Survey {
    pub grid: PlanningGrid,
    pub terrain: Terrain,
    pub tree: CostTree,
    /// The robot's position [m, map frame].
    pub robot: Point3<f64>,
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

    /// The way to a cell as waypoints.
    pub fn path_to(&self, at: usize) -> Vec<[f64; 3]> {
        waypoints(self, &self.tree.path_to(at))
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

    /// Ground that can be driven on: in the work area, C_nc over the threshold, room for the footprint. Around the start
    /// the robot has proven the ground by standing there, so whatever is not an obstacle passes, at the cost of ground
    /// that just passes; without this the blind spot under the scanner would lock the robot in.
    fn lay_terrain(&mut self, start: usize, config: &PlanningConfig) {
        let grid = &self.grid;
        let terrain = &mut self.terrain;
        (terrain.width, terrain.cell_m) = (grid.width, grid.cell_m);
        terrain.slowness.clear();
        terrain.slowness.resize(grid.len(), f32::INFINITY);
        let planes = grid.navigable.words.iter().zip(&grid.area.words).zip(&grid.cramped.words);
        for (word, ((navigable, area), cramped)) in planes.enumerate() {
            let mut free = navigable & area & !cramped;
            while free != 0 {
                let at = word * super::bits::WORD + free.trailing_zeros() as usize;
                free &= free - 1;
                if let Some((digest, within)) = grid.known_cell(at) {
                    terrain.slowness[at] = 1.0 / digest.cells.navigability[within];
                }
            }
        }
        let worst = 1.0 / config.navigable_threshold as f32;
        for offset in grid.disc(config.start_clearance_m) {
            let at = start.wrapping_add_signed(offset);
            if terrain.slowness[at].is_infinite() && !grid.has(&grid.blocks, at) {
                terrain.slowness[at] = worst;
            }
        }
        terrain.slowness[start] = terrain.slowness[start].min(worst);
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.grid.bytes() + self.tree.bytes() + 4 * self.terrain.slowness.capacity()
    }
}
