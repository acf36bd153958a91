//! Accepted scans that one which does not fit the last is tried against: those nearest to where it is guessed to be.

use super::GlobalConfig;
use super::map::Map;
use super::pairs::Ready;
use crate::geometry::Pose;
use crate::registration::Registration;
use crate::slam6d::TargetState;
use crate::slam6d::older_scans::{Accepted, OlderScans};

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
    fn near(&mut self, guess: &Pose) -> &[usize] {
        self.nodes.get_or_insert_with(|| nearest(self.map, self.config, self.but, guess))
    }

    fn accepted(&mut self, registration: &dyn Registration, node: usize) -> Option<Accepted> {
        // What was accepted once has points enough to be prepared again.
        let prepared = self.ready.get(node, &self.map.keyframes[node], registration).ok()?;
        let (scan_id, pose) = (self.map.scan_ids[node], self.map.poses[node]);
        let reduced_points = prepared.points().len() as u64;
        let covariance = self.map.uncertainty.of(node, &pose);
        Some((TargetState { scan_id, map_from_scanner: pose, prior: None, reduced_points, covariance }, prepared))
    }
}

impl OlderScans for OlderNodes<'_> {
    fn nearest_m(&mut self, guess: &Pose) -> f64 {
        let map = self.map;
        let nearest = self.near(guess).first().and_then(|node| map.poses.get(*node));
        nearest.map_or(f64::INFINITY, |pose| (pose.translation.vector - guess.translation.vector).norm())
    }

    fn by_id(&mut self, registration: &dyn Registration, scan_id: u64) -> Option<Accepted> {
        self.accepted(registration, self.map.node_of(scan_id)?)
    }

    fn get(&mut self, registration: &dyn Registration, guess: &Pose, k: usize) -> Option<Accepted> {
        let node = *self.near(guess).get(k)?;
        self.accepted(registration, node)
    }
}

fn nearest(map: &Map, config: &GlobalConfig, but: Option<u64>, map_from_scanner: &Pose) -> Vec<usize> {
    let mut nodes = by_distance(map, config, map_from_scanner);
    nodes.retain(|node| Some(map.scan_ids[*node]) != but);
    nodes.truncate(config.retry_scans);
    nodes
}

/// The nodes within reach of a pose, the nearest first.
fn by_distance(map: &Map, config: &GlobalConfig, map_from_scanner: &Pose) -> Vec<usize> {
    let place = map_from_scanner.translation.vector;
    let distance = |node: &usize| (map.poses[*node].translation.vector - place).norm_squared();
    let mut nodes = map.positions.within(&place, config.max_reach_m);
    nodes.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    nodes
}
