//! Frame after frame: odometry, keyframes, the map, and the way back when lost.

use thiserror::Error;

use super::ContinuousConfig;
use super::relocalisation::Relocaliser;
use super::state::{Anchor, ContinuousState, FrameInput, LastFrame};
use crate::geometry::{Covariance, Pose, Twist};
use crate::odometry::{FrameRecord, FrameStatus, FrameTime, KeyframeSelector, Odometry, SnapshotError};
use crate::registration::{ConfigError, Registration};
use crate::scan::ScanView;
use crate::slam6d::global::{CorrectionRecord, GlobalAligner, GlobalConfig, Journalled, MapRestoreError, ScanEntry};
use crate::slam6d::{AlignerState, AlignmentRecord, SequentialConfig};

/// The odometry is written down every so many frames; a restart goes through at most so many again.
const FRAMES_A_SNAPSHOT: usize = 16;

/// What became of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ContinuousFrame {
    /// The decision record. The target is the last keyframe.
    pub record: AlignmentRecord,
    /// The motion during the scan, see [`FrameRecord::scan_motion`].
    pub scan_motion: Twist,
    /// It is a keyframe, and thus a node of the map.
    pub is_keyframe: bool,
}

/// Why an aligner could not be restored.
#[derive(Debug, Error)]
pub enum ContinuousRestoreError {
    /// The map could not be restored.
    #[error(transparent)]
    Map(#[from] MapRestoreError),
    /// The odometry could not be restored.
    #[error(transparent)]
    Odometry(#[from] SnapshotError),
    /// The settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Aligns the scans of a scanner in motion, and keeps the map of its keyframes consistent.
///
/// The same scans, times, priors and settings give the same bits, whatever the number of threads, as long as every
/// [`Self::align_next`] is followed by [`Self::correct`] until nothing is left to do.
pub struct ContinuousAligner {
    pub(super) config: ContinuousConfig,
    pub(super) sequential: SequentialConfig,
    pub(super) odometry: Odometry,
    pub(super) selector: KeyframeSelector,
    pub(super) global: GlobalAligner,
    pub(super) relocaliser: Relocaliser,
    pub(super) state: ContinuousState,
    /// What the frames since the last snapshot led to cannot be had again by going through them.
    pub(super) is_snapshot_due: bool,
}

impl ContinuousAligner {
    /// An aligner without a map; the first frame defines it. `registration` is for pairs of keyframes.
    ///
    /// # Errors
    /// The first field of the settings out of range.
    pub fn new(
        registration: Box<dyn Registration>,
        sequential: SequentialConfig,
        global: GlobalConfig,
        config: ContinuousConfig,
    ) -> Result<Self, ContinuousRestoreError> {
        Self::restore(registration, sequential, global, config, ContinuousState::default(), None, Vec::new())
    }

    /// An aligner that goes on from the state, the last snapshot and the journal of another. The frames of
    /// [`Self::frames_since_snapshot`] must then be gone through again ([`Self::repeat`]); with the same settings all
    /// later results are the same to the last bit.
    ///
    /// # Errors
    /// [`ContinuousRestoreError`].
    pub fn restore(
        registration: Box<dyn Registration>,
        sequential: SequentialConfig,
        global: GlobalConfig,
        config: ContinuousConfig,
        state: ContinuousState,
        snapshot: Option<&[u8]>,
        journal: Vec<Journalled>,
    ) -> Result<Self, ContinuousRestoreError> {
        config.validate()?;
        let spacing_m = config.keyframes.thinning_m;
        let relocaliser = Relocaliser::new(&config.relocalisation, global.coarse.clone(), spacing_m)?;
        let (odometry, selector) = match snapshot {
            None => (Odometry::new(config.odometry.clone())?, KeyframeSelector::new(config.keyframes.clone())?),
            Some(bytes) => from_snapshot(&config, bytes)?,
        };
        let empty = AlignerState::default();
        let global = GlobalAligner::restore(registration, sequential, global, spacing_m, empty, None, journal)?;
        Ok(Self { config, sequential, odometry, selector, global, relocaliser, state, is_snapshot_due: false })
    }

    /// Aligns the next frame. `prior` is `map_from_scanner` by other means, in any fixed frame: only the motion between
    /// priors counts, except that the first frame is placed at its prior (at identity without one).
    ///
    /// A frame that fits nowhere is flagged with the reason in the record; its pose is the prediction.
    pub fn align_next(
        &mut self,
        scan_id: u64,
        scan: ScanView<'_>,
        time: Option<FrameTime>,
        prior: Option<Pose>,
    ) -> ContinuousFrame {
        let guess = self.guess(prior);
        let input = FrameInput { scan_id, guess, was_lost: self.state.lost_frames > 0 };
        self.state.since_snapshot.push(input);
        let mut frame = self.register(&input, scan, time);
        let mut hypotheses = vec![self.hypothesis(&frame)];
        if frame.status == FrameStatus::Lost {
            self.state.lost_frames = self.state.lost_frames.saturating_add(1);
            if let Some(found) = self.relocalise((scan_id, scan), time, &frame, &mut hypotheses) {
                frame = found;
            }
        }
        let mut record = self.record(scan_id, &frame, prior);
        record.iterations = hypotheses.iter().map(|hypothesis| hypothesis.iterations).sum();
        record.hypotheses = hypotheses;
        let is_keyframe = self.enter(&record, &frame);
        if frame.status.is_tracked() {
            self.state.last = Some(LastFrame { odometry_from_scanner: frame.map_from_scanner, prior });
            (self.state.lost_frames, self.state.keyframes_tried) = (0, 0);
        }
        ContinuousFrame { record, scan_motion: frame.scan_motion, is_keyframe }
    }

    /// Goes through a frame again that came after the last snapshot, the oldest first.
    pub fn repeat(&mut self, input: &FrameInput, scan: ScanView<'_>, time: Option<FrameTime>) {
        let frame = self.register(input, scan, time);
        self.selector.consider(&frame, self.odometry.frame_points());
    }

    /// The search of the odometry is for a scanner that moved otherwise than predicted. One that has been lost may be
    /// anywhere: a place that merely looks alike must not be taken for it, so from then on only what is verified counts.
    fn register(&mut self, input: &FrameInput, scan: ScanView<'_>, time: Option<FrameTime>) -> FrameRecord {
        if input.was_lost && self.config.relocalisation.keyframes_per_frame > 0 {
            self.odometry.register_frame_nearby(scan, time, input.guess)
        } else {
            self.odometry.register_frame(scan, time, input.guess)
        }
    }

    /// The frames since the last snapshot.
    #[must_use]
    pub fn frames_since_snapshot(&self) -> &[FrameInput] {
        &self.state.since_snapshot
    }

    /// The odometry as bytes, now and then: they replace those of before, and belong to the state as it is now.
    pub fn take_snapshot(&mut self) -> Option<Vec<u8>> {
        if !self.is_snapshot_due && self.state.since_snapshot.len() < FRAMES_A_SNAPSHOT {
            return None;
        }
        self.is_snapshot_due = false;
        self.state.since_snapshot.clear();
        let selector = self.selector.to_text();
        let mut bytes = (selector.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(selector.as_bytes());
        bytes.extend_from_slice(&self.odometry.to_bytes());
        Some(bytes)
    }

    /// What a restart needs beside the journal and the snapshot.
    #[must_use]
    pub fn state(&self) -> &ContinuousState {
        &self.state
    }

    /// From now on [`Self::take_journal`] has what happened.
    pub fn keep_journal(&mut self) {
        self.global.keep_journal();
    }

    /// What changed the map since this was asked last, in order.
    pub fn take_journal(&mut self) -> Vec<Journalled> {
        self.global.take_journal()
    }

    /// Whether [`Self::correct`] has something to do.
    #[must_use]
    pub fn is_correction_due(&self) -> bool {
        self.global.is_correction_due()
    }

    /// Closes loops and corrects older poses, see [`GlobalAligner::correct`].
    pub fn correct(&mut self, interrupted: &dyn Fn() -> bool) -> Option<CorrectionRecord> {
        self.global.correct(interrupted)
    }

    /// Frames lost since the last one with a pose.
    #[must_use]
    pub fn lost_frames(&self) -> u32 {
        self.state.lost_frames
    }

    /// The map of the keyframes.
    #[must_use]
    pub fn map(&self) -> &GlobalAligner {
        &self.global
    }

    /// The memory held: local map, keyframes and those ready for registration [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.odometry.bytes() + self.global.bytes() + self.relocaliser.bytes()
    }

    /// Enters the frame in the map, as a node when it is a keyframe.
    fn enter(&mut self, record: &AlignmentRecord, frame: &FrameRecord) -> bool {
        let keyframe = self.selector.consider(frame, self.odometry.frame_points());
        let entry = ScanEntry {
            scan_id: record.scan_id,
            map_from_scanner: record.map_from_scanner,
            covariance: if keyframe.is_some() {
                record.pair_covariance.unwrap_or_else(Covariance::zeros)
            } else {
                record.covariance
            },
            is_node: keyframe.is_some(),
            target_id: record.target_id,
            target_from_scanner: record.target_id.map(|_| self.seen_from_anchor(&frame.map_from_scanner)),
        };
        self.global.enter(entry, keyframe.as_ref().map(|keyframe| &keyframe.points[..]));
        if keyframe.is_some() {
            self.state.anchor = Some(Anchor {
                scan_id: record.scan_id,
                odometry_from_scanner: frame.map_from_scanner,
                covariance: if record.target_id.is_some() { frame.covariance } else { Covariance::zeros() },
                map_from_scanner: record.map_from_scanner,
            });
        }
        keyframe.is_some()
    }
}

/// The odometry and the selector of [`ContinuousAligner::take_snapshot`].
fn from_snapshot(
    config: &ContinuousConfig,
    bytes: &[u8],
) -> Result<(Odometry, KeyframeSelector), ContinuousRestoreError> {
    let (length, rest) = bytes.split_first_chunk::<4>().ok_or(SnapshotError::Layout)?;
    let split = rest.split_at_checked(u32::from_le_bytes(*length) as usize);
    let (text, odometry) = split.ok_or(SnapshotError::Layout)?;
    let text = std::str::from_utf8(text).map_err(|_| SnapshotError::Layout)?;
    let selector = KeyframeSelector::from_text(config.keyframes.clone(), text)?.ok_or(SnapshotError::Layout)?;
    Ok((Odometry::from_bytes(config.odometry.clone(), odometry)?, selector))
}
