//! What is said of a frame: the odometry's answer, seen from the last keyframe and in the map.

use super::aligner::ContinuousAligner;
use super::state::Anchor;
use crate::geometry::{Covariance, Pose, adjoint};
use crate::odometry::{FrameRecord, FrameStatus, Start};
use crate::slam6d::{AlignmentRecord, AlignmentStatus, Hypothesis, HypothesisName, Rejection};

/// The name under which poses of the odometry are reported.
const METHOD: &str = "odometry";

impl ContinuousAligner {
    /// Where the frame should be in the odometry's frame, if priors tell.
    pub(super) fn guess(&self, prior: Option<Pose>) -> Option<Pose> {
        match &self.state.last {
            None => prior,
            Some(last) => Some(normalised(last.odometry_from_scanner * (last.prior?.inverse() * prior?))),
        }
    }

    /// Where the last keyframe is in the map.
    pub(super) fn anchor_pose(&self, anchor: &Anchor) -> Pose {
        self.global.pose_of(anchor.scan_id).unwrap_or(anchor.map_from_scanner)
    }

    /// A pose of the odometry, seen from the last keyframe; as it is before the first.
    pub(super) fn seen_from_anchor(&self, odometry_from_scanner: &Pose) -> Pose {
        let anchor = self.state.anchor.as_ref();
        anchor.map_or(*odometry_from_scanner, |a| normalised(a.odometry_from_scanner.inverse() * odometry_from_scanner))
    }

    pub(super) fn hypothesis(&self, frame: &FrameRecord) -> Hypothesis {
        let name = match frame.start {
            Start::Guess => HypothesisName::PriorMotion,
            Start::ConstantVelocity => HypothesisName::ConstantMotion,
            Start::ZeroMotion => HypothesisName::ZeroMotion,
            Start::Search => HypothesisName::Search,
        };
        Hypothesis {
            name,
            start: self.seen_from_anchor(&frame.predicted),
            result: self.seen_from_anchor(&frame.map_from_scanner),
            overlap: frame.overlap,
            residual_m: frame.residual_rms_m,
            iterations: frame.iterations,
            rejected: self.rejection(frame),
        }
    }

    pub(super) fn rejection(&self, frame: &FrameRecord) -> Option<Rejection> {
        match frame.status {
            FrameStatus::Started | FrameStatus::Tracked | FrameStatus::UnderConstrained => None,
            FrameStatus::Lost => {
                let (score, required, searched) = (frame.score, frame.required_score, frame.searched);
                Some(Rejection::Lost { score, required, searched })
            }
            FrameStatus::TooFewPoints => {
                let (points, required) = (frame.points as usize, self.config.odometry.minimum_points);
                Some(Rejection::TooFewPoints { points, required })
            }
            FrameStatus::InvalidGuess => Some(Rejection::Failed { reason: "the predicted pose is not finite".into() }),
        }
    }

    pub(super) fn record(&self, scan_id: u64, frame: &FrameRecord, prior: Option<Pose>) -> AlignmentRecord {
        let anchor = self.state.anchor.as_ref();
        let relative = self.seen_from_anchor(&frame.map_from_scanner);
        let map_from_scanner = anchor.map_or(relative, |anchor| normalised(self.anchor_pose(anchor) * relative));
        let (pair, pose) = self.covariances(frame, &relative);
        let status = match (self.rejection(frame), anchor) {
            (Some(reason), _) => AlignmentStatus::NotAligned(reason),
            (None, Some(_)) => AlignmentStatus::Aligned,
            (None, None) => AlignmentStatus::First,
        };
        let is_tracked = frame.status.is_tracked();
        AlignmentRecord {
            scan_id,
            target_id: anchor.map(|anchor| anchor.scan_id),
            method: METHOD.to_owned(),
            prior,
            hypotheses: Vec::new(),
            map_from_scanner,
            target_from_scanner: None,
            covariance: if is_tracked { pose } else { pose + self.guess_covariance() },
            pair_covariance: anchor.filter(|_| is_tracked).map(|_| pair),
            overlap: if is_tracked { frame.overlap } else { 0.0 },
            residual_m: if is_tracked { frame.residual_rms_m } else { 0.0 },
            iterations: frame.iterations,
            constraint: is_tracked.then_some(frame.constraint),
            status,
        }
    }

    /// The covariance of the pose seen from the last keyframe (what the local map drifted between the two is not in
    /// it), and of the pose in the map.
    fn covariances(&self, frame: &FrameRecord, relative: &Pose) -> (Covariance, Covariance) {
        let Some(anchor) = &self.state.anchor else { return (Covariance::zeros(), Covariance::zeros()) };
        // A perturbation of the keyframe's pose seen from the frame: exp(x) T = T exp(Ad(T^-1) x).
        let carried = adjoint(&relative.inverse());
        let carry = |covariance: &Covariance| symmetric(&(carried * covariance * carried.transpose()));
        let pair = carry(&anchor.covariance) + frame.covariance;
        let map = self.global.covariance_of(anchor.scan_id).unwrap_or_else(Covariance::zeros);
        (pair, carry(&map) + pair)
    }

    fn guess_covariance(&self) -> Covariance {
        let (metres, radians) = (self.sequential.guess_sigma_m.powi(2), self.sequential.guess_sigma_rotation.powi(2));
        Covariance::from_diagonal(&[metres, metres, metres, radians, radians, radians].into())
    }
}

pub(super) fn normalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}

pub(super) fn symmetric(matrix: &Covariance) -> Covariance {
    0.5 * (matrix + matrix.transpose())
}
