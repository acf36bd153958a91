//! Gain that fades with the way to it: A e^(-lambda L) (Gonzalez-Banos and Latombe, "Navigation strategies for exploring
//! indoor environments", IJRR 2002).

use super::config::PlanningConfig;
use super::greedy::informative;
use super::plan::ViewPlan;
use super::strategy::{Situation, Strategy};
use super::visited::Visited;
use super::workspace::{Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// Goes to the candidate of the highest A e^(-lambda L), with the travel cost C as the length L. Candidates that show too
/// little, or lie where it has scanned, do not count; it stops when there are no others.
#[derive(Debug, Clone, Default)]
pub struct ExponentialGain {
    visited: Visited,
}

impl Strategy for ExponentialGain {
    fn name(&self) -> &str {
        "exponential_gain"
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
            // Never quite nothing: a view that shows enough stays worth going to at any distance.
            let fade = |c: f64| (-config.exponential_lambda * c).exp().max(f64::MIN_POSITIVE);
            let chosen =
                informative(stage, &self.visited, plan, |c| (c.information * fade(c.cost)).max(f64::MIN_POSITIVE));
            match chosen {
                Some(at) => plan.path = stage.survey().path_to(at),
                None => plan.stop_as_done(),
            }
            chosen.is_some()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_worlds::{at, config, field, map_of, plan_with};
    use super::*;

    #[test]
    fn a_larger_lambda_keeps_the_robot_nearer() {
        let map = map_of(&field(100, 100), 0.3);
        let cost = |exponential_lambda| {
            let config = PlanningConfig { exponential_lambda, ..config() };
            plan_with(&mut ExponentialGain::default(), &map, &at(9.0, 15.0), &config).chosen().unwrap().cost
        };
        assert!(cost(2.0) < cost(0.0));
    }
}
