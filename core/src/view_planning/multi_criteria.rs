//! The source's strategy: the next best view by information, quality, zones of interest and cost (4.2).

use super::config::PlanningConfig;
use super::plan::{Decision, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::utility::decide;
use super::visited::Visited;
use super::workspace::{Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// Draws candidates, rates each by u = (w_A A + w_Q Q + w_O O) / (w_C C) (2.3), goes to the best. Under the source's
/// threshold (4.12) it goes on as long as unexplored ground of the work area is in view from somewhere new.
#[derive(Debug, Clone, Default)]
pub struct MultiCriteria {
    visited: Visited,
}

impl Strategy for MultiCriteria {
    fn name(&self) -> &str {
        "multi_criteria"
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
        let visited = &self.visited;
        plan_in_stages(self.name(), workspace, map, situation, config, |stage, plan| {
            let places = stage.rate_candidates(plan);
            if let Some(decision) = decide(&plan.candidates, plan.mean_quality, visited, config) {
                plan.decision = decision;
            }
            let Decision::Go { candidate } = plan.decision else { return false };
            plan.path = stage.survey().path_to(places[candidate]);
            // Under the threshold there may be something better farther off.
            plan.candidates[candidate].utility >= plan.stop_threshold
        })
    }
}
