//! The source's strategy: the next best view by information, quality, zones of interest and cost (4.2).

use super::config::PlanningConfig;
use super::plan::{Decision, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::utility::decide;
use super::workspace::{Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// Draws candidates, rates each by u = (w_A A + w_Q Q + w_O O) / (w_C C) (2.3), goes to the best.
#[derive(Debug, Clone, Copy, Default)]
pub struct MultiCriteria;

impl Strategy for MultiCriteria {
    fn name(&self) -> &str {
        "multi_criteria"
    }

    fn plan(
        &mut self,
        workspace: &mut Workspace,
        map: &InformationMap,
        situation: &Situation,
        config: &PlanningConfig,
    ) -> ViewPlan {
        plan_in_stages(self.name(), workspace, map, situation, config, |stage, plan| {
            let places = stage.rate_candidates(plan);
            if let Some(decision) = decide(&plan.candidates, plan.mean_quality, config) {
                plan.decision = decision;
            }
            let Decision::Go { candidate } = plan.decision else { return false };
            plan.path = stage.survey().path_to(places[candidate]);
            plan.candidates[candidate].utility >= plan.stop_threshold
        })
    }
}
