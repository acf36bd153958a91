//! From raw sums to A, Q, O in [0, 1], to the utility (2.3), to the decision.

use super::config::{Normalisation, PlanningConfig, Weights};
use super::plan::{Candidate, Decision, StopReason};
use super::visited::Visited;

/// What the raw sums are divided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Yardsticks {
    /// Cells of the scanner's footprint: A_ce / A_cell (4.7).
    pub footprint_cells: f64,
    /// Quality sum of flat, never seen ground.
    pub flat_quality: f64,
    /// Area of all zones [m^2].
    pub zone_area: f64,
}

/// Fills in A, Q, O and u of every candidate from its raw sums and its cost.
pub(super) fn rate(candidates: &mut [Candidate], yardsticks: &Yardsticks, config: &PlanningConfig) {
    let best = |raw: fn(&Candidate) -> f64| candidates.iter().map(raw).fold(0.0, f64::max);
    let (quality, zones) = match config.normalisation {
        Normalisation::Absolute => (yardsticks.flat_quality, yardsticks.zone_area.max(config.zone_saturation_m2)),
        Normalisation::BestCandidate => (best(|c| c.raw.quality_sum), best(|c| c.raw.zone_sum)),
    };
    for candidate in candidates {
        candidate.information = share(f64::from(candidate.raw.unexplored_cells), yardsticks.footprint_cells);
        candidate.quality = share(candidate.raw.quality_sum, quality);
        candidate.zones = share(candidate.raw.zone_sum, zones);
        candidate.utility = utility(candidate, &config.weights);
    }
}

fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 }
}

/// u = (w_A A + w_Q Q + w_O O) / (w_C C) (2.3). Candidates keep their distance from the robot, so C is not 0; a
/// cost of nothing would be no reason to go.
fn utility(candidate: &Candidate, weights: &Weights) -> f64 {
    let gain = weights.information * candidate.information
        + weights.quality * candidate.quality
        + weights.zones * candidate.zones;
    if candidate.cost > 0.0 { gain / (weights.cost * candidate.cost) } else { 0.0 }
}

/// The candidate of the highest utility, the first of equals.
pub(super) fn best(candidates: &[Candidate]) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (index, candidate) in candidates.iter().enumerate() {
        if best.is_none_or(|(_, utility)| candidate.utility > utility) {
            best = Some((index, candidate.utility));
        }
    }
    best.map(|(index, _)| index)
}

/// Go to the best candidate, unless max u < C_p and the asked mean quality is reached (4.12), or nothing is to be gained
/// anywhere. While ground of the work area is unexplored, to the best of those that show some. `None` without candidates.
pub(super) fn decide(
    candidates: &[Candidate],
    mean_quality: Option<f64>,
    visited: &Visited,
    config: &PlanningConfig,
) -> Option<Decision> {
    let candidate = best(candidates)?;
    let utility = candidates.get(candidate)?.utility;
    let is_good = mean_quality.unwrap_or(0.0) >= config.min_mean_quality;
    if utility < config.stop_threshold() && is_good {
        let unexplored = best_unexplored(candidates, visited, config);
        let done = Decision::Stop { reason: StopReason::Done };
        return Some(unexplored.map_or(done, |candidate| Decision::Go { candidate }));
    }
    Some(if utility <= 0.0 { Decision::Stop { reason: StopReason::NothingToGain } } else { Decision::Go { candidate } })
}

/// The best candidate that shows so much unexplored ground that the work is not done.
fn best_unexplored(candidates: &[Candidate], visited: &Visited, config: &PlanningConfig) -> Option<usize> {
    let shown = unexplored(candidates, visited, config).into_iter().filter(|&index| candidates[index].utility > 0.0);
    shown.reduce(|a, b| if candidates[b].utility > candidates[a].utility { b } else { a })
}

/// The candidates that show so much unexplored ground that the work is not done. What a scan nearby did not show, another one
/// there will not, so only candidates away from all earlier scans count, and every exploration ends.
pub(super) fn unexplored(candidates: &[Candidate], visited: &Visited, config: &PlanningConfig) -> Vec<usize> {
    // Without a work area there is always more to explore.
    if config.work_area.is_none() {
        return Vec::new();
    }
    let shows = |c: &Candidate| {
        c.information >= config.least_information && !visited.is_near([c.position[0], c.position[1]], config.spacing_m)
    };
    (0..candidates.len()).filter(|&index| shows(&candidates[index])).collect()
}

#[cfg(test)]
mod tests {
    use super::super::plan::RawGain;
    use super::*;
    use proptest::prelude::*;

    fn candidate(unexplored_cells: u32, quality_sum: f64, zone_sum: f64, cost: f64) -> Candidate {
        let raw = RawGain { unexplored_cells, known_cells: 0, quality_sum, zone_sum };
        let zero = 0.0;
        Candidate {
            position: [0.0; 3],
            heading: zero,
            information: zero,
            quality: zero,
            zones: zero,
            cost,
            utility: zero,
            raw,
        }
    }

    const YARDSTICKS: Yardsticks = Yardsticks { footprint_cells: 1000.0, flat_quality: 200.0, zone_area: 20.0 };

    fn rated(mut candidates: Vec<Candidate>, config: &PlanningConfig) -> Vec<Candidate> {
        rate(&mut candidates, &YARDSTICKS, config);
        candidates
    }

    #[test]
    fn the_utility_is_the_weighted_gain_over_the_weighted_cost() {
        let rated = rated(vec![candidate(500, 50.0, 10.0, 10.0)], &PlanningConfig::default());
        let expected = (0.43 * 0.5 + 0.35 * 0.25 + 0.22 * 0.5) / (0.09 * 10.0);
        assert!((rated[0].utility - expected).abs() < 1e-12);
    }

    #[test]
    fn relative_normalisation_gives_the_best_candidate_one() {
        let config = PlanningConfig { normalisation: Normalisation::BestCandidate, ..Default::default() };
        let rated = rated(vec![candidate(0, 5.0, 0.0, 4.0), candidate(0, 10.0, 0.0, 4.0)], &config);
        assert_eq!((rated[0].quality, rated[1].quality), (0.5, 1.0));
        assert_eq!(rated[0].zones, 0.0);
    }

    #[test]
    fn exploration_ends_under_the_threshold_only_with_the_asked_quality() {
        let config = PlanningConfig { min_mean_quality: 0.5, ..Default::default() };
        let nowhere = Visited::default();
        let poor = rated(vec![candidate(1, 0.0, 0.0, 40.0), candidate(2, 0.0, 0.0, 40.0)], &config);
        assert!(poor[1].utility < config.stop_threshold());
        assert_eq!(decide(&poor, Some(0.6), &nowhere, &config), Some(Decision::Stop { reason: StopReason::Done }));
        assert_eq!(decide(&poor, Some(0.4), &nowhere, &config), Some(Decision::Go { candidate: 1 }));
        let rich = rated(vec![candidate(900, 0.0, 0.0, 5.0)], &config);
        assert_eq!(decide(&rich, Some(0.9), &nowhere, &config), Some(Decision::Go { candidate: 0 }));
    }

    #[test]
    fn exploration_goes_on_under_the_threshold_while_unexplored_ground_is_in_view_from_somewhere_new() {
        use super::super::config::WorkArea;
        use super::super::test_worlds::at;
        let area = WorkArea { min: [-50.0; 2], max: [50.0; 2] };
        let config = PlanningConfig { work_area: Some(area), least_information: 0.02, ..Default::default() };
        let place = |x, candidate: Candidate| Candidate { position: [x, 0.0, 0.0], ..candidate };
        let candidates = vec![
            place(1.0, candidate(40, 0.0, 0.0, 80.0)),
            place(10.0, candidate(30, 0.0, 0.0, 80.0)),
            place(20.0, candidate(19, 1.0, 0.0, 20.0)),
        ];
        let rated = rated(candidates, &config);
        assert!(rated.iter().all(|c| c.utility < config.stop_threshold()));
        let mut visited = Visited::default();
        let decision = |visited: &Visited, config: &PlanningConfig| decide(&rated, Some(0.6), visited, config);
        assert_eq!(decision(&visited, &config), Some(Decision::Go { candidate: 0 }));
        visited.remember(&at(0.0, 0.0));
        assert_eq!(decision(&visited, &config), Some(Decision::Go { candidate: 1 }), "it has scanned beside the first");
        visited.remember(&super::super::Situation { scan_number: 9, ..at(9.0, 0.0) });
        let done = Some(Decision::Stop { reason: StopReason::Done });
        assert_eq!(decision(&visited, &config), done, "the last shows too little");
        let boundless = PlanningConfig { work_area: None, ..config.clone() };
        assert_eq!(decision(&Visited::default(), &boundless), done);
        let source = PlanningConfig { least_information: 1.0, ..config };
        assert_eq!(decision(&Visited::default(), &source), done, "the source's rule alone");
    }

    #[test]
    fn without_any_gain_the_robot_does_not_drive_for_quality_it_cannot_reach() {
        let config = PlanningConfig { min_mean_quality: 0.9, ..Default::default() };
        let nothing = rated(vec![candidate(0, 0.0, 0.0, 5.0)], &config);
        assert_eq!(
            decide(&nothing, Some(0.1), &Visited::default(), &config),
            Some(Decision::Stop { reason: StopReason::NothingToGain })
        );
        assert_eq!(decide(&[], Some(0.1), &Visited::default(), &config), None);
    }

    proptest! {
        #[test]
        fn every_criterion_stays_between_zero_and_one(
            raws in prop::collection::vec((0..5000u32, 0.0..1e4f64, 0.0..1e3f64, 0.0..500.0f64), 1..20), relative in any::<bool>(),
        ) {
            let normalisation = if relative { Normalisation::BestCandidate } else { Normalisation::Absolute };
            let config = PlanningConfig { normalisation, ..Default::default() };
            for c in rated(raws.into_iter().map(|(a, q, o, c)| candidate(a, q, o, c)).collect(), &config) {
                for value in [c.information, c.quality, c.zones] {
                    prop_assert!((0.0..=1.0).contains(&value));
                }
                prop_assert!(c.utility.is_finite() && c.utility >= 0.0);
            }
        }
    }
}
