//! Alignment records as messages.

use mirador_core::geometry::rows_from_pose;
use mirador_core::slam6d::{AlignmentRecord, AlignmentStatus, Hypothesis, HypothesisName};
use mirador_ipc_schema::messages::{
    self, ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, Header,
};
use mirador_ipc_schema::{ScanId, text};
use nalgebra::Matrix6;

/// What the record does not know.
pub(crate) struct Facts {
    /// Header of the message.
    pub header: Header,
    /// Points of the reduced keyframe.
    pub keyframe_points: usize,
    /// Bytes the service keeps for it.
    pub keyframe_bytes: usize,
    /// Time the registration took [ns].
    pub align_ns: u64,
}

/// The meta part of an alignment message.
pub(crate) fn meta(record: &AlignmentRecord, facts: &Facts) -> AlignmentMeta {
    let (status, reason) = match &record.status {
        AlignmentStatus::First => (ALIGNMENT_FIRST, String::new()),
        AlignmentStatus::Aligned => (ALIGNMENT_ACCEPTED, String::new()),
        AlignmentStatus::NotAligned(rejection) => (ALIGNMENT_REJECTED, rejection.to_string()),
    };
    AlignmentMeta {
        header: facts.header,
        map_from_scanner: rows_from_pose(&record.map_from_scanner),
        covariance: rows_from_matrix(&record.covariance),
        prior: record.prior.as_ref().map_or([0.0; 16], rows_from_pose),
        overlap: record.overlap,
        residual_m: record.residual_m,
        prepare_ns: 0,
        align_ns: facts.align_ns,
        status,
        target_scan: record.target_id.map_or(u32::MAX, |id| ScanId::unpack(id).scan),
        iterations: record.iterations,
        constrained: record.constraint.as_ref().map_or(0, |c| u32::from(c.mask())),
        has_prior: u32::from(record.prior.is_some()),
        keyframe_points: facts.keyframe_points as u32,
        keyframe_bytes: facts.keyframe_bytes as u64,
        method: text::pack(&record.method),
        reason: text::pack(&reason),
    }
}

/// The hypotheses of a record.
pub(crate) fn hypothesis(hypothesis: &Hypothesis) -> messages::Hypothesis {
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

/// A message as bytes: its meta part, then its items.
pub(crate) fn to_bytes(meta: &AlignmentMeta, items: &[messages::Hypothesis]) -> Vec<u8> {
    [bytemuck::bytes_of(meta), bytemuck::cast_slice(items)].concat()
}

/// The message of [`to_bytes`]; `None` when these are not its bytes.
pub(crate) fn from_bytes(bytes: &[u8]) -> Option<(AlignmentMeta, Vec<messages::Hypothesis>)> {
    let (meta, items) = bytes.split_at_checked(size_of::<AlignmentMeta>())?;
    let (items, rest) = items.as_chunks::<{ size_of::<messages::Hypothesis>() }>();
    let items = items.iter().map(|item| bytemuck::pod_read_unaligned(item)).collect();
    rest.is_empty().then(|| (bytemuck::pod_read_unaligned(meta), items))
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_comes_back_from_its_bytes_and_from_no_others() {
        let meta = AlignmentMeta { overlap: 0.1 + 0.2, iterations: 7, ..AlignmentMeta::default() };
        let items = [messages::Hypothesis { residual_m: 1e-300, ..messages::Hypothesis::default() }; 2];
        let bytes = to_bytes(&meta, &items);
        assert_eq!(from_bytes(&bytes), Some((meta, items.to_vec())));
        assert_eq!(from_bytes(&to_bytes(&meta, &[])), Some((meta, Vec::new())));
        assert_eq!(from_bytes(&bytes[..bytes.len() - 1]), None);
        assert_eq!(from_bytes(&[]), None);
    }
}
