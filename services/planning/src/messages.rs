//! Plans and map tiles as messages.

use mirador_core::information_map::{CellState, InformationMap, Tile};
use mirador_core::view_planning::{Candidate, Decision, Rejected, RejectionReason, StopReason, ViewPlan};
use mirador_ipc_schema::messages::{
    CANDIDATE_OPEN, CandidateView, DECISION_GO, DECISION_STOP, MAP_TILE_CELLS, MapCell, MapTile, ViewPlanMeta,
};
use mirador_ipc_schema::text;

/// The decision part of a view plan; what the plan does not know is left for the caller.
pub(crate) fn plan_meta(plan: &ViewPlan) -> ViewPlanMeta {
    let weights = &plan.config.weights;
    let (decision, chosen, code, reason) = match plan.decision {
        Decision::Go { candidate } => {
            let (code, reason) = go_reason(plan, candidate);
            (DECISION_GO, candidate as u32, code, reason)
        }
        Decision::Stop { reason } => {
            let (code, words) = stop_reason(reason);
            (DECISION_STOP, u32::MAX, code, words.to_owned())
        }
    };
    ViewPlanMeta {
        map_revision: plan.map_revision,
        weights: [weights.information, weights.quality, weights.zones, weights.cost],
        utility_threshold: plan.stop_threshold,
        mean_quality: plan.mean_quality.unwrap_or(0.0),
        quality_asked: plan.config.min_mean_quality,
        cells_navigable: plan.navigable_cells as u32,
        decision,
        chosen,
        path_length_m: length(&plan.path),
        strategy: text::pack(&plan.strategy),
        reason_code: text::pack(code),
        reason: text::pack(&reason),
        ..ViewPlanMeta::default()
    }
}

/// Why this candidate: by its utility, as the first of a tour, or by the strategy's own choice.
fn go_reason(plan: &ViewPlan, candidate: usize) -> (&'static str, String) {
    let of = plan.candidates.len();
    let utility = plan.candidates.get(candidate).map_or(0.0, |c| c.utility);
    if !plan.tour.is_empty() {
        let reason = format!("the first of a tour of {} views out of {of} candidates", plan.tour.len());
        return ("first_of_tour", reason);
    }
    if plan.candidates.iter().all(|c| c.utility <= utility) {
        return ("best_utility", format!("the best of {of} candidates, utility {utility:.4}"));
    }
    ("chosen", format!("chosen by {} among {of} candidates, utility {utility:.4}", plan.strategy))
}

/// Length of a path [m].
pub(crate) fn length(path: &[[f64; 3]]) -> f64 {
    let distance =
        |a: &[f64; 3], b: &[f64; 3]| ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt();
    path.iter().zip(path.iter().skip(1)).map(|(a, b)| distance(a, b)).sum()
}

fn stop_reason(reason: StopReason) -> (&'static str, &'static str) {
    match reason {
        StopReason::Done => ("done", "no candidate is worth more than C_p and the asked quality is reached"),
        StopReason::NoNavigableGround => ("no_navigable_ground", "the map holds no ground that can be driven on"),
        StopReason::NothingReachable => ("nothing_reachable", "no path leads to any ground that can be driven on"),
        StopReason::NoCandidate => ("no_candidate", "every place on the reachable ground was rejected"),
        StopReason::NothingToGain => ("nothing_to_gain", "no candidate would show anything new or better"),
        StopReason::LocalisationLost => ("localisation_lost", "the robot's pose is not finite or not on the map"),
    }
}

/// A candidate that was valued.
pub(crate) fn candidate(candidate: &Candidate) -> CandidateView {
    CandidateView {
        position: candidate.position,
        heading: candidate.heading,
        information: candidate.information,
        quality: candidate.quality,
        zones: candidate.zones,
        cost: candidate.cost,
        utility: candidate.utility,
        unexplored_cells: candidate.raw.unexplored_cells,
        status: CANDIDATE_OPEN,
        reason: [0; 64],
    }
}

/// A place that was considered and rejected.
pub(crate) fn rejected(rejected: &Rejected) -> CandidateView {
    let (status, reason) = match rejected.reason {
        RejectionReason::OutsideArea => (1, "outside the work area"),
        RejectionReason::NearObstacle => (2, "an obstacle is within the footprint"),
        RejectionReason::Unreachable => (3, "no path leads there"),
        RejectionReason::NearRobot => (4, "too near to where the robot stands"),
        RejectionReason::NearCandidate => (5, "too near to a candidate drawn earlier"),
        RejectionReason::SmallFrontier => (6, "too small a group of frontier cells"),
    };
    let [x, y] = rejected.position;
    CandidateView { position: [x, y, 0.0], status, reason: text::pack(reason), ..CandidateView::default() }
}

/// A tile of the map, written in place.
pub(crate) fn write_tile(tile: &Tile, map: &InformationMap, out: &mut MapTile) {
    let index = tile.index();
    out.tile_x = index.x;
    out.tile_y = index.y;
    out.cells = [MapCell { height: f32::NAN, ..MapCell::default() }; MAP_TILE_CELLS];
    for (cell_index, cell) in tile.known_cells() {
        let CellState::Known(navigability) = cell.state(map.config().obstacle_weight) else { continue };
        let Some(place) = out.cells.get_mut(cell_index.within_tile()) else { continue };
        let count = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
        *place = MapCell {
            height: cell.height().map_or(f32::NAN, |h| h as f32),
            navigability: quantise(navigability),
            quality: quantise(cell.quality().unwrap_or(0.0)),
            navigable_mean: mean(cell.measured.navigable_sum + cell.interpolated.navigable_sum, cell.navigable_count()),
            obstacle_mean: mean(cell.measured.obstacle_sum + cell.interpolated.obstacle_sum, cell.obstacle_count()),
            measured: count(u64::from(cell.measured.count)),
            interpolated: count(u64::from(cell.interpolated.count)),
            flags: 1,
        };
    }
}

/// The mean of scores that are stored as value * 65535.
fn mean(sum: u64, count: u64) -> u16 {
    u16::try_from(sum / count.max(1)).unwrap_or(u16::MAX)
}

fn quantise(value: f64) -> u16 {
    (value.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_as_long_as_its_pieces() {
        assert_eq!(length(&[]), 0.0);
        assert_eq!(length(&[[0.0; 3], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]]), 7.0);
    }

    #[test]
    fn a_choice_names_its_reason() {
        use mirador_core::geometry::Pose;
        use mirador_core::information_map::MapConfig;
        use mirador_core::view_planning::{PlanningConfig, Situation, StrategyRegistry, Workspace};
        let map = InformationMap::new(MapConfig::default()).unwrap();
        let situation = Situation { map_from_robot: Pose::identity(), scan_number: 0, run_seed: 0, threads: 1 };
        let mut strategy = StrategyRegistry::default().create("random").unwrap();
        let mut plan = strategy.plan(&mut Workspace::new(), &map, &situation, &PlanningConfig::default());
        let of = |utility| Candidate { utility, ..Candidate::default() };
        plan.candidates = vec![of(0.5), of(0.7)];
        assert_eq!(go_reason(&plan, 1), ("best_utility", "the best of 2 candidates, utility 0.7000".into()));
        assert_eq!(go_reason(&plan, 0), ("chosen", "chosen by random among 2 candidates, utility 0.5000".into()));
        plan.tour = vec![0, 1];
        assert_eq!(go_reason(&plan, 0), ("first_of_tour", "the first of a tour of 2 views out of 2 candidates".into()));
    }

    #[test]
    fn a_stop_names_its_reason_in_code_and_words() {
        let (code, words) = stop_reason(StopReason::Done);
        assert_eq!(code, "done");
        assert!(words.len() <= 128);
    }
}
