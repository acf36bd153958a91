//! Each scan is aligned to the last one that was accepted.

use std::sync::Arc;

use nalgebra::{Matrix6, Translation3};

use super::attempt::Attempt;
use super::farther::Farthest;
use super::older_scans::{NoOlderScans, OlderScans};
use super::prior::{Prior, PriorFrame};
use super::slid::Slid;
use super::verifier::Verifier;
use super::{
    AlignerState, AlignmentRecord, AlignmentStatus, HypothesisName, Rejection, RestoreError, SequentialConfig,
    TargetState,
};
use crate::geometry::{Covariance, Pose};
use crate::registration::coarse::CoarseConfig;
use crate::registration::{ConfigError, PrepareError, PreparedScan, Registration};
use crate::scan::ScanView;

/// An older scan nearer than this share of the last one's distance is a better target, where the prior can be relied on.
const NEARER: f64 = 0.5;

/// Aligns scan after scan. It holds one keyframe, that of the last accepted scan; its memory does not grow.
pub struct SequentialAligner {
    pub(super) registration: Box<dyn Registration>,
    pub(super) config: SequentialConfig,
    state: AlignerState,
    target: Option<Arc<dyn PreparedScan>>,
    pub(super) verifier: Verifier,
    /// Of the scan that is being aligned.
    pub(super) prior: Option<Prior>,
    pub(super) farthest: Option<Farthest>,
    pub(super) slid: Slid,
}

impl SequentialAligner {
    /// An aligner without a map; the first scan defines it. `spacing_m` is how far the reduced points of a scan lie
    /// apart: the voxel of its preparation.
    ///
    /// # Errors
    /// The first field of the settings out of range.
    pub fn new(
        registration: Box<dyn Registration>,
        config: SequentialConfig,
        spacing_m: f64,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        let verifier = Verifier::new(CoarseConfig::default(), spacing_m)?;
        Ok(Self {
            registration,
            config,
            state: AlignerState::default(),
            target: None,
            verifier,
            prior: None,
            farthest: None,
            slid: Slid::default(),
        })
    }

    /// With other settings of the second look at alignments that overlap little.
    pub(super) fn weigh_with(&mut self, config: CoarseConfig, spacing_m: f64) -> Result<(), ConfigError> {
        self.verifier = Verifier::new(config, spacing_m)?;
        Ok(())
    }

    /// An aligner that goes on from `state`. With the same method, settings and scan of the target as before, all
    /// later results are the same to the last bit.
    ///
    /// # Errors
    /// [`RestoreError`].
    pub fn restore(
        registration: Box<dyn Registration>,
        config: SequentialConfig,
        spacing_m: f64,
        state: AlignerState,
        target_scan: Option<ScanView<'_>>,
    ) -> Result<Self, RestoreError> {
        let mut restored = Self::new(registration, config, spacing_m)?;
        let target = match (&state.target, target_scan) {
            (None, _) => None,
            (Some(target), None) => return Err(RestoreError::TargetMissing { scan_id: target.scan_id }),
            (Some(target), Some(scan)) => {
                let scan_id = target.scan_id;
                let prepared =
                    restored.registration.prepare(scan).map_err(|error| RestoreError::Target { scan_id, error })?;
                let (points, expected) = (prepared.points().len() as u64, target.reduced_points);
                if points != expected {
                    return Err(RestoreError::OtherTarget { scan_id, points, expected });
                }
                Some(Arc::from(prepared))
            }
        };
        (restored.state, restored.target) = (state, target);
        Ok(restored)
    }

    /// What a restart needs, beside the scan named as the target in it.
    #[must_use]
    pub fn state(&self) -> &AlignerState {
        &self.state
    }

    /// The memory held: the keyframe and what is fixed [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.target.as_ref().map_or(0, |target| target.bytes()) + self.verifier.bytes() + size_of::<Self>()
    }

    /// The keyframe it holds, that of the last accepted scan.
    #[must_use]
    pub fn keyframe(&self) -> Option<&Arc<dyn PreparedScan>> {
        self.target.as_ref()
    }

    pub(super) fn config(&self) -> &SequentialConfig {
        &self.config
    }

    /// The method, for pairs other than the sequential one.
    pub(super) fn registration_mut(&mut self) -> &mut dyn Registration {
        &mut *self.registration
    }

    /// Moves the map under the aligner: the target's pose was corrected, and with it that of the last scan. The next
    /// scan is aligned relative to them; the last motion stays what was measured.
    pub(super) fn correct(&mut self, target: Pose, last: Pose) {
        if let Some(state) = &mut self.state.target {
            state.map_from_scanner = target;
        }
        self.state.last = Some(last);
    }

    /// The number of reduced points of the keyframe it holds; 0 before the first scan.
    #[must_use]
    pub fn keyframe_points(&self) -> usize {
        self.target.as_ref().map_or(0, |target| target.points().len())
    }

    /// Aligns the next scan. `prior` is `map_from_scanner` by odometry, in any fixed frame: only the motion between
    /// priors counts, except that the first scan is placed at its prior (at identity without one).
    ///
    /// A scan that cannot be aligned is flagged with the reason in the record. Its pose is the guess, it never becomes
    /// a target, and the next scan is aligned to the last accepted one.
    pub fn align_next(&mut self, scan_id: u64, scan: ScanView<'_>, prior: Option<Pose>) -> AlignmentRecord {
        let prepared = self.registration.prepare(scan);
        self.align_prepared(scan_id, prepared, prior.map(Prior::from))
    }

    /// As [`Self::align_next`], for a scan that was prepared already, by this method with these settings.
    pub fn align_prepared(
        &mut self,
        scan_id: u64,
        prepared: Result<Box<dyn PreparedScan>, PrepareError>,
        prior: Option<Prior>,
    ) -> AlignmentRecord {
        self.align_or_retry(scan_id, prepared, prior, &mut NoOlderScans)
    }

    /// As [`Self::align_prepared`]; a scan with a prior that does not fit the last accepted one is tried against older ones.
    pub(super) fn align_or_retry(
        &mut self,
        scan_id: u64,
        prepared: Result<Box<dyn PreparedScan>, PrepareError>,
        prior: Option<Prior>,
        older: &mut dyn OlderScans,
    ) -> AlignmentRecord {
        (self.prior, self.farthest) = (prior, None);
        self.slid.clear();
        let mut record = self.blank_record(scan_id);
        match prepared {
            Err(error) => record.status = AlignmentStatus::NotAligned(rejection_of(error)),
            Ok(prepared) => match (self.state.target, self.target.take()) {
                (Some(target), Some(target_scan)) => {
                    let last = (&target, &*target_scan);
                    let accepted = self.try_all(&mut record, last, older, &*prepared);
                    self.verifier.next(accepted);
                    self.target = Some(if accepted { Arc::from(prepared) } else { target_scan });
                }
                _ => {
                    record.status = AlignmentStatus::First;
                    record.covariance = Covariance::zeros();
                    self.target = Some(Arc::from(prepared));
                }
            },
        }
        self.remember(&record);
        record
    }

    /// Tries what there is to be tried, likeliest first, until a result is accepted.
    fn try_all(
        &mut self,
        record: &mut AlignmentRecord,
        last: (&TargetState, &dyn PreparedScan),
        older: &mut dyn OlderScans,
        source: &dyn PreparedScan,
    ) -> bool {
        let (name, guess) = (HypothesisName::OlderScan, record.map_from_scanner);
        let accepted = if self.is_nearer_to_others(record, last.0, older) {
            self.retry(record, name, &guess, older, source) || self.align(record, last, source)
        } else {
            self.align(record, last, source)
                || (self.guess_by_prior().is_some() && self.retry(record, name, &guess, older, source))
        };
        accepted
            || self.accept_held(record, last, older, source)
            || (self.is_sure() && self.go_farther(record, last, older, source))
            || self.accept_held(record, last, older, source)
    }

    /// The record of a scan of which only the guess is known.
    fn blank_record(&self, scan_id: u64) -> AlignmentRecord {
        let (metres, radians) = (self.config.guess_sigma_m.powi(2), self.config.guess_sigma_rotation.powi(2));
        AlignmentRecord {
            scan_id,
            target_id: self.state.target.map(|target| target.scan_id),
            method: self.registration.name().to_owned(),
            prior: self.prior.map(|prior| prior.map_from_scanner),
            hypotheses: Vec::new(),
            map_from_scanner: self.guess(),
            target_from_scanner: None,
            covariance: Matrix6::from_diagonal(&[metres, metres, metres, radians, radians, radians].into()),
            pair_covariance: None,
            overlap: 0.0,
            residual_m: 0.0,
            iterations: 0,
            constraint: None,
            status: AlignmentStatus::First,
        }
    }

    /// Where the scan should be: by its prior, else by constant motion; the first one where its prior says.
    fn guess(&self) -> Pose {
        if self.state.target.is_none() {
            return self.prior.map_or_else(Pose::identity, |prior| prior.map_from_scanner);
        }
        self.guess_by_prior().unwrap_or_else(|| self.constant_motion())
    }

    /// Where the prior has the scan in the map: there, or the target's pose and the motion by the priors since.
    pub(super) fn guess_by_prior(&self) -> Option<Pose> {
        let (target, prior) = (self.state.target?, self.prior?);
        match prior.frame {
            PriorFrame::Map => Some(prior.map_from_scanner),
            PriorFrame::Odometry => {
                Some(normalised(target.map_from_scanner * (target.prior?.inverse() * prior.map_from_scanner)))
            }
        }
    }

    /// The last scan's pose and its motion once more.
    fn constant_motion(&self) -> Pose {
        let last = self.state.last.unwrap_or_else(Pose::identity);
        normalised(last * self.state.last_motion.unwrap_or_else(Pose::identity))
    }

    /// The starts to try, likeliest first, with their pair distances.
    fn starts(&self, target: &TargetState) -> Vec<(HypothesisName, Pose, f64)> {
        let (near, wide) = (self.config.limits.pair_distance_m, self.config.wide_pair_distance_m);
        let constant = target.map_from_scanner.inverse() * self.constant_motion();
        let mut starts = Vec::with_capacity(5);
        let by_prior = self.guess_by_prior().map(|guess| target.map_from_scanner.inverse() * guess);
        if let Some(motion) = by_prior {
            starts.push((HypothesisName::PriorMotion, motion, near));
            starts.push((HypothesisName::PriorMotionWide, motion, wide));
        }
        if self.is_sure() && !starts.is_empty() {
            // Who knows how sure he is of where the scan was taken is not overruled by a habit: among things that look alike
            // that finds a place where the robot cannot be.
            return starts;
        }
        if let Some(motion) = by_prior {
            // Wheels that turn on the spot carry a prior away; how far the robot has turned it knows by other means.
            starts.push((
                HypothesisName::ZeroMotion,
                Pose::from_parts(Translation3::identity(), motion.rotation),
                near,
            ));
        }
        starts.push((HypothesisName::ConstantMotion, constant, near));
        starts.push((HypothesisName::ConstantMotionWide, constant, wide));
        starts
    }

    /// Tries one start after the other until a result is accepted, and completes the record.
    fn align(
        &mut self,
        record: &mut AlignmentRecord,
        (target, scan): (&TargetState, &dyn PreparedScan),
        source: &dyn PreparedScan,
    ) -> bool {
        for (name, start, pair_distance_m) in self.starts(target) {
            let attempt = Attempt { name, target, scan, start, pair_distance_m };
            if self.attempt(record, &attempt, source) {
                return true;
            }
        }
        let reason = record.hypotheses.first().and_then(|first| first.rejected.clone());
        let reason = reason.unwrap_or_else(|| Rejection::Failed { reason: "no hypothesis was tried".to_owned() });
        record.status = AlignmentStatus::NotAligned(reason);
        false
    }

    /// Whether an older scan lies much nearer to where the scan surely is than the last accepted one.
    fn is_nearer_to_others(&self, record: &AlignmentRecord, target: &TargetState, older: &mut dyn OlderScans) -> bool {
        let guess = record.map_from_scanner;
        let distance = (target.map_from_scanner.translation.vector - guess.translation.vector).norm();
        self.is_sure() && older.nearest_m(&guess) < NEARER * distance
    }

    /// Whether the prior says how well it is known.
    fn is_sure(&self) -> bool {
        self.prior.is_some_and(|prior| prior.covariance.is_some())
    }

    /// Tries older scans, one after the other, from where the scan is guessed to be. Without this a scan that shares too
    /// little with the last accepted one would be the end: all that follow are compared with that same one.
    pub(super) fn retry(
        &mut self,
        record: &mut AlignmentRecord,
        name: HypothesisName,
        guess: &Pose,
        older: &mut dyn OlderScans,
        source: &dyn PreparedScan,
    ) -> bool {
        let pair_distance_m = self.config.limits.pair_distance_m;
        for k in 0.. {
            let Some((target, scan)) = older.get(&*self.registration, guess, k) else { break };
            let start = target.map_from_scanner.inverse() * guess;
            let attempt = Attempt { name, target: &target, scan: &*scan, start, pair_distance_m };
            if self.attempt(record, &attempt, source) {
                return true;
            }
        }
        false
    }

    /// Makes the scan the last one, and the target if it was accepted.
    fn remember(&mut self, record: &AlignmentRecord) {
        let map_from_scanner = record.map_from_scanner;
        self.state.last_motion = self.state.last.map(|last| last.inverse() * map_from_scanner);
        self.state.last = Some(map_from_scanner);
        if record.is_accepted() {
            let (scan_id, prior, covariance) = (record.scan_id, record.prior, record.covariance);
            let reduced_points = self.target.as_ref().map_or(0, |target| target.points().len() as u64);
            self.state.target = Some(TargetState { scan_id, map_from_scanner, prior, reduced_points, covariance });
        }
    }
}

/// The pose with a quaternion of unit length again; products wear it off.
pub(super) fn normalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}

/// Why the scan itself is of no use.
fn rejection_of(error: PrepareError) -> Rejection {
    match error {
        PrepareError::TooFewPoints { points, required } => Rejection::TooFewPoints { points, required },
        PrepareError::NoPoints { .. } => Rejection::TooFewPoints { points: 0, required: 1 },
        PrepareError::Method { .. } => Rejection::Failed { reason: error.to_string() },
    }
}
