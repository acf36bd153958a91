//! A restarted aligner goes on with the same bits, and so does one with other threads.

use std::sync::Arc;

use super::drifting::method;
use super::scripted::{Script, Scripted};
use super::*;
use crate::registration::test_scenes::{YARD, scan_of};
use crate::slam6d::AlignerState;
use nalgebra::Vector3;

/// To text and back, as a process writes it.
fn written<T: serde::Serialize + serde::de::DeserializeOwned>(value: &T) -> T {
    toml::from_str(&toml::to_string(value).unwrap()).unwrap()
}

type Outcome = (Vec<AlignmentRecord>, Vec<Option<CorrectionRecord>>, Vec<Pose>);

fn go_on(aligner: &mut GlobalAligner, scans: &[Vec<Point>], range: std::ops::Range<usize>) -> Outcome {
    let (mut records, mut corrections) = (Vec::new(), Vec::new());
    for k in range {
        let (record, correction) = step(aligner, k, &scans[k], None);
        records.push(record);
        corrections.push(correction);
    }
    (records, corrections, poses(aligner))
}

/// Stops after `at` scans, with the correction of the last done or not, and goes on in another aligner.
fn restarted(
    make: &dyn Fn() -> Box<dyn Registration>,
    config: &GlobalConfig,
    scans: &[Vec<Point>],
    at: usize,
    corrected: bool,
) -> (Outcome, Outcome) {
    let mut undisturbed = aligner(make(), config);
    go_on(&mut undisturbed, scans, 0..at);
    let expected = go_on(&mut undisturbed, scans, at..scans.len());
    let mut killed = aligner(make(), config);
    killed.keep_journal();
    go_on(&mut killed, scans, 0..at - 1);
    killed.align_next(at as u64 - 1, ScanView::unordered(&scans[at - 1]), None);
    if corrected {
        killed.correct(&|| false);
    }
    let journal: Vec<Journalled> = killed.take_journal();
    let journal = journal.into_iter().map(|j| Journalled { entry: written(&j.entry), keyframe: j.keyframe });
    let state: AlignerState = written(killed.state());
    let target = state.target.unwrap().scan_id as usize;
    let target = Some(ScanView::unordered(&scans[target]));
    let sequential = SequentialConfig::default();
    let mut restored =
        GlobalAligner::restore(make(), sequential, config.clone(), SPACING_M, state, target, journal).unwrap();
    assert_eq!(restored.is_correction_due(), !corrected);
    restored.correct(&|| false);
    (go_on(&mut restored, scans, at..scans.len()), expected)
}

#[test]
fn a_restored_aligner_goes_on_with_the_same_bits() {
    let script = Arc::new(Script::circle(70, 12.0, 1.15, 5));
    let scans: Vec<_> = (0..70).map(|k| script.scan(k)).collect();
    let config = GlobalConfig { verify_loops: false, basin_m: 20.0, basin_rotation: 1.5, ..GlobalConfig::default() };
    for method in [CorrectionMethod::PoseGraph, CorrectionMethod::Proportional] {
        let config = GlobalConfig { method, ..config.clone() };
        for at in [1, 2, 15, 63, 65] {
            for corrected in [false, true] {
                let make = || -> Box<dyn Registration> { Box::new(Scripted(Arc::clone(&script))) };
                let (found, expected) = restarted(&make, &config, &scans, at, corrected);
                assert!(found == expected, "after {at} scans, corrected: {corrected}");
            }
        }
    }
}

/// Around in the yard, so that the same places are seen again.
fn yard_scans() -> Vec<Vec<Point>> {
    let pose = |k: u32| {
        let angle = 0.45 * f64::from(k);
        Pose::new(Vector3::new(2.0 * angle.sin(), 2.0 - 2.0 * angle.cos(), 0.0), Vector3::z() * angle)
    };
    (0..18).map(|k| scan_of(&YARD, &pose(k), 25.0, u64::from(k) + 1)).collect()
}

#[test]
fn a_restored_aligner_with_real_registration_goes_on_with_the_same_bits() {
    let scans = yard_scans();
    let config = GlobalConfig { correction_threshold_m: 1e-6, ..GlobalConfig::default() };
    let (found, expected) = restarted(&|| method(1), &config, &scans, 15, true);
    assert!(found.1.iter().flatten().any(|c| c.pairs.iter().any(|p| p.kind == PairKind::Loop)), "no loop was tried");
    assert!(found.1.iter().flatten().any(|c| !c.corrections.is_empty()), "nothing was corrected");
    assert_eq!(found, expected);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scans = yard_scans();
    let outcome = |threads| {
        let mut config = GlobalConfig::default();
        config.coarse.threads = threads;
        go_on(&mut aligner(method(threads), &config), &scans, 0..scans.len())
    };
    let one = outcome(1);
    assert_eq!(outcome(2), one);
    assert_eq!(outcome(5), one);
}

#[test]
fn a_journal_that_does_not_fit_is_refused() {
    let script = Arc::new(Script::circle(10, 12.0, 0.2, 5));
    let mut first = aligner(Box::new(Scripted(Arc::clone(&script))), &GlobalConfig::default());
    first.keep_journal();
    let scans: Vec<_> = (0..5).map(|k| script.scan(k)).collect();
    go_on(&mut first, &scans, 0..5);
    let (journal, state) = (first.take_journal(), first.state().clone());
    let restore = |journal: Vec<Journalled>| {
        let method = Box::new(Scripted(Arc::clone(&script)));
        let (sequential, target) = (SequentialConfig::default(), Some(ScanView::unordered(&scans[4])));
        let restored = GlobalAligner::restore(
            method,
            sequential,
            GlobalConfig::default(),
            SPACING_M,
            state.clone(),
            target,
            journal,
        );
        restored.map(|_| ())
    };
    restore(journal.clone()).unwrap();
    let mut without_scan = journal.clone();
    without_scan.remove(2);
    assert!(matches!(restore(without_scan), Err(MapRestoreError::Journal { .. })));
    let mut damaged = journal.clone();
    damaged[2].keyframe.as_mut().unwrap()[40] ^= 1;
    assert!(matches!(restore(damaged), Err(MapRestoreError::Keyframe { .. })));
    let mut without_keyframe = journal;
    without_keyframe[2].keyframe = None;
    assert!(matches!(restore(without_keyframe), Err(MapRestoreError::Journal { .. })));
}
