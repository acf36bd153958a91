//! The aligner: the sequential pair at once, everything about older scans later.

use std::collections::{BTreeSet, VecDeque};

use thiserror::Error;

use super::candidates::{Candidate, Known};
use super::journal::{CorrectionEntry, JournalEntry, MeasuredPair, ScanEntry};
use super::keyframe::{Keyframe, KeyframeError};
use super::map::Map;
use super::older::OlderNodes;
use super::pairs::{Measuring, Ready};
use super::record::{CorrectionRecord, PairRecord, PairRejection};
use super::verification::Verification;
use super::{CorrectionMethod, GlobalConfig, relax};
use crate::geometry::Pose;
use crate::registration::{ConfigError, PrepareError, PreparedScan, Registration};
use crate::scan::ScanView;
use crate::slam6d::{AlignerState, AlignmentRecord, Prior, RestoreError, SequentialAligner, SequentialConfig};

/// Scans that may wait for their correction; if more come while there is no time for it, the oldest go without.
const MOST_PENDING: usize = 16;

/// An entry of the journal, with the bytes of the keyframe that belongs to an accepted scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Journalled {
    /// What happened.
    pub entry: JournalEntry,
    /// The keyframe of an accepted scan.
    pub keyframe: Option<Vec<u8>>,
}

/// Why an aligner could not be restored.
#[derive(Debug, Error)]
pub enum MapRestoreError {
    /// The settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The sequential part could not be restored.
    #[error(transparent)]
    Sequential(#[from] RestoreError),
    /// A keyframe is damaged.
    #[error("the keyframe of scan {scan_id}: {error}")]
    Keyframe {
        /// The scan.
        scan_id: u64,
        /// What is wrong with it.
        #[source]
        error: KeyframeError,
    },
    /// The journal contradicts itself, or the state.
    #[error("the journal does not fit at scan {scan_id}: {reason}")]
    Journal {
        /// The scan.
        scan_id: u64,
        /// What does not fit.
        reason: String,
    },
}

/// Aligns scan after scan, and keeps the map of all of them consistent.
///
/// The same scans, priors and settings give the same bits, whatever the number of threads, as long as every
/// [`Self::align_next`] is followed by [`Self::correct`] until nothing is left to do.
pub struct GlobalAligner {
    pub(super) sequential: SequentialAligner,
    pub(super) config: GlobalConfig,
    sequential_config: SequentialConfig,
    pub(super) map: Map,
    ready: Ready,
    verification: Verification,
    /// Nodes whose correction is due.
    pending: VecDeque<usize>,
    work: Option<Work>,
    journal: Vec<Journalled>,
    is_journalling: bool,
}

/// A correction that was begun.
struct Work {
    node: usize,
    considered: usize,
    left: VecDeque<Candidate>,
    tried: Vec<PairRecord>,
    accepted: Vec<MeasuredPair>,
}

impl GlobalAligner {
    /// An aligner without a map; the first scan defines it. `spacing_m` is how far the reduced points of a scan lie
    /// apart: the voxel of its preparation.
    ///
    /// # Errors
    /// The first field of the settings out of range.
    pub fn new(
        registration: Box<dyn Registration>,
        sequential: SequentialConfig,
        config: GlobalConfig,
        spacing_m: f64,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        Self::with(SequentialAligner::new(registration, sequential, spacing_m)?, sequential, config, spacing_m)
    }

    fn with(
        mut aligner: SequentialAligner,
        sequential_config: SequentialConfig,
        config: GlobalConfig,
        spacing_m: f64,
    ) -> Result<Self, ConfigError> {
        aligner.weigh_with(config.coarse.clone(), spacing_m)?;
        Ok(Self {
            sequential: aligner,
            sequential_config,
            map: Map::default(),
            ready: Ready::new(config.prepared_keyframes),
            verification: Verification::new(&config, spacing_m)?,
            pending: VecDeque::new(),
            work: None,
            journal: Vec::new(),
            is_journalling: false,
            config,
        })
    }

    /// An aligner that goes on from the state and the journal of another. With the same method, settings and scan of
    /// the target as before, all later results are the same to the last bit.
    ///
    /// # Errors
    /// [`MapRestoreError`].
    pub fn restore(
        registration: Box<dyn Registration>,
        sequential: SequentialConfig,
        config: GlobalConfig,
        spacing_m: f64,
        state: AlignerState,
        target_scan: Option<ScanView<'_>>,
        journal: impl IntoIterator<Item = Journalled>,
    ) -> Result<Self, MapRestoreError> {
        config.validate()?;
        let aligner = SequentialAligner::restore(registration, sequential, spacing_m, state, target_scan)?;
        let mut restored = Self::with(aligner, sequential, config, spacing_m)?;
        let mut due = BTreeSet::new();
        for Journalled { entry, keyframe } in journal {
            match entry {
                JournalEntry::Scan(entry) => {
                    let scan_id = entry.scan_id;
                    let keyframe = keyframe.map(|bytes| Keyframe::from_bytes(&bytes)).transpose();
                    let keyframe = keyframe.map_err(|error| MapRestoreError::Keyframe { scan_id, error })?;
                    restored.map.take_scan(&entry, keyframe)?;
                    due.extend(restored.map.node_of(scan_id));
                }
                JournalEntry::Correction(entry) => {
                    restored.replay(&entry)?;
                    due.retain(|node| restored.map.scan_ids.get(*node) != Some(&entry.scan_id));
                }
            }
        }
        restored.pending = due.into_iter().collect();
        restored.limit_pending();
        Ok(restored)
    }

    fn replay(&mut self, entry: &CorrectionEntry) -> Result<(), MapRestoreError> {
        for pair in &entry.pairs {
            self.map
                .add_pair(pair)
                .map_err(|e| MapRestoreError::Journal { scan_id: entry.scan_id, reason: e.to_string() })?;
        }
        self.map.take_correction(entry, entry.pairs.len());
        Ok(())
    }

    /// From now on [`Self::take_journal`] has what happened.
    pub fn keep_journal(&mut self) {
        self.is_journalling = true;
    }

    /// What changed the map since this was asked last, in order.
    pub fn take_journal(&mut self) -> Vec<Journalled> {
        std::mem::take(&mut self.journal)
    }

    /// What a restart needs beside the journal and the scan named as the target in it.
    #[must_use]
    pub fn state(&self) -> &AlignerState {
        self.sequential.state()
    }

    /// The method, to prepare a scan for [`Self::align_prepared`].
    pub fn registration(&mut self) -> &dyn Registration {
        self.sequential.registration_mut()
    }

    /// The poses of the accepted scans as known now, by the order in which they came.
    pub fn poses(&self) -> impl Iterator<Item = (u64, &Pose)> {
        self.map.scan_ids.iter().copied().zip(&self.map.poses)
    }

    /// The memory held: the map, its keyframes and those ready for registration [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.sequential.bytes() + self.ready.bytes() + self.verification.bytes() + self.map.bytes()
    }

    /// The memory of the newest accepted scan's keyframe, as it is kept [bytes]; 0 before the first.
    #[must_use]
    pub fn keyframe_bytes(&self) -> usize {
        self.map.keyframes.last().map_or_else(|| self.sequential.bytes(), Keyframe::bytes)
    }

    /// The number of reduced points of the newest accepted scan; 0 before the first.
    #[must_use]
    pub fn keyframe_points(&self) -> usize {
        self.sequential.keyframe_points()
    }

    /// Aligns the next scan, see [`SequentialAligner::align_next`].
    pub fn align_next(&mut self, scan_id: u64, scan: ScanView<'_>, prior: Option<Pose>) -> AlignmentRecord {
        let prepared = self.sequential.registration_mut().prepare(scan);
        self.align_prepared(scan_id, prepared, prior.map(Prior::from))
    }

    /// As [`Self::align_next`], for a scan that was prepared already, by this method with these settings.
    pub fn align_prepared(
        &mut self,
        scan_id: u64,
        prepared: Result<Box<dyn PreparedScan>, PrepareError>,
        prior: Option<Prior>,
    ) -> AlignmentRecord {
        let Self { sequential, map, ready, config, .. } = self;
        let target = sequential.state().target.map(|target| target.scan_id);
        let mut older = OlderNodes { map, ready, config, but: target, nodes: None };
        let record = sequential.align_or_retry(scan_id, prepared, prior, &mut older);
        if self.config.method != CorrectionMethod::Off {
            self.remember(&record);
        }
        record
    }

    /// Whether [`Self::correct`] has something to do.
    #[must_use]
    pub fn is_correction_due(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Registers the oldest scan that waits for it with earlier ones, looks for loops, and corrects older poses; the
    /// next scan is aligned relative to the corrected ones. `None` when no scan waits, or when `interrupted`, which is
    /// asked before every registration, preparation and search, says so; then the next call goes on from there.
    pub fn correct(&mut self, interrupted: &dyn Fn() -> bool) -> Option<CorrectionRecord> {
        let node = *self.pending.front()?;
        let mut work = match self.work.take() {
            Some(work) if work.node == node => work,
            _ => self.begin(node),
        };
        while let Some(candidate) = work.left.pop_front() {
            if !self.try_pair(&mut work, &candidate, interrupted) {
                work.left.push_front(candidate);
                self.work = Some(work);
                return None;
            }
        }
        self.pending.pop_front();
        Some(self.finish(work))
    }

    fn begin(&self, node: usize) -> Work {
        let known = Known {
            config: &self.config,
            poses: &self.map.poses,
            keyframes: &self.map.keyframes,
            positions: &self.map.positions,
            uncertainty: &self.map.uncertainty,
        };
        let sequential = self.map.edges_to.get(node).and_then(|edges| edges.first());
        let aligned_to = sequential.and_then(|edge| self.map.edges.get(*edge)).map(|edge| edge.from);
        let (considered, candidates) = known.candidates(node, aligned_to);
        Work { node, considered, left: candidates.into(), tried: Vec::new(), accepted: Vec::new() }
    }

    /// Whether there was time for it.
    fn try_pair(&mut self, work: &mut Work, candidate: &Candidate, interrupted: &dyn Fn() -> bool) -> bool {
        let mut measuring = Measuring {
            config: &self.config,
            sequential: &self.sequential_config,
            keyframes: &self.map.keyframes,
            scan_ids: &self.map.scan_ids,
            registration: self.sequential.registration_mut(),
            ready: &mut self.ready,
            verification: &mut self.verification,
            map_from_source: self.map.poses[candidate.source],
            interrupted,
        };
        let Some((mut record, pair)) = measuring.measure(candidate) else { return false };
        if let Some(pair) = pair {
            match self.map.add_pair(&pair) {
                Ok(()) => work.accepted.push(pair),
                Err(error) => record.rejected = Some(PairRejection::Measurement { reason: error.to_string() }),
            }
        }
        work.tried.push(record);
        true
    }

    /// Solves for the poses with the pairs found.
    fn finish(&mut self, work: Work) -> CorrectionRecord {
        // A graph that cannot be solved leaves the poses as they were; the pairs stay for the next time.
        let (solved, unsolved) = match relax::solve(&self.map, work.accepted.len(), &self.config) {
            Ok(solved) => (solved, None),
            Err(reason) => (None, Some(reason)),
        };
        let (relaxation, poses, switched) =
            solved.map_or((None, Vec::new(), Vec::new()), |s| (Some(s.relaxation), s.poses, s.switched));
        let scan_id = self.map.scan_ids[work.node];
        let entry = CorrectionEntry { scan_id, pairs: work.accepted, switched, poses };
        let corrections = self.map.take_correction(&entry, entry.pairs.len());
        if !corrections.is_empty() {
            self.move_sequential();
        }
        let record = CorrectionRecord {
            scan_id,
            candidates: work.considered,
            pairs: work.tried,
            nodes: self.map.poses.len(),
            edges: self.map.edges.len(),
            switched_off: self.map.switched_off(),
            switched: self.map.switched(&entry.switched),
            relaxation,
            unsolved,
            corrections,
            keyframe_bytes: self.map.keyframe_bytes,
        };
        self.note(JournalEntry::Correction(entry), None);
        record
    }

    /// The next scan is aligned relative to the corrected poses.
    fn move_sequential(&mut self) {
        let Some(target) = &self.sequential.state().target else { return };
        let Some(pose) = self.map.node_of(target.scan_id).and_then(|node| self.map.poses.get(node)) else { return };
        let last = self.map.last_follower().filter(|(scan_id, _)| *scan_id > target.scan_id);
        self.sequential.correct(*pose, last.map_or(*pose, |(_, pose)| pose));
    }

    /// Enters a scan in the map.
    fn remember(&mut self, record: &AlignmentRecord) {
        let accepted = record.is_accepted();
        let target = record.target_id.and_then(|id| self.map.node_of(id)).map(|node| self.map.poses[node]);
        let entry = ScanEntry {
            scan_id: record.scan_id,
            map_from_scanner: record.map_from_scanner,
            covariance: record.pair_covariance.unwrap_or(record.covariance),
            is_node: accepted,
            target_id: record.target_id,
            target_from_scanner: record
                .target_from_scanner
                .or_else(|| Some(target?.inverse() * record.map_from_scanner)),
        };
        let keyframe = self.sequential.keyframe().filter(|_| accepted).map(|target| Keyframe::new(target.points()));
        self.enter_keyframe(entry, keyframe);
    }

    /// Enters a scan in the map; its correction is due when it is a node.
    pub(super) fn enter_keyframe(&mut self, entry: ScanEntry, keyframe: Option<Keyframe>) {
        let bytes = keyframe.as_ref().filter(|_| self.is_journalling).map(Keyframe::to_bytes);
        // An entry made from a record of the same map always fits it.
        if self.map.take_scan(&entry, keyframe).is_ok() {
            if entry.is_node {
                self.pending.extend(self.map.node_of(entry.scan_id));
                self.limit_pending();
            }
            self.note(JournalEntry::Scan(Box::new(entry)), bytes);
        }
    }

    fn limit_pending(&mut self) {
        while self.pending.len() > MOST_PENDING {
            self.pending.pop_front();
        }
    }

    fn note(&mut self, entry: JournalEntry, keyframe: Option<Vec<u8>>) {
        if self.is_journalling {
            self.journal.push(Journalled { entry, keyframe });
        }
    }
}
