//! Greedy mapping (Koenig, Tovey, Halliburton, "Greedy mapping of terrain", ICRA 2001): always to the nearest place of
//! some kind. What kind makes the variants; the source's experiment "simple IV" is the last.

use super::config::PlanningConfig;
use super::frontier::{add_groups, groups, nearest};
use super::plan::{Candidate, Decision, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::visited::Visited;

use super::workspace::{Stage, Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// What greedy mapping goes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GreedyTarget {
    /// The nearest ground that lies farther than the spacing from every place where it has scanned, while there is a
    /// frontier.
    Unvisited,
    /// The nearest cell beside one that was never seen, of groups that are not too small: all the way, then scan.
    Unscanned,
    /// The same, but scan again after a step of the way (`replanning_step_m`), and go on from what is then known.
    Replanning,
    /// The nearest candidate that shows enough unexplored cells (`informative_min_cells`).
    Informative,
    /// The candidate that shows most unexplored cells, however far.
    NewCells,
}

/// See [`GreedyTarget`]. Nothing within the spacing of a place where it has scanned is gone to again.
#[derive(Debug, Clone)]
pub struct Greedy {
    target: GreedyTarget,
    visited: Visited,
}

impl Greedy {
    /// Greedy mapping towards one kind of place.
    #[must_use]
    pub fn new(target: GreedyTarget) -> Self {
        Self { target, visited: Visited::default() }
    }
}

impl Strategy for Greedy {
    fn name(&self) -> &str {
        match self.target {
            GreedyTarget::Unvisited => "greedy_unvisited",
            GreedyTarget::Unscanned => "greedy_unscanned",
            GreedyTarget::Replanning => "greedy_replanning",
            GreedyTarget::Informative => "greedy_informative",
            GreedyTarget::NewCells => "greedy_new_cells",
        }
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
            let chosen = match self.target {
                GreedyTarget::Unvisited => unvisited(stage, visited, plan),
                GreedyTarget::Unscanned => unscanned(stage, visited, plan),
                GreedyTarget::Replanning => unscanned(stage, visited, plan).map(|at| part_of_way(stage, at, plan)),
                GreedyTarget::Informative => informative(stage, visited, plan, |candidate| 1.0 / candidate.cost),
                GreedyTarget::NewCells => informative(stage, visited, plan, |c| f64::from(c.raw.unexplored_cells)),
            };
            match chosen {
                Some(at) => plan.path = stage.survey().path_to(at),
                None => plan.stop_as_done(),
            }
            chosen.is_some()
        })
    }
}

/// Goes to the best candidate by `utility` among those that show enough; the others have a utility of 0.
pub(super) fn informative(
    stage: &mut Stage<'_>,
    visited: &Visited,
    plan: &mut ViewPlan,
    utility: impl Fn(&Candidate) -> f64,
) -> Option<usize> {
    let places = stage.rate_candidates(plan);
    let (least, spacing_m) = (stage.config.informative_min_cells as u32, stage.config.spacing_m);
    for candidate in &mut plan.candidates {
        let [x, y, _] = candidate.position;
        let counts = candidate.raw.unexplored_cells >= least && !visited.is_near([x, y], spacing_m);
        candidate.utility = if counts { utility(candidate) } else { 0.0 };
    }
    let candidate = super::utility::best(&plan.candidates)?;
    if plan.candidates[candidate].utility <= 0.0 {
        return None;
    }
    plan.decision = Decision::Go { candidate };
    Some(places[candidate])
}

/// The nearest cell of the nearest frontier.
fn unscanned(stage: &Stage<'_>, visited: &Visited, plan: &mut ViewPlan) -> Option<usize> {
    let survey = stage.survey();
    let is_far = |at: usize| !visited.is_near(survey.grid.centre(at), stage.config.spacing_m);
    let cost = |at: usize| survey.tree.cost(at).unwrap_or(f64::INFINITY);
    let nearest_of = |group: &[usize]| {
        let order = |&a: &usize, &b: &usize| is_far(b).cmp(&is_far(a)).then(cost(a).total_cmp(&cost(b)));
        group.iter().copied().min_by(order).unwrap_or_default()
    };
    let places = add_groups(survey, stage.config, visited, plan, nearest_of);
    let candidate = nearest(&plan.candidates)?;
    plan.decision = Decision::Go { candidate };
    Some(places[candidate])
}

/// Ground outside the spacing of every visited place, as long as there is a frontier to be found.
fn unvisited(stage: &Stage<'_>, visited: &Visited, plan: &mut ViewPlan) -> Option<usize> {
    let survey = stage.survey();
    if !groups(survey, stage.config).iter().any(|group| group.len() >= stage.config.frontier_min_cells) {
        return None;
    }
    let is_new = |at: usize| !visited.is_near(survey.grid.centre(at), stage.config.spacing_m);
    let mut best: Option<(usize, f64)> = None;
    for at in survey.grid.navigable.ones() {
        let Ok(cost) = survey.check(at) else { continue };
        if best.is_none_or(|(_, least)| cost < least) && is_new(at) {
            best = Some((at, cost));
        }
    }
    let (at, cost) = best?;
    plan.candidates.push(Candidate { utility: 1.0 / cost, ..survey.candidate(at, cost) });
    plan.decision = Decision::Go { candidate: 0 };
    Some(at)
}

/// Replaces the chosen candidate by the last cell on the way to it that is no farther than the step, but farther than the
/// spacing or the candidate itself.
fn part_of_way(stage: &Stage<'_>, at: usize, plan: &mut ViewPlan) -> usize {
    let survey = stage.survey();
    let step = stage.config.replanning_step_m.max(stage.config.spacing_m);
    let cost = |at: usize| survey.tree.cost(at).unwrap_or(f64::INFINITY);
    let way = survey.tree.path_to(at);
    let end = way.iter().copied().find(|&cell| cost(cell) >= step && survey.check(cell).is_ok()).unwrap_or(at);
    if let Decision::Go { candidate } = plan.decision {
        let target = plan.candidates[candidate];
        plan.candidates[candidate] =
            Candidate { raw: target.raw, utility: target.utility, ..survey.candidate(end, cost(end)) };
    }
    end
}

#[cfg(test)]
mod tests {
    use super::super::test_worlds::{at, config, field, map_of, plan_with};
    use super::*;
    use crate::view_planning::Decision;

    fn plan(target: GreedyTarget, map: &InformationMap, config: &PlanningConfig) -> ViewPlan {
        plan_with(&mut Greedy::new(target), map, &at(4.5, 4.5), config)
    }

    #[test]
    fn replanning_goes_a_step_of_the_way_to_the_nearest_unscanned_cell() {
        let map = map_of(&field(100, 100), 0.3);
        let config = PlanningConfig { replanning_step_m: 2.0, ..config() };
        let (far, near) = (plan(GreedyTarget::Unscanned, &map, &config), plan(GreedyTarget::Replanning, &map, &config));
        let (far, near) = (far.chosen().unwrap().cost, near.chosen().unwrap().cost);
        assert!((2.0..2.5).contains(&near) && near < far, "{near} {far}");
    }

    #[test]
    fn the_nearest_informative_view_is_nearer_and_the_newest_shows_more() {
        let map = map_of(&field(60, 60), 0.3);
        let (near, new) =
            (plan(GreedyTarget::Informative, &map, &config()), plan(GreedyTarget::NewCells, &map, &config()));
        let (near, new) = (near.chosen().unwrap(), new.chosen().unwrap());
        assert!(near.cost < new.cost && near.raw.unexplored_cells < new.raw.unexplored_cells, "{near:?} {new:?}");
        assert!(near.raw.unexplored_cells >= 100);
    }

    #[test]
    fn unvisited_ground_is_taken_place_by_place_and_never_twice() {
        let map = map_of(&field(40, 40), 0.3);
        let mut greedy = Greedy::new(GreedyTarget::Unvisited);
        let mut places = vec![[6.0, 6.0]];
        for scan in 0..12 {
            let [x, y] = places[places.len() - 1];
            let situation = Situation { scan_number: scan, ..at(x, y) };
            let plan = plan_with(&mut greedy, &map, &situation, &PlanningConfig { spacing_m: 2.0, ..config() });
            let Decision::Go { .. } = plan.decision else { panic!("{:?}", plan.decision) };
            let [x, y, _] = plan.chosen().unwrap().position;
            assert!(places.iter().all(|place: &[f64; 2]| (place[0] - x).hypot(place[1] - y) > 2.0));
            places.push([x, y]);
        }
    }
}
