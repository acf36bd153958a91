//! The map as the aligner knows it: accepted scans with their poses and keyframes, and the pairs measured between them.

use std::collections::BTreeMap;

use super::journal::{CorrectionEntry, MeasuredPair, ScanEntry};
use super::keyframe::Keyframe;
use super::positions::Positions;
use super::uncertainty::Uncertainty;
use super::{MapRestoreError, PoseCorrection, SwitchedLoop};
use crate::geometry::{Covariance, Pose};
use crate::slam6d::pose_graph::{Edge, EdgeError, EdgeKind};

/// The standard deviation that stands for the covariance of a sequential pair that has none [m, rad].
const FALLBACK_SIGMA: f64 = 0.5;

/// The map as the aligner knows it. It changes only by [`Map::take_scan`] and [`Map::take_correction`].
#[derive(Default)]
pub(super) struct Map {
    /// Ids of the accepted scans, by node.
    pub scan_ids: Vec<u64>,
    /// Poses `map_from_scanner` of the accepted scans, by node.
    pub poses: Vec<Pose>,
    pub keyframes: Vec<Keyframe>,
    /// The measured motions.
    pub edges: Vec<Edge>,
    /// Covariances of the measured motions.
    pub edge_covariances: Vec<Covariance>,
    /// Whether each edge is switched off.
    pub is_off: Vec<bool>,
    /// The edges that lead to each node from earlier ones; the first is the sequential one.
    pub edges_to: Vec<Vec<usize>>,
    pub positions: Positions,
    pub uncertainty: Uncertainty,
    /// Scans that are no nodes (not accepted, or between two keyframes): they move along with the node before.
    pub followers: Vec<Follower>,
    pub keyframe_bytes: usize,
    node_of: BTreeMap<u64, usize>,
}

/// A scan that is no node.
pub(super) struct Follower {
    pub scan_id: u64,
    pub anchor: usize,
    pub anchor_from_scanner: Pose,
    pub covariance: Covariance,
}

impl Map {
    /// The node of a scan.
    pub fn node_of(&self, scan_id: u64) -> Option<usize> {
        self.node_of.get(&scan_id).copied()
    }

    /// Takes in a scan; an accepted one with its keyframe.
    ///
    /// # Errors
    /// [`MapRestoreError::Journal`] when the entry does not fit the map; that can only be one read from a file.
    pub fn take_scan(&mut self, entry: &ScanEntry, keyframe: Option<Keyframe>) -> Result<(), MapRestoreError> {
        let unfit = |reason: &str| MapRestoreError::Journal { scan_id: entry.scan_id, reason: reason.to_owned() };
        let target = match entry.target_id {
            Some(id) => Some(self.node_of(id).ok_or_else(|| unfit("its target is not in the map"))?),
            None => None,
        };
        if !entry.is_node {
            if let (Some(anchor), Some(anchor_from_scanner)) = (target, entry.target_from_scanner) {
                let (scan_id, covariance) = (entry.scan_id, entry.covariance);
                self.followers.push(Follower { scan_id, anchor, anchor_from_scanner, covariance });
            }
            return Ok(());
        }
        let keyframe = keyframe.ok_or_else(|| unfit("its keyframe is missing"))?;
        let node = self.poses.len();
        if node > 0 && (target.is_none() || entry.target_from_scanner.is_none()) {
            return Err(unfit("it has no target"));
        }
        self.scan_ids.push(entry.scan_id);
        self.poses.push(entry.map_from_scanner);
        self.keyframe_bytes += keyframe.bytes();
        self.keyframes.push(keyframe);
        self.edges_to.push(Vec::new());
        self.positions.push(entry.map_from_scanner.translation.vector);
        self.uncertainty.push(target, &entry.map_from_scanner, &entry.covariance);
        self.node_of.insert(entry.scan_id, node);
        if let (Some(target), Some(target_from_source)) = (target, entry.target_from_scanner) {
            self.add_sequential(target, node, target_from_source, entry.covariance)
                .map_err(|error| unfit(&error.to_string()))?;
        }
        Ok(())
    }

    /// The chain must not break, whatever the covariance.
    fn add_sequential(
        &mut self,
        from: usize,
        to: usize,
        motion: Pose,
        covariance: Covariance,
    ) -> Result<(), EdgeError> {
        let fallback = Covariance::identity() * FALLBACK_SIGMA.powi(2);
        let edge = Edge::with_covariance(from, to, motion, &covariance, EdgeKind::Sequential)
            .or_else(|_| Edge::with_covariance(from, to, motion, &fallback, EdgeKind::Sequential))?;
        self.push_edge(edge, covariance);
        Ok(())
    }

    fn push_edge(&mut self, edge: Edge, covariance: Covariance) {
        if let Some(edges) = self.edges_to.get_mut(edge.to) {
            edges.push(self.edges.len());
        }
        self.edges.push(edge);
        self.edge_covariances.push(covariance);
        self.is_off.push(false);
    }

    /// Adds the edge of a pair.
    ///
    /// # Errors
    /// [`EdgeError`] when it cannot be one; the map is as before.
    pub fn add_pair(&mut self, pair: &MeasuredPair) -> Result<(), EdgeError> {
        let nodes = self.poses.len();
        if let Some(node) = [pair.target, pair.source].into_iter().find(|node| *node >= nodes) {
            return Err(EdgeError::UnknownNode { node, nodes });
        }
        let kind = if pair.closes_loop { EdgeKind::LoopClosure } else { EdgeKind::Overlap };
        let edge = Edge::with_covariance(pair.target, pair.source, pair.target_from_source, &pair.covariance, kind)?;
        self.push_edge(edge, pair.covariance);
        Ok(())
    }

    /// Takes in what followed a scan, the pairs excepted. The corrections of all scans that moved, by id.
    pub fn take_correction(&mut self, entry: &CorrectionEntry, new_edges: usize) -> Vec<PoseCorrection> {
        for (edge, off) in &entry.switched {
            if let Some(is_off) = self.is_off.get_mut(*edge) {
                *is_off = *off;
            }
        }
        let mut moved = BTreeMap::new();
        for (node, after) in &entry.poses {
            if let Some(pose) = self.poses.get_mut(*node) {
                moved.insert(*node, std::mem::replace(pose, *after));
                self.positions.relocate(*node, after.translation.vector);
            }
        }
        for k in self.edges.len().saturating_sub(new_edges)..self.edges.len() {
            if !self.is_off[k] {
                let (from, to) = (self.edges[k].from, self.edges[k].to);
                self.uncertainty.improve(to, from, &self.poses[to], &self.edge_covariances[k]);
            }
        }
        self.corrections(&moved)
    }

    fn corrections(&self, moved: &BTreeMap<usize, Pose>) -> Vec<PoseCorrection> {
        let nodes = moved.iter().map(|(node, before)| {
            let after = self.poses[*node];
            let covariance = self.uncertainty.of(*node, &after);
            PoseCorrection { scan_id: self.scan_ids[*node], before: *before, after, covariance }
        });
        let followers = self.followers.iter().filter_map(|follower| {
            let before = moved.get(&follower.anchor)? * follower.anchor_from_scanner;
            let after = self.poses[follower.anchor] * follower.anchor_from_scanner;
            Some(PoseCorrection { scan_id: follower.scan_id, before, after, covariance: follower.covariance })
        });
        let mut corrections: Vec<PoseCorrection> = nodes.chain(followers).collect();
        corrections.sort_by_key(|correction| correction.scan_id);
        corrections
    }

    /// The loop closures that are switched off, by the ids of target and source.
    pub fn switched_off(&self) -> Vec<(u64, u64)> {
        let off = self.edges.iter().zip(&self.is_off).filter(|(_, off)| **off);
        off.map(|(edge, _)| (self.scan_ids[edge.from], self.scan_ids[edge.to])).collect()
    }

    /// Edges that changed their state, by the ids of target and source.
    pub fn switched(&self, edges: &[(usize, bool)]) -> Vec<SwitchedLoop> {
        let known = edges.iter().filter_map(|(edge, is_off)| Some((self.edges.get(*edge)?, *is_off)));
        known
            .map(|(edge, is_off)| {
                let (target_id, source_id) = (self.scan_ids[edge.from], self.scan_ids[edge.to]);
                SwitchedLoop { target_id, source_id, is_off }
            })
            .collect()
    }

    /// The memory held, the keyframes included [bytes].
    pub fn bytes(&self) -> usize {
        let node = size_of::<u64>() + size_of::<Pose>() + size_of::<Vec<usize>>() + 2 * size_of::<Covariance>();
        let edge = size_of::<Edge>() + size_of::<Covariance>() + size_of::<usize>();
        let followers = self.followers.len() * size_of::<Follower>();
        self.keyframe_bytes + self.poses.len() * node + self.edges.len() * edge + followers
    }

    /// The pose of the last scan of all, if it is no node.
    pub fn last_follower(&self) -> Option<(u64, Pose)> {
        let follower = self.followers.last()?;
        Some((follower.scan_id, self.poses.get(follower.anchor)? * follower.anchor_from_scanner))
    }
}
