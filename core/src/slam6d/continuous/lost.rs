//! The way back of a scanner that is lost.

use super::aligner::ContinuousAligner;
use super::record::{normalised, symmetric};
use super::state::Anchor;
use crate::geometry::{Pose, adjoint};
use crate::odometry::{FrameRecord, FrameTime, Odometry};
use crate::registration::{Alignment, PairIds};
use crate::scan::ScanView;
use crate::slam6d::{Hypothesis, HypothesisName, Rejection};

/// Of the keyframes so many are compared with lost frames, a few at a time and then again from the first.
const MOST_ALIKE: usize = 12;

impl ContinuousAligner {
    /// Looks for a lost frame among the keyframes. Where it is found the local map is made anew of those around, in the
    /// map's frame; the frame as it fits there.
    pub(super) fn relocalise(
        &mut self,
        (scan_id, scan): (u64, ScanView<'_>),
        time: Option<FrameTime>,
        lost: &FrameRecord,
        tried: &mut Vec<Hypothesis>,
    ) -> Option<FrameRecord> {
        let config = self.config.relocalisation.clone();
        if self.state.lost_frames < config.after_frames || config.keyframes_per_frame == 0 {
            return None;
        }
        let anchor = self.state.anchor?;
        let place = (self.anchor_pose(&anchor) * self.seen_from_anchor(&lost.map_from_scanner)).translation.vector;
        let source = self.relocaliser.see(self.global.registration_mut(), scan).ok()?;
        let points = self.selector.thin(source.points());
        let mut nodes = self.relocaliser.most_alike(&points, &self.global);
        nodes.truncate(MOST_ALIKE);
        for _ in 0..config.keyframes_per_frame.min(nodes.len()) {
            let node = *nodes.get(self.state.keyframes_tried % nodes.len())?;
            self.state.keyframes_tried += 1;
            let (points, map_from_node) = (self.global.points_of(node)?, self.global.pose_of(node)?);
            let distance_m = (map_from_node.translation.vector - place).norm();
            let registration = self.global.registration_mut();
            let Ok(target) = self.relocaliser.see_points(registration, &points) else { continue };
            registration.name_pair(PairIds { target: Some(node), source: Some(scan_id) });
            let found = self.relocaliser.locate(registration, &target, &source);
            let fits = match found.trusted() {
                Some(alignment) => self.begin_anew(scan, time, node, &map_from_node, alignment),
                None => None,
            };
            let reason = match (&fits, &found.verdict.doubt) {
                (Some(_), _) => None,
                (None, Some(doubt)) => Some(doubt.to_string()),
                (None, None) => Some("the frame does not fit the keyframes around".to_owned()),
            };
            tried
                .push(attempt(&found.alignment, reason.map(|reason| Rejection::NotRelocalised { distance_m, reason })));
            if fits.is_some() {
                return fits;
            }
        }
        None
    }

    /// Makes the local map anew of the keyframes around a place found; `None`, and all as before, when the frame does
    /// not fit them.
    fn begin_anew(
        &mut self,
        scan: ScanView<'_>,
        time: Option<FrameTime>,
        node: u64,
        map_from_node: &Pose,
        alignment: &Alignment,
    ) -> Option<FrameRecord> {
        let map_from_scanner = normalised(map_from_node * alignment.target_from_source);
        let around = self.global.nodes_by_distance(&map_from_scanner.translation.vector);
        let around = around.into_iter().take(self.config.relocalisation.map_keyframes);
        let known: Vec<(Pose, Vec<[f32; 3]>)> =
            around.filter_map(|id| Some((self.global.pose_of(id)?, self.global.points_of(id)?))).collect();
        let before = self.odometry.to_bytes();
        self.odometry.restart(&map_from_scanner, known.iter().map(|(pose, points)| (pose, &points[..])));
        let frame = self.odometry.register_frame(scan, time, Some(map_from_scanner));
        if !frame.status.is_tracked() {
            // Bytes of the same settings, written just now.
            if let Ok(odometry) = Odometry::from_bytes(self.config.odometry.clone(), &before) {
                self.odometry = odometry;
            }
            return None;
        }
        // The pair's covariance, which is on the right of the frame's pose, seen from the keyframe.
        let carried = adjoint(&alignment.target_from_source);
        self.state.anchor = Some(Anchor {
            scan_id: node,
            odometry_from_scanner: *map_from_node,
            covariance: symmetric(&(carried * alignment.covariance * carried.transpose())),
            map_from_scanner: *map_from_node,
        });
        self.selector.forget();
        self.is_snapshot_due = true;
        Some(frame)
    }
}

/// A keyframe that a lost frame was compared with; nothing is known of where it would be found.
fn attempt(found: &Option<Alignment>, rejected: Option<Rejection>) -> Hypothesis {
    Hypothesis {
        name: HypothesisName::Relocalisation,
        start: Pose::identity(),
        result: found.as_ref().map_or_else(Pose::identity, |alignment| alignment.target_from_source),
        overlap: found.as_ref().map_or(0.0, |alignment| alignment.overlap),
        residual_m: found.as_ref().map_or(0.0, |alignment| alignment.residual_rms_m),
        iterations: found.as_ref().map_or(0, |alignment| alignment.iterations),
        rejected,
    }
}
