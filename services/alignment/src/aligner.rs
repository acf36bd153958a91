//! The two ways to align: scan to scan where the robot stops, or frame by frame while it moves.

use mirador_core::geometry::Twist;
use mirador_core::odometry::FrameTime;
use mirador_core::registration::{PrepareError, PreparedScan};
use mirador_core::slam6d::continuous::ContinuousAligner;
use mirador_core::slam6d::global::{CorrectionRecord, GlobalAligner, Journalled};
use mirador_core::slam6d::{AlignmentRecord, Prior};
use mirador_ipc_schema::messages::ScanMeta;
use mirador_ipc_schema::{Received, topics};
use mirador_service_common::view;

/// What aligns the scans.
pub(crate) enum Aligner {
    /// Every scan to the last accepted one.
    Scan(Box<GlobalAligner>),
    /// Every scan to the odometry's local map.
    Continuous(Box<ContinuousAligner>),
}

/// What became of a scan.
pub(crate) struct Aligned {
    pub record: AlignmentRecord,
    /// The motion during the scan, zero when it was taken standing.
    pub scan_motion: Twist,
    /// It is a node of the map.
    pub is_keyframe: bool,
}

impl Aligner {
    /// Aligns a scan that was prepared already, if this way of aligning asks for that.
    pub fn align(
        &mut self,
        scan: &Received<topics::Scan>,
        prepared: Option<Result<Box<dyn PreparedScan>, PrepareError>>,
        prior: Option<Prior>,
    ) -> Aligned {
        let id = scan.header().id;
        let view = || view::scan(scan.meta(), scan.items());
        match self {
            Self::Scan(aligner) => {
                let prepared = prepared.unwrap_or_else(|| aligner.registration().prepare(view()));
                let record = aligner.align_prepared(id, prepared, prior);
                Aligned { is_keyframe: record.is_accepted(), record, scan_motion: Twist::zeros() }
            }
            Self::Continuous(aligner) => {
                let frame = aligner.align_next(id, view(), frame_time(scan.meta()), prior.map(|p| p.map_from_scanner));
                Aligned { record: frame.record, scan_motion: frame.scan_motion, is_keyframe: frame.is_keyframe }
            }
        }
    }

    pub fn is_correction_due(&self) -> bool {
        match self {
            Self::Scan(aligner) => aligner.is_correction_due(),
            Self::Continuous(aligner) => aligner.is_correction_due(),
        }
    }

    pub fn correct(&mut self, interrupted: &dyn Fn() -> bool) -> Option<CorrectionRecord> {
        match self {
            Self::Scan(aligner) => aligner.correct(interrupted),
            Self::Continuous(aligner) => aligner.correct(interrupted),
        }
    }

    pub fn take_journal(&mut self) -> Vec<Journalled> {
        match self {
            Self::Scan(aligner) => aligner.take_journal(),
            Self::Continuous(aligner) => aligner.take_journal(),
        }
    }

    /// Scans lost in a row; a scan that cannot be aligned where the robot stops is no more than that.
    pub fn lost_scans(&self) -> u32 {
        match self {
            Self::Scan(_) => 0,
            Self::Continuous(aligner) => aligner.lost_frames(),
        }
    }

    /// Points and bytes of the newest keyframe.
    pub fn keyframe(&self) -> (usize, usize) {
        match self {
            Self::Scan(aligner) => (aligner.keyframe_points(), aligner.keyframe_bytes()),
            Self::Continuous(aligner) => (aligner.map().newest_points(), aligner.map().keyframe_bytes()),
        }
    }
}

/// When a scan was taken: its stamp is that of its first beam. `None` when nobody knows how long it took: then it is one
/// of evenly spaced scans, each lasting until the next.
pub(crate) fn frame_time(meta: &ScanMeta) -> Option<FrameTime> {
    let duration_s = meta.duration_ns as f64 * 1e-9;
    (meta.duration_ns > 0).then_some(FrameTime { end_s: meta.header.stamp_ns as f64 * 1e-9 + duration_s, duration_s })
}
