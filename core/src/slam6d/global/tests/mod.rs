//! Loops closed and older scans corrected: with a method that answers by script, and with real ones on synthetic scenes
//! and recorded sequences.

mod bent;
mod drifting;
mod loops;
mod older;
mod real_data;
mod restart;
mod scripted;

use super::*;
use crate::geometry::Pose;
use crate::registration::Registration;
use crate::scan::{Point, ScanView};
use crate::slam6d::{AlignmentRecord, SequentialConfig};

/// The spacing of the reduced points of the default method [m].
const SPACING_M: f64 = 0.25;

fn aligner(method: Box<dyn Registration>, config: &GlobalConfig) -> GlobalAligner {
    GlobalAligner::new(method, SequentialConfig::default(), config.clone(), SPACING_M).unwrap()
}

/// Aligns one scan and makes its correction, as a run in lockstep does.
fn step(
    aligner: &mut GlobalAligner,
    id: usize,
    scan: &[Point],
    prior: Option<Pose>,
) -> (AlignmentRecord, Option<CorrectionRecord>) {
    let record = aligner.align_next(id as u64, ScanView::unordered(scan), prior);
    (record, aligner.correct(&|| false))
}

fn poses(aligner: &GlobalAligner) -> Vec<Pose> {
    aligner.poses().map(|(_, pose)| *pose).collect()
}

fn largest_error(estimate: &[Pose], truth: &[Pose]) -> f64 {
    let truth_from_estimate = truth[0] * estimate[0].inverse();
    let errors = estimate.iter().zip(truth).map(|(e, t)| (truth_from_estimate * e).inverse() * t);
    errors.map(|error| error.translation.vector.norm()).fold(0.0, f64::max)
}
