//! Plans and map tiles as messages.

use mirador_core::information_map::{InformationMap, Level, Tile};
use mirador_core::view_planning::{Candidate, Decision, Rejected, RejectionReason, StopReason, ViewPlan};
use mirador_ipc_schema::layout::Record;
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
    let is_weighed = matches!(plan.strategy.as_str(), "multi_criteria" | "random");
    if is_weighed && utility < plan.stop_threshold && plan.mean_quality.unwrap_or(0.0) >= plan.config.min_mean_quality {
        let threshold = plan.stop_threshold;
        let why = format!("under the threshold of {threshold:.4}, but ground is unexplored; utility {utility:.4}");
        return ("unexplored", why);
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

/// The candidates of a plan and the places that were rejected, as far as there is room.
pub(crate) fn write_candidates(plan: &ViewPlan, out: &mut [CandidateView]) {
    let (candidates, rejected) = out.split_at_mut(plan.candidates.len().min(out.len()));
    for (item, value) in candidates.iter_mut().zip(&plan.candidates) {
        *item = candidate(value);
    }
    for (item, place) in rejected.iter_mut().zip(&plan.rejected) {
        *item = self::rejected(place);
    }
}

/// A candidate that was valued.
fn candidate(candidate: &Candidate) -> CandidateView {
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
fn rejected(rejected: &Rejected) -> CandidateView {
    let (status, reason) = match rejected.reason {
        RejectionReason::OutsideArea => (1, "outside the work area"),
        RejectionReason::NearObstacle => (2, "an obstacle or a step is within the footprint"),
        RejectionReason::Unreachable => (3, "no path leads there"),
        RejectionReason::NearRobot => (4, "too near to where the robot stands"),
        RejectionReason::NearCandidate => (5, "too near to a candidate drawn earlier"),
        RejectionReason::SmallFrontier => (6, "too small a group of frontier cells"),
    };
    let [x, y] = rejected.position;
    CandidateView { position: [x, y, 0.0], status, reason: text::pack(reason), ..CandidateView::default() }
}

/// A tile of the map, as one message item for each of its levels.
pub(crate) fn write_levels(tile: &Tile, map: &InformationMap, out: &mut Vec<MapTile>) {
    let index = tile.index();
    let first = out.len();
    let unknown = MapCell { height: f32::NAN, ground: f32::NAN, clearance: f32::NAN, ..MapCell::default() };
    let blank = MapTile { tile_x: index.x, tile_y: index.y, level: 0, levels: 1, cells: [unknown; MAP_TILE_CELLS] };
    out.push(blank);
    for (cell_index, cell) in tile.known_cells() {
        let levels = cell.levels(map.config().clearance_m);
        for (k, level) in levels.as_slice().iter().enumerate() {
            if out.len() == first + k {
                out.push(MapTile { level: k as u32, ..blank });
            }
            let place = out.get_mut(first + k).and_then(|tile| tile.cells.get_mut(cell_index.within_tile()));
            if let Some(place) = place {
                *place = map_cell(level, map.config().obstacle_weight);
            }
        }
    }
    let levels = (out.len() - first) as u32;
    out.iter_mut().skip(first).for_each(|tile| tile.levels = levels);
}

fn map_cell(level: &Level, obstacle_weight: f64) -> MapCell {
    let evidence = &level.evidence;
    let metres = |value: Option<f64>| value.map_or(f32::NAN, |v| v as f32);
    let count = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
    MapCell {
        height: metres(evidence.height()),
        ground: metres(evidence.ground_height()),
        clearance: level.clearance as f32,
        navigability: quantise(evidence.navigability(obstacle_weight).unwrap_or(0.0)),
        quality: quantise(evidence.quality().unwrap_or(0.0)),
        navigable_mean: quantise(evidence.mean_navigable()),
        obstacle_mean: quantise(evidence.mean_obstacle()),
        measured: count(evidence.measured_count()),
        interpolated: count(evidence.interpolated_count()),
        flags: 1,
    }
}

/// C_nc at a place of a path: of the level whose ground is nearest to it, 0 where nothing is known.
pub(crate) fn navigability_at(map: &InformationMap, [x, y, z]: [f64; 3]) -> f64 {
    let Some(cell) = map.cell_containing(x, y).and_then(|index| map.cell(index)) else { return 0.0 };
    let levels = cell.levels(map.config().clearance_m);
    let away = |level: &&Level| (level.ground() - z).abs();
    let nearest = levels.as_slice().iter().min_by(|a, b| away(a).total_cmp(&away(b)));
    nearest.and_then(|level| level.evidence.navigability(map.config().obstacle_weight)).unwrap_or(0.0)
}

/// A message as bytes.
pub(crate) fn to_bytes<M: Record, I: Record>(meta: &M, items: &[I]) -> Vec<u8> {
    [bytemuck::bytes_of(meta), bytemuck::cast_slice(items)].concat()
}

/// The message of [`to_bytes`]; `None` when these are not its bytes.
pub(crate) fn from_bytes<M: Record, I: Record>(bytes: &[u8]) -> Option<(M, Vec<I>)> {
    let (meta, items) = bytes.split_at_checked(size_of::<M>())?;
    if !items.len().is_multiple_of(size_of::<I>()) {
        return None;
    }
    let items = items.chunks_exact(size_of::<I>()).map(bytemuck::pod_read_unaligned).collect();
    Some((bytemuck::pod_read_unaligned(meta), items))
}

fn quantise(value: f64) -> u16 {
    (value.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use mirador_core::analysis::PointScore;
    use mirador_core::geometry::Pose;
    use mirador_core::information_map::MapConfig;
    use mirador_core::scan::{Point, ScanView};

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

    #[test]
    fn a_tile_has_an_item_for_each_of_its_levels() {
        let points: Vec<_> = [(0.1, 0.0), (0.5, 0.0), (0.5, 3.0)].map(|(x, z)| Point::new(x, 0.1, z)).to_vec();
        let mut score = PointScore { flags: 3, navigable: 65535, quality: 32768, ..PointScore::NONE };
        score.set_normal(&nalgebra::Vector3::z());
        let mut map = InformationMap::new(MapConfig::default()).unwrap();
        map.insert(ScanView::unordered(&points), &[score; 3], &Pose::identity()).unwrap();
        let mut tiles = Vec::new();
        map.tiles().for_each(|tile| write_levels(tile, &map, &mut tiles));
        assert_eq!(tiles.iter().map(|t| (t.level, t.levels)).collect::<Vec<_>>(), [(0, 2), (1, 2)]);
        let (road, deck) = (&tiles[0].cells, &tiles[1].cells);
        assert_eq!((road[0].flags, road[1].flags, road[2].flags), (1, 1, 0));
        assert_eq!((deck[0].flags, deck[1].flags), (0, 1));
        assert_eq!((road[1].ground, deck[1].ground, road[1].clearance), (0.0, 3.0, 3.0));
        assert_eq!(deck[1].clearance, f32::INFINITY);
        assert!(road[2].ground.is_nan());
        assert_eq!(road[0].navigability, 65535);
        assert_eq!(map.known_cells().count(), 2);
        assert!((navigability_at(&map, [0.5, 0.1, 2.9]) - 1.0).abs() < 1e-9);
        assert_eq!(navigability_at(&map, [5.0, 5.0, 0.0]), 0.0);
    }
}
