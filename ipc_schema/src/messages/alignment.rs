//! Poses found by registration, with the record of how.

use super::Header;
use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

/// The first scan: it defines the map.
pub const ALIGNMENT_FIRST: u32 = 0;
/// Aligned to an earlier scan.
pub const ALIGNMENT_ACCEPTED: u32 = 1;
/// Not aligned; the pose is the guess, and `reason` says why.
pub const ALIGNMENT_REJECTED: u32 = 2;

message! {
    /// The pose of a scan; the items are the hypotheses that were tried, in order.
    pub struct AlignmentMeta: "mirador/AlignmentMeta/3", size 1288 {
        /// Names the scan.
        pub header: Header,
        /// map_from_scanner, row-major 4x4.
        pub map_from_scanner: [f64; 16],
        /// 6x6 covariance, translation before rotation, perturbation on the right, in the scanner's frame, row-major: the
        /// errors of all pairs back to the first scan added up.
        pub covariance: [f64; 36],
        /// The same of the pose against `target_scan` alone: how well it is known within the map around it. All zero when it
        /// was not aligned.
        pub pair_covariance: [f64; 36],
        /// The prior map_from_scanner, row-major 4x4; only with `has_prior`.
        pub prior: [f64; 16],
        /// Share of the scan's points with a partner in the target, in [0, 1].
        pub overlap: f64,
        /// Root mean square of the final residuals [m].
        pub residual_m: f64,
        /// Time the preparation of the scan took [ns].
        pub prepare_ns: u64,
        /// Time the registration took [ns].
        pub align_ns: u64,
        /// One of the `ALIGNMENT_*` constants.
        pub status: u32,
        /// The scan it was aligned to; u32::MAX for none.
        pub target_scan: u32,
        /// Iterations of the accepted hypothesis.
        pub iterations: u32,
        /// Bit k is set when the geometry determines the pair's principal direction k, in the order of the Hessian's
        /// eigenvalues from the smallest to the largest.
        pub constrained: u32,
        /// 1 when there was a prior.
        pub has_prior: u32,
        /// Points of the reduced keyframe.
        pub keyframe_points: u32,
        /// Bytes of the reduced keyframe with its index.
        pub keyframe_bytes: u64,
        /// The scanner's motion during the scan, by which its points are to be deskewed: with `start_from_end = exp(m)`,
        /// a point seen at the fraction t of the scan is seen from its end at `exp(m)^(t - 1)` times it. Translation
        /// [m], then rotation vector [rad], in the moving scanner's frame; zero when the scanner stood, and when its
        /// points carry no times. `map_from_scanner` is the pose at the end of the scan then.
        pub scan_motion: [f64; 6],
        /// 1 when the scan is a node of the map from now on: accepted, and in continuous mode a keyframe.
        pub is_keyframe: u32,
        /// Not used.
        pub reserved: u32,
        /// Name of the registration method.
        pub method: [u8; 32],
        /// Why it was not aligned; empty when it was.
        pub reason: [u8; 256],
    }
}

message! {
    /// One hypothesis of an alignment.
    pub struct Hypothesis: "mirador/Hypothesis/1", size 480 {
        /// target_from_source at the start, row-major 4x4.
        pub start: [f64; 16],
        /// target_from_source that was found, row-major 4x4.
        pub found: [f64; 16],
        /// Share of the scan's points with a partner, in [0, 1].
        pub overlap: f64,
        /// Root mean square residual [m].
        pub residual_m: f64,
        /// Iterations.
        pub iterations: u32,
        /// 1 when accepted.
        pub accepted: u32,
        /// Where the start came from.
        pub origin: [u8; 40],
        /// Why it was not accepted; empty when it was.
        pub reason: [u8; 160],
    }
}

message! {
    /// A correction of an older scan's pose.
    pub struct PoseCorrection: "mirador/PoseCorrection/1", size 424 {
        /// Id of the scan, see `ScanId`.
        pub id: u64,
        /// The new map_from_scanner, row-major 4x4.
        pub map_from_scanner: [f64; 16],
        /// Its 6x6 covariance, as in [`AlignmentMeta`].
        pub covariance: [f64; 36],
    }
}

/// A pair was accepted.
pub const PAIR_ACCEPTED: u32 = 0;
/// A pair was tried and rejected; `reason` says why.
pub const PAIR_REJECTED: u32 = 1;
/// A loop accepted earlier is switched off from now on, since it contradicts the rest.
pub const PAIR_SWITCHED_OFF: u32 = 2;
/// A loop that was switched off counts again.
pub const PAIR_SWITCHED_ON: u32 = 3;
/// The scans overlap because they were taken shortly after one another.
pub const PAIR_OVERLAP: u32 = 0;
/// The robot was here before.
pub const PAIR_LOOP: u32 = 1;

message! {
    /// What alignment did about older scans after this one; the items are the pairs that were tried, in order, then the
    /// loops that were switched. Sent once for every scan, after the `pose_corrections` that come of it, if any.
    pub struct LoopClosingMeta: "mirador/LoopClosingMeta/1", size 128 {
        /// Names the scan.
        pub header: Header,
        /// Weighted squared error of the pairs before the poses were solved for.
        pub chi2_before: f64,
        /// And after.
        pub chi2_after: f64,
        /// Memory of all keyframes [bytes].
        pub keyframe_bytes: u64,
        /// Time the whole took [ns].
        pub correction_ns: u64,
        /// The largest shift of a corrected pose [m].
        pub largest_shift_m: f64,
        /// The largest turn of a corrected pose [rad].
        pub largest_turn: f64,
        /// Earlier scans within reach that do not directly precede the scan.
        pub candidates: u32,
        /// Accepted scans so far.
        pub nodes: u32,
        /// Accepted pairs so far, the sequential ones included.
        pub edges: u32,
        /// Loops that are switched off.
        pub switched_off: u32,
        /// Scans whose poses were solved for; 0 when every new pair agreed with the poses as they are.
        pub free_nodes: u32,
        /// Linearisations.
        pub iterations: u32,
        /// Poses corrected: items of the `pose_corrections` of this scan.
        pub corrections: u32,
        /// 1 when the solution converged.
        pub converged: u32,
    }
}

message! {
    /// A pair of scans that was tried, or switched.
    pub struct ScanPair: "mirador/ScanPair/1", size 512 {
        /// Id of the earlier scan, see `ScanId`.
        pub target_id: u64,
        /// Id of the later scan.
        pub source_id: u64,
        /// target_from_source by the poses before, row-major 4x4.
        pub predicted: [f64; 16],
        /// target_from_source that was found, row-major 4x4.
        pub found: [f64; 16],
        /// Largest standard deviation of the predicted position [m].
        pub predicted_sigma_m: f64,
        /// Largest standard deviation of the predicted angles [rad].
        pub predicted_sigma_rotation: f64,
        /// Share of the source that the target should have seen, in [0, 1].
        pub predicted_overlap: f64,
        /// Share of the source's points with a partner, in [0, 1].
        pub overlap: f64,
        /// Root mean square residual [m].
        pub residual_m: f64,
        /// Distance of what was found from what was predicted [standard deviations].
        pub sigmas: f64,
        /// Iterations.
        pub iterations: u32,
        /// One of `PAIR_OVERLAP`, `PAIR_LOOP`.
        pub kind: u32,
        /// One of `PAIR_ACCEPTED`, `PAIR_REJECTED`, `PAIR_SWITCHED_OFF`, `PAIR_SWITCHED_ON`.
        pub status: u32,
        /// 1 when registration began at what coarse alignment had found.
        pub is_coarse: u32,
        /// Why it was not accepted; empty when it was.
        pub reason: [u8; 176],
    }
}

message! {
    /// Asks a foreign process to register two keyframes; the items are the target's points, then the source's.
    pub struct RegistrationRequestMeta: "mirador/RegistrationRequestMeta/1", size 232 {
        /// Names the source scan.
        pub header: Header,
        /// Id of the target scan; u64::MAX where nobody has said which it is.
        pub target_id: u64,
        /// target_from_source to start from, row-major 4x4.
        pub initial_target_from_source: [f64; 16],
        /// Pairs farther apart than this do not count [m].
        pub pair_distance_m: f64,
        /// The result may not move farther than this from the start [m].
        pub max_translation_m: f64,
        /// The result may not turn farther than this from the start [rad].
        pub max_rotation: f64,
        /// Number of points of the target, the first items.
        pub target_points: u32,
        /// Number of points of the source, the items behind them.
        pub source_points: u32,
        /// Most iterations.
        pub max_iterations: u32,
        /// The answer is worthless after this time [ms].
        pub timeout_ms: u32,
        /// Numbers the requests; the result repeats it.
        pub request: u64,
    }
}

message! {
    /// One point of a reduced keyframe with its normal, in its scanner's frame.
    pub struct KeyframePoint: "mirador/KeyframePoint/1", size 32 {
        /// Position [m]; the fourth value is 1, so that the item is a homogeneous point.
        pub position: [f32; 4],
        /// Unit normal; the fourth value is 0.
        pub normal: [f32; 4],
    }
}

message! {
    /// The answer to a registration request.
    pub struct RegistrationResult: "mirador/RegistrationResult/2", size 456 {
        /// The request this answers.
        pub request: u64,
        /// target_from_source, row-major 4x4.
        pub target_from_source: [f64; 16],
        /// Its 6x6 covariance, as in [`AlignmentMeta`].
        pub covariance: [f64; 36],
        /// Share of the source's points with a partner, in [0, 1].
        pub overlap: f64,
        /// Root mean square residual [m].
        pub residual_m: f64,
        /// Iterations.
        pub iterations: u32,
        /// 1 when converged.
        pub converged: u32,
        /// As in [`AlignmentMeta`]. Only reported: alignment finds out by itself.
        pub constrained: u32,
        /// The schema that the answering process was built with: the lower halves of the schema hashes of
        /// `registration_request` and `registration_result`, combined by exclusive or.
        pub schema: u32,
    }
}

/// Nobody answers: the process is not there, or has ended.
pub const REGISTRATION_ABSENT: usize = 0;
/// The process ended while it was asked.
pub const REGISTRATION_DIED: usize = 1;
/// No answer came in time.
pub const REGISTRATION_LATE: usize = 2;
/// The answer was to an older request, or to one that was never made.
pub const REGISTRATION_OUTDATED: usize = 3;
/// The pose or what goes with it holds a value that is not finite.
pub const REGISTRATION_NOT_FINITE: usize = 4;
/// The pose is not a rigid motion.
pub const REGISTRATION_NOT_RIGID: usize = 5;
/// The covariance is not symmetric and positive definite.
pub const REGISTRATION_COVARIANCE: usize = 6;
/// The pose lies outside the limits of the request.
pub const REGISTRATION_OUTSIDE: usize = 7;
/// The scans fit worse at the pose than at the start, or the built-in method found what the answer had missed.
pub const REGISTRATION_WRONG: usize = 8;
/// Far more answers came than were asked for.
pub const REGISTRATION_FLOOD: usize = 9;
/// The answer was made by another version of the messages.
pub const REGISTRATION_SCHEMA: usize = 10;
/// The request could not be sent.
pub const REGISTRATION_NOT_SENT: usize = 11;
/// It was not asked, since it had failed several times in a row.
pub const REGISTRATION_PAUSED: usize = 12;

message! {
    /// How a foreign registration is doing, over the whole run.
    pub struct RegistrationStatus: "mirador/RegistrationStatus/1", size 440 {
        /// Name of the built-in method that takes its place.
        pub fallback: [u8; 32],
        /// Alignments that were to be made.
        pub questions: u64,
        /// Of these, those by an answer.
        pub answered: u64,
        /// Of these, those by the built-in method.
        pub fallbacks: u64,
        /// Of those by the built-in method, how many for which reason; the places are the `REGISTRATION_*` constants.
        pub faults: [u64; 13],
        /// From request to answer, the last one [ns].
        pub last_answer_ns: u64,
        /// From request to answer, all together [ns].
        pub total_answer_ns: u64,
        /// From request to answer, the longest [ns].
        pub max_answer_ns: u64,
        /// The last fault in words; empty while there was none.
        pub last_fault: [u8; 256],
    }
}
