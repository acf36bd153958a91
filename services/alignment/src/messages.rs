//! Alignment records as messages.

use mirador_core::geometry::{Covariance, pose_from_rows, rotation_angle, rows_from_pose};
use mirador_core::slam6d::global::{self, CorrectionRecord, PairKind, PairRecord, PairStart};
use mirador_core::slam6d::{AlignmentStatus, Hypothesis, HypothesisName, Prior, PriorFrame};
use mirador_ipc_schema::layout::Record;
use mirador_ipc_schema::messages::{
    self, ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, Header, LoopClosingMeta,
    PAIR_ACCEPTED, PAIR_LOOP, PAIR_OVERLAP, PAIR_REJECTED, PAIR_SWITCHED_OFF, PAIR_SWITCHED_ON, POSE_FROM_LOCALIZATION,
    PoseCorrection, PoseEstimate, ScanPair,
};
use mirador_ipc_schema::{ScanId, text};
use nalgebra::Matrix6;

use crate::aligner::Aligned;

/// What the record does not know.
pub(crate) struct Facts {
    /// Header of the message.
    pub header: Header,
    /// Points of the reduced keyframe, and bytes the service keeps of it.
    pub keyframe: (usize, usize),
    /// Time the preparation of the scan took [ns].
    pub prepare_ns: u64,
    /// Time the registration took [ns].
    pub align_ns: u64,
}

/// The prior in a message; `None` when it is no rigid pose. A covariance that is not known, or not believed by who says it,
/// is left out.
pub(crate) fn prior(estimate: &PoseEstimate) -> Option<Prior> {
    let map_from_scanner = pose_from_rows(&estimate.map_from_scanner)?;
    let covariance = Covariance::from_row_slice(&estimate.covariance);
    let is_known = estimate.lost == 0 && covariance.cholesky().is_some();
    let frame = if estimate.source == POSE_FROM_LOCALIZATION { PriorFrame::Map } else { PriorFrame::Odometry };
    Some(Prior { map_from_scanner, frame, covariance: is_known.then_some(covariance) })
}

/// The meta part of an alignment message.
pub(crate) fn meta(aligned: &Aligned, facts: &Facts) -> AlignmentMeta {
    let record = &aligned.record;
    let (status, reason) = match &record.status {
        AlignmentStatus::First => (ALIGNMENT_FIRST, String::new()),
        AlignmentStatus::Aligned => (ALIGNMENT_ACCEPTED, String::new()),
        AlignmentStatus::NotAligned(rejection) => (ALIGNMENT_REJECTED, rejection.to_string()),
    };
    AlignmentMeta {
        header: facts.header,
        map_from_scanner: rows_from_pose(&record.map_from_scanner),
        covariance: rows_from_matrix(&record.covariance),
        pair_covariance: record.pair_covariance.as_ref().map_or([0.0; 36], rows_from_matrix),
        prior: record.prior.as_ref().map_or([0.0; 16], rows_from_pose),
        overlap: record.overlap,
        residual_m: record.residual_m,
        prepare_ns: facts.prepare_ns,
        align_ns: facts.align_ns,
        status,
        target_scan: record.target_id.map_or(u32::MAX, |id| ScanId::unpack(id).scan),
        iterations: record.iterations,
        constrained: record.constraint.as_ref().map_or(0, |c| u32::from(c.mask())),
        has_prior: u32::from(record.prior.is_some()),
        keyframe_points: facts.keyframe.0 as u32,
        keyframe_bytes: facts.keyframe.1 as u64,
        scan_motion: aligned.scan_motion.into(),
        is_keyframe: u32::from(aligned.is_keyframe),
        reserved: 0,
        method: text::pack(&record.method),
        reason: text::pack(&reason),
    }
}

/// The hypotheses of a record, at most `most`: of a scan that was tried at many places the first ones, and the last, which is the
/// one that was accepted if any was.
pub(crate) fn hypotheses(all: &[Hypothesis], most: usize) -> Vec<messages::Hypothesis> {
    let (before, last) = all.split_at(all.len().saturating_sub(1));
    before.iter().take(most.saturating_sub(1)).chain(last.iter().take(most)).map(hypothesis).collect()
}

fn hypothesis(hypothesis: &Hypothesis) -> messages::Hypothesis {
    messages::Hypothesis {
        start: rows_from_pose(&hypothesis.start),
        found: rows_from_pose(&hypothesis.result),
        overlap: hypothesis.overlap,
        residual_m: hypothesis.residual_m,
        iterations: hypothesis.iterations,
        accepted: u32::from(hypothesis.rejected.is_none()),
        origin: text::pack(word(hypothesis.name)),
        reason: text::pack(&hypothesis.rejected.as_ref().map_or_else(String::new, ToString::to_string)),
    }
}

/// The meta part of what was done about older scans; `None` is for a scan of which nothing can come.
pub(crate) fn loop_closing(record: Option<&CorrectionRecord>, header: Header, correction_ns: u64) -> LoopClosingMeta {
    let Some(record) = record else { return LoopClosingMeta { header, correction_ns, ..LoopClosingMeta::default() } };
    let moves = || record.corrections.iter().map(|c| c.before.inverse() * c.after);
    let relaxation = record.relaxation;
    LoopClosingMeta {
        header,
        chi2_before: relaxation.map_or(0.0, |r| r.chi2_before),
        chi2_after: relaxation.map_or(0.0, |r| r.chi2_after),
        keyframe_bytes: record.keyframe_bytes as u64,
        correction_ns,
        largest_shift_m: moves().map(|m| m.translation.vector.norm()).fold(0.0, f64::max),
        largest_turn: moves().map(|m| rotation_angle(&m)).fold(0.0, f64::max),
        candidates: record.candidates as u32,
        nodes: record.nodes as u32,
        edges: record.edges as u32,
        switched_off: record.switched_off.len() as u32,
        free_nodes: relaxation.map_or(0, |r| r.free_nodes as u32),
        iterations: relaxation.map_or(0, |r| r.iterations),
        corrections: record.corrections.len() as u32,
        converged: relaxation.map_or(0, |r| u32::from(r.converged)),
    }
}

/// The pairs of a record, then the loops that were switched.
pub(crate) fn pairs(record: &CorrectionRecord) -> Vec<ScanPair> {
    let switched = record.switched.iter().map(|loop_| ScanPair {
        target_id: loop_.target_id,
        source_id: loop_.source_id,
        kind: PAIR_LOOP,
        status: if loop_.is_off { PAIR_SWITCHED_OFF } else { PAIR_SWITCHED_ON },
        ..ScanPair::default()
    });
    record.pairs.iter().map(pair).chain(switched).collect()
}

fn pair(record: &PairRecord) -> ScanPair {
    ScanPair {
        target_id: record.target_id,
        source_id: record.source_id,
        predicted: rows_from_pose(&record.predicted),
        found: rows_from_pose(&record.found),
        predicted_sigma_m: record.predicted_sigma_m,
        predicted_sigma_rotation: record.predicted_sigma_rotation,
        predicted_overlap: record.predicted_overlap,
        overlap: record.overlap,
        residual_m: record.residual_m,
        sigmas: record.sigmas,
        iterations: record.iterations,
        kind: if record.kind == PairKind::Loop { PAIR_LOOP } else { PAIR_OVERLAP },
        status: if record.rejected.is_some() { PAIR_REJECTED } else { PAIR_ACCEPTED },
        is_coarse: u32::from(record.start == PairStart::Coarse),
        reason: text::pack(&record.rejected.as_ref().map_or_else(String::new, ToString::to_string)),
    }
}

/// A corrected pose.
pub(crate) fn correction(correction: &global::PoseCorrection) -> PoseCorrection {
    PoseCorrection {
        id: correction.scan_id,
        map_from_scanner: rows_from_pose(&correction.after),
        covariance: rows_from_matrix(&correction.covariance),
    }
}

/// A message as bytes: its meta part, then its items.
pub(crate) fn to_bytes<M: Record, I: Record>(meta: &M, items: &[I]) -> Vec<u8> {
    [bytemuck::bytes_of(meta), bytemuck::cast_slice(items)].concat()
}

/// The message of [`to_bytes`]; `None` when these are not its bytes.
pub(crate) fn from_bytes<M: Record, I: Record>(bytes: &[u8]) -> Option<(M, Vec<I>)> {
    let (meta, items) = bytes.split_at_checked(size_of::<M>())?;
    if !items.len().is_multiple_of(size_of::<I>()) {
        return None;
    }
    let items = items.chunks_exact(size_of::<I>()).map(bytemuck::pod_read_unaligned).collect();
    Some((bytemuck::pod_read_unaligned(meta), items))
}

fn rows_from_matrix(matrix: &Matrix6<f64>) -> [f64; 36] {
    std::array::from_fn(|i| matrix[(i / 6, i % 6)])
}

/// Where the start of a hypothesis came from, in words.
fn word(name: HypothesisName) -> &'static str {
    match name {
        HypothesisName::PriorMotion => "prior motion",
        HypothesisName::PriorMotionWide => "prior motion, wide gate",
        HypothesisName::ConstantMotion => "constant motion",
        HypothesisName::ConstantMotionWide => "constant motion, wide gate",
        HypothesisName::OlderScan => "prior, an older scan near it",
        HypothesisName::Held => "prior, along what the scans leave open",
        HypothesisName::Farther => "on from where another ended at its limits",
        HypothesisName::ZeroMotion => "no motion",
        HypothesisName::Search => "search around the last pose",
        HypothesisName::Relocalisation => "relocalisation at a keyframe",
    }
}

#[cfg(test)]
mod tests {
    use mirador_core::geometry::Pose;

    use super::*;

    #[test]
    fn of_many_hypotheses_the_first_and_the_last_are_told() {
        let tried = |k: u32| Hypothesis {
            name: HypothesisName::OlderScan,
            start: Pose::identity(),
            result: Pose::identity(),
            overlap: 0.5,
            residual_m: 0.01,
            iterations: k,
            rejected: None,
        };
        let told = |count: u32, most| {
            let all: Vec<_> = (0..count).map(tried).collect();
            hypotheses(&all, most).iter().map(|h| h.iterations).collect::<Vec<_>>()
        };
        assert_eq!((told(0, 4), told(3, 4), told(4, 4)), (vec![], vec![0, 1, 2], vec![0, 1, 2, 3]));
        assert_eq!((told(9, 4), told(9, 1)), (vec![0, 1, 2, 8], vec![8]));
    }

    #[test]
    fn a_message_comes_back_from_its_bytes_and_from_no_others() {
        let meta = AlignmentMeta { overlap: 0.1 + 0.2, iterations: 7, ..AlignmentMeta::default() };
        let items = [messages::Hypothesis { residual_m: 1e-300, ..messages::Hypothesis::default() }; 2];
        let bytes = to_bytes(&meta, &items);
        assert_eq!(from_bytes(&bytes), Some((meta, items.to_vec())));
        let none: [messages::Hypothesis; 0] = [];
        assert_eq!(from_bytes(&to_bytes(&meta, &none)), Some((meta, none.to_vec())));
        assert_eq!(from_bytes::<AlignmentMeta, messages::Hypothesis>(&bytes[..bytes.len() - 1]), None);
        assert_eq!(from_bytes::<AlignmentMeta, messages::Hypothesis>(&[]), None);
    }
}
