//! From accepted pairs to corrected poses.

use super::map::Map;
use super::{GlobalConfig, Relaxation};
use crate::geometry::{Pose, rotation_angle};
use crate::slam6d::pose_graph::{Edge, EdgeKind, PoseGraph};

/// A loop whose squared Mahalanobis distance at the poses as known is below this tells nothing new: one in a hundred
/// true ones is above.
const NEWS_CHI2: f64 = 16.8;
/// When poses are corrected, all go along that are off by this share of the thresholds.
const ALONG: f64 = 0.1;

/// Poses that fit all pairs.
pub(super) struct Solved {
    pub relaxation: Relaxation,
    /// The nodes that moved, with their new poses.
    pub poses: Vec<(usize, Pose)>,
    /// The edges that are to be switched off (true) or to count again (false).
    pub switched: Vec<(usize, bool)>,
}

/// Solves the graph if the `new` last edges call for it: all of it when a loop tells something new, else the newest
/// scans, the others held fixed.
///
/// # Errors
/// The words of the solver.
pub(super) fn solve(map: &Map, new: usize, config: &GlobalConfig) -> Result<Option<Solved>, String> {
    let newest = map.edges.get(map.edges.len().saturating_sub(new)..).unwrap_or_default();
    if !newest.iter().any(|edge| is_beyond_threshold(&disagreement(map, edge), config, 1.0)) {
        return Ok(None);
    }
    let tells_news = |edge: &Edge| {
        let error = crate::geometry::log(&disagreement(map, edge));
        edge.kind == EdgeKind::LoopClosure && error.dot(&(edge.information * error)) > NEWS_CHI2
    };
    let first_free =
        if newest.iter().any(tells_news) { 1 } else { map.poses.len().saturating_sub(config.window_scans).max(1) };
    solve_from(map, first_free, config).map(Some)
}

/// How far the measurement is from the poses as known.
fn disagreement(map: &Map, edge: &Edge) -> Pose {
    edge.from_from_to.inverse() * (map.poses[edge.from].inverse() * map.poses[edge.to])
}

fn is_beyond_threshold(motion: &Pose, config: &GlobalConfig, share: f64) -> bool {
    motion.translation.vector.norm() > share * config.correction_threshold_m
        || rotation_angle(motion).to_degrees() > share * config.correction_threshold_deg
}

/// Solves for the poses from `first_free` on. The fixed ones become one node, the map itself: a pair with one of them
/// measures where in the map the other is.
pub(super) fn solve_from(map: &Map, first_free: usize, config: &GlobalConfig) -> Result<Solved, String> {
    let mut graph = PoseGraph::new(config.pose_graph).map_err(|e| e.to_string())?;
    graph.add_node(Pose::identity());
    for pose in &map.poses[first_free..] {
        graph.add_node(*pose);
    }
    let mut edge_of: Vec<usize> = Vec::new();
    for index in map.edges_to[first_free..].iter().flatten() {
        let edge = &map.edges[*index];
        let to = edge.to - first_free + 1;
        let shifted = match edge.from.checked_sub(first_free) {
            Some(from) => Edge { from: from + 1, to, ..edge.clone() },
            None => Edge { from: 0, to, from_from_to: map.poses[edge.from] * edge.from_from_to, ..edge.clone() },
        };
        graph.add_edge(shifted).map_err(|e| e.to_string())?;
        edge_of.push(*index);
    }
    let optimisation = graph.optimise().map_err(|e| e.to_string())?;
    let off: Vec<bool> = {
        let mut off = vec![false; edge_of.len()];
        optimisation.switched_off.iter().for_each(|k| off[*k] = true);
        off
    };
    let switched = edge_of.iter().zip(&off).filter(|(edge, off)| map.is_off[**edge] != **off);
    let relaxation = Relaxation {
        free_nodes: map.poses.len() - first_free,
        chi2_before: optimisation.chi2_before,
        chi2_after: optimisation.chi2,
        iterations: optimisation.iterations,
        converged: optimisation.converged,
    };
    Ok(Solved {
        relaxation,
        switched: switched.map(|(edge, off)| (*edge, *off)).collect(),
        poses: moved(map, first_free, graph.poses().get(1..).unwrap_or_default(), config),
    })
}

/// The poses that are to move: none while all are within the thresholds.
fn moved(map: &Map, first: usize, solved: &[Pose], config: &GlobalConfig) -> Vec<(usize, Pose)> {
    let known = || (first..).zip(solved).zip(&map.poses[first..]);
    let is_off = |((_, after), before): &((usize, &Pose), &Pose), share: f64| {
        is_beyond_threshold(&(before.inverse() * *after), config, share)
    };
    if !known().any(|pose| is_off(&pose, 1.0)) {
        return Vec::new();
    }
    known().filter(|pose| is_off(pose, ALONG)).map(|((node, after), _)| (node, *after)).collect()
}
