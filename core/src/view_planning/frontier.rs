//! Frontier exploration (Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997): go to the
//! nearest border between ground that can be driven on and the unknown.

use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use super::plan::{Candidate, Decision, RejectionReason, StopReason, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::survey::{Survey, empty_plan};
use crate::information_map::InformationMap;

/// One candidate for each group of joined frontier cells: its cell nearest to the group's centre. The nearest by path
/// cost is chosen; the utility is 1 / C. It stops when no frontier is left.
#[derive(Debug, Clone, Copy, Default)]
pub struct Frontier;

impl Strategy for Frontier {
    fn name(&self) -> &str {
        "frontier"
    }

    fn plan(&mut self, map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> ViewPlan {
        let mut plan = empty_plan(self.name(), map, situation, config);
        let Some(survey) = Survey::new(map, situation, config) else { return plan };
        survey.record(&mut plan);

        let groups = groups(&survey);
        let mut places = Vec::new();
        for group in &groups {
            let at = middle(&survey, group);
            match check(&survey, group, at, config) {
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
        if let Some(candidate) = nearest(&plan.candidates) {
            plan.decision = Decision::Go { candidate };
            plan.path = places.get(candidate).map(|&at| survey.path_to(at)).unwrap_or_default();
        } else if plan.reachable_cells > 0 {
            plan.decision = Decision::Stop { reason: StopReason::Done };
        }
        plan
    }
}

fn check(survey: &Survey, group: &[usize], at: usize, config: &PlanningConfig) -> Result<f64, RejectionReason> {
    if group.len() < config.frontier_min_cells {
        return Err(RejectionReason::SmallFrontier);
    }
    let [x, y] = survey.grid.centre(at);
    if (x - survey.robot.x).hypot(y - survey.robot.y) <= config.spacing_m {
        return Err(RejectionReason::NearRobot);
    }
    survey.check(at)
}

fn nearest(candidates: &[Candidate]) -> Option<usize> {
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

/// The groups of frontier cells (reachable, beside an unexplored cell) that touch each other, in a fixed order.
fn groups(survey: &Survey) -> Vec<Vec<usize>> {
    let grid = &survey.grid;
    let width = grid.width as isize;
    let around = [1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1];
    let is_frontier = |at: usize| {
        let is_open = |offset: &isize| grid.has(at.wrapping_add_signed(*offset), PlanningGrid::UNEXPLORED);
        survey.check(at).is_ok() && around.iter().any(is_open)
    };
    // Ground that can be driven on keeps a margin to the edge of the grid, so neighbours always exist.
    let mut open = vec![false; grid.flags.len()];
    for at in grid.with(PlanningGrid::NAVIGABLE) {
        open[at] = is_frontier(at);
    }
    let mut groups = Vec::new();
    for first in grid.with(PlanningGrid::NAVIGABLE) {
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
