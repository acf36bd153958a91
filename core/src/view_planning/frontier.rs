//! Frontier exploration (Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997): go to the
//! nearest border between ground that can be driven on and the unknown.

use super::config::PlanningConfig;
use super::plan::{Candidate, Decision, RejectionReason, StopReason, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::survey::Survey;
use super::visited::Visited;
use super::workspace::{Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// One candidate for each group of joined frontier cells: its cell nearest to the group's centre. The nearest by path
/// cost is chosen; the utility is 1 / C. It stops when no frontier is left but those at places where it has scanned.
#[derive(Debug, Clone, Default)]
pub struct Frontier {
    visited: Visited,
}

impl Strategy for Frontier {
    fn name(&self) -> &str {
        "frontier"
    }

    fn remember(&mut self, situation: &Situation) {
        self.visited.remember(situation);
    }

    fn plan(
        &mut self,
        workspace: &mut Workspace,
        map: &InformationMap,
        situation: &Situation,
        config: &PlanningConfig,
    ) -> ViewPlan {
        self.visited.remember(situation);
        plan_in_stages(self.name(), workspace, map, situation, config, |stage, plan| {
            let survey = stage.survey();
            let places = add_groups(survey, config, &self.visited, plan, |group| middle(survey, group));
            match nearest(&plan.candidates) {
                Some(candidate) => {
                    plan.decision = Decision::Go { candidate };
                    plan.path = survey.path_to(places[candidate]);
                    true
                }
                None => {
                    plan.stop_as_done();
                    false
                }
            }
        })
    }
}

impl ViewPlan {
    /// Nothing is left of what the strategy looks for; without reachable ground, the reason stays.
    pub(super) fn stop_as_done(&mut self) {
        if self.reachable_cells > 0 {
            self.decision = Decision::Stop { reason: StopReason::Done };
        }
    }
}

/// Makes a candidate of one cell of every group of frontier cells, `choose`s which, and returns the cells. The utility is
/// 1 / C.
pub(super) fn add_groups(
    survey: &Survey,
    config: &PlanningConfig,
    visited: &Visited,
    plan: &mut ViewPlan,
    choose: impl Fn(&[usize]) -> usize,
) -> Vec<usize> {
    let mut places = Vec::new();
    for group in groups(survey, config) {
        let at = choose(&group);
        match check(survey, &group, at, visited, config) {
            Ok(cost) => {
                let mut candidate = survey.candidate(at, cost);
                candidate.raw.unexplored_cells = group.len() as u32;
                candidate.utility = 1.0 / cost;
                plan.candidates.push(candidate);
                places.push(at);
            }
            Err(reason) => plan.reject(survey.grid.centre(at), reason),
        }
    }
    places
}

fn check(
    survey: &Survey,
    group: &[usize],
    at: usize,
    visited: &Visited,
    config: &PlanningConfig,
) -> Result<f64, RejectionReason> {
    if group.len() < config.frontier_min_cells {
        return Err(RejectionReason::SmallFrontier);
    }
    if visited.is_near(survey.grid.centre(at), config.spacing_m) {
        return Err(RejectionReason::NearRobot);
    }
    survey.check(at)
}

/// The candidate of the least cost, the first of equals.
pub(super) fn nearest(candidates: &[Candidate]) -> Option<usize> {
    (0..candidates.len()).min_by(|&a, &b| candidates[a].cost.total_cmp(&candidates[b].cost))
}

/// The cell of a group nearest to the mean of its cells, the first of equals.
fn middle(survey: &Survey, group: &[usize]) -> usize {
    let index = |at: usize| {
        let cell = survey.grid.index(at);
        [i64::from(cell.x), i64::from(cell.y)]
    };
    let count = group.len() as i64;
    let sum = group.iter().map(|&at| index(at)).fold([0, 0], |sum, cell| [sum[0] + cell[0], sum[1] + cell[1]]);
    let distance = |&at: &usize| {
        let cell = index(at);
        let [dx, dy] = [cell[0] * count - sum[0], cell[1] * count - sum[1]];
        i128::from(dx) * i128::from(dx) + i128::from(dy) * i128::from(dy)
    };
    group.iter().copied().min_by_key(distance).unwrap_or_default()
}

/// The groups of frontier cells (reachable, and as near to unexplored ground as the robot may go) that touch each other, in a
/// fixed order.
pub(super) fn groups(survey: &Survey, config: &PlanningConfig) -> Vec<Vec<usize>> {
    let grid = &survey.grid;
    let brink = grid.brink(config);
    let width = grid.width as isize;
    let around = [1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1];
    let is_frontier = |at: usize| survey.check(at).is_ok() && grid.has(&brink, at);
    // Ground that can be driven on keeps a margin to the edge of the grid, so neighbours always exist.
    let mut open = vec![false; grid.len()];
    for at in grid.navigable.ones() {
        open[at] = is_frontier(at);
    }
    let mut groups = Vec::new();
    for first in grid.navigable.ones() {
        if !std::mem::take(&mut open[first]) {
            continue;
        }
        let mut group = vec![first];
        let mut next = 0;
        while let Some(&at) = group.get(next) {
            next += 1;
            for offset in around {
                let beside = at.wrapping_add_signed(offset);
                if std::mem::take(&mut open[beside]) {
                    group.push(beside);
                }
            }
        }
        groups.push(group);
    }
    groups
}
