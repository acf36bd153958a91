//! What another front end than the sequential one needs of the map: to enter scans that it has aligned itself, and to
//! know what became of them.

use nalgebra::Vector3;

use super::aligner::GlobalAligner;
use super::keyframe::Keyframe;
use super::{CorrectionMethod, ScanEntry};
use crate::geometry::{Covariance, Pose};
use crate::registration::Registration;

impl GlobalAligner {
    /// Enters a scan that was aligned elsewhere; a node with its reduced points [m, scanner frame]. Its correction is
    /// due then. Without correction of older scans nothing is entered.
    pub fn enter(&mut self, entry: ScanEntry, points: Option<&[[f32; 3]]>) {
        if self.config.method != CorrectionMethod::Off {
            self.enter_keyframe(entry, points.map(Keyframe::new));
        }
    }

    /// The pose of a node as known now, `map_from_scanner`.
    #[must_use]
    pub fn pose_of(&self, scan_id: u64) -> Option<Pose> {
        self.map.node_of(scan_id).map(|node| self.map.poses[node])
    }

    /// An upper bound of the covariance of that pose.
    #[must_use]
    pub fn covariance_of(&self, scan_id: u64) -> Option<Covariance> {
        self.map.node_of(scan_id).map(|node| self.map.uncertainty.of(node, &self.map.poses[node]))
    }

    /// The points of a node's keyframe [m, scanner frame].
    #[must_use]
    pub fn points_of(&self, scan_id: u64) -> Option<Vec<[f32; 3]>> {
        self.map.node_of(scan_id).map(|node| self.map.keyframes[node].points())
    }

    /// The number of points of the newest node's keyframe; 0 before the first.
    #[must_use]
    pub fn newest_points(&self) -> usize {
        self.map.keyframes.last().map_or(0, Keyframe::len)
    }

    /// All nodes, those nearest to a place in the map first.
    #[must_use]
    pub fn nodes_by_distance(&self, place: &Vector3<f64>) -> Vec<u64> {
        let distance = |node: &usize| (self.map.poses[*node].translation.vector - place).norm_squared();
        let mut nodes: Vec<usize> = (0..self.map.poses.len()).collect();
        nodes.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
        nodes.into_iter().map(|node| self.map.scan_ids[node]).collect()
    }

    /// The method, for pairs that are looked for elsewhere.
    pub(in crate::slam6d) fn registration_mut(&mut self) -> &mut dyn Registration {
        self.sequential.registration_mut()
    }
}
