//! The source's strategy: the next best view by information, quality, zones of interest and cost (4.2).

use super::candidates::draw;
use super::config::PlanningConfig;
use super::gain::{GainModel, evaluate_all};
use super::plan::{Decision, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::survey::{Survey, empty_plan};
use super::utility::{Yardsticks, decide, rate};
use crate::information_map::InformationMap;

/// Draws candidates, rates each by u = (w_A A + w_Q Q + w_O O) / (w_C C) (2.3), goes to the best.
#[derive(Debug, Clone, Copy, Default)]
pub struct MultiCriteria;

impl Strategy for MultiCriteria {
    fn name(&self) -> &str {
        "multi_criteria"
    }

    fn plan(&mut self, map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> ViewPlan {
        let mut plan = empty_plan(self.name(), map, situation, config);
        let Some(survey) = Survey::new(map, situation, config) else { return plan };
        survey.record(&mut plan);

        let drawn = draw(&survey, situation, config, &mut plan);
        let model = GainModel::new(map, &survey.grid, config);
        let places: Vec<_> = drawn.iter().map(|&(at, _)| (at, survey.ground(at))).collect();
        let gains = evaluate_all(&model, &places, situation.threads);
        plan.candidates = drawn.iter().map(|&(at, cost)| survey.candidate(at, cost)).collect();
        for (candidate, raw) in plan.candidates.iter_mut().zip(gains) {
            candidate.raw = raw;
        }
        let yardsticks = Yardsticks {
            footprint_cells: model.footprint_cells,
            flat_quality: model.flat_quality,
            zone_area: model.zone_area,
        };
        rate(&mut plan.candidates, &yardsticks, config);

        if let Some(decision) = decide(&plan.candidates, plan.mean_quality, config) {
            plan.decision = decision;
        }
        if let Decision::Go { candidate } = plan.decision
            && let Some(&(at, _)) = drawn.get(candidate)
        {
            plan.path = survey.path_to(at);
        }
        plan
    }
}
