//! The least a strategy can do: any candidate.

use super::candidates::{below, mix};
use super::config::PlanningConfig;
use super::plan::{Decision, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::utility::decide;
use super::visited::Visited;
use super::workspace::{Workspace, plan_in_stages};
use crate::information_map::InformationMap;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Goes to any of the candidates with the same probability, seeded by run and scan. It stops when `multi_criteria` would.
#[derive(Debug, Clone, Default)]
pub struct Random {
    visited: Visited,
}

impl Strategy for Random {
    fn name(&self) -> &str {
        "random"
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
            let Decision::Go { .. } = plan.decision else { return false };
            // Another stream than that of the draw.
            let mut random = ChaCha8Rng::seed_from_u64(mix(situation.run_seed, situation.scan_number));
            random.set_stream(1);
            let candidate = below(&mut random, places.len());
            plan.decision = Decision::Go { candidate };
            plan.path = stage.survey().path_to(places[candidate]);
            true
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_worlds::{at, config, field, map_of, plan_with};
    use super::*;

    #[test]
    fn over_many_scans_many_different_candidates_are_chosen() {
        let map = map_of(&field(60, 60), 0.3);
        let chosen = |scan_number| {
            let situation = Situation { scan_number, ..at(9.0, 9.0) };
            plan_with(&mut Random::default(), &map, &situation, &config()).decision
        };
        let mut seen: Vec<_> = (0..20).map(chosen).map(|decision| format!("{decision:?}")).collect();
        seen.sort();
        seen.dedup();
        assert!(seen.len() > 10, "{seen:?}");
    }
}
