//! Accepted scans that one which does not fit the last is tried against: those nearest to where it is guessed to be.

use std::sync::Arc;

use super::GlobalConfig;
use super::map::Map;
use super::pairs::Ready;
use crate::geometry::Pose;
use crate::registration::{PreparedScan, Registration};
use crate::slam6d::TargetState;

/// The nodes near a guess, looked up when the first is asked for.
pub(super) struct OlderNodes<'a> {
    pub map: &'a Map,
    pub ready: &'a mut Ready,
    pub config: &'a GlobalConfig,
    /// The scan it was tried against already.
    pub but: Option<u64>,
    pub nodes: Option<Vec<usize>>,
}

impl OlderNodes<'_> {
    /// The k-th nearest that can be prepared.
    pub fn get(
        &mut self,
        registration: &dyn Registration,
        map_from_scanner: &Pose,
        k: usize,
    ) -> Option<(TargetState, Arc<dyn PreparedScan>)> {
        let nodes = self.nodes.get_or_insert_with(|| nearest(self.map, self.config, self.but, map_from_scanner));
        let node = *nodes.get(k)?;
        // What was accepted once has points enough to be prepared again.
        let prepared = self.ready.get(node, &self.map.keyframes[node], registration).ok()?;
        let (scan_id, pose) = (self.map.scan_ids[node], self.map.poses[node]);
        let reduced_points = prepared.points().len() as u64;
        let covariance = self.map.uncertainty.of(node, &pose);
        Some((TargetState { scan_id, map_from_scanner: pose, prior: None, reduced_points, covariance }, prepared))
    }
}

fn nearest(map: &Map, config: &GlobalConfig, but: Option<u64>, map_from_scanner: &Pose) -> Vec<usize> {
    let place = map_from_scanner.translation.vector;
    let distance = |node: &usize| (map.poses[*node].translation.vector - place).norm_squared();
    let mut nodes = map.positions.within(&place, config.max_reach_m);
    nodes.retain(|node| Some(map.scan_ids[*node]) != but);
    nodes.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    nodes.truncate(config.retry_scans);
    nodes
}
