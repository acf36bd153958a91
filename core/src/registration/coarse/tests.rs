//! Recovery and refusal on real scans and on scenes that cannot be aligned.

use nalgebra::Vector3;

use super::*;
use crate::geometry::{Pose, rotation_angle};
use crate::registration::test_scenes::{CORRIDOR, FLOOR, YARD, data, read_pose, read_tum, read_xyz32, scan_of};
use crate::registration::{PointToPlane, PreparedScan, Registration, RegistrationConfig};
use crate::scan::{Point, ScanView};

/// A scan prepared both ways.
struct Prepared {
    prepared: Box<dyn PreparedScan>,
    coarse: CoarseScan,
}

impl Prepared {
    fn new(points: &[Point], aligner: &CoarseAligner) -> Self {
        let prepared = registration().prepare(ScanView::unordered(points)).unwrap();
        let coarse = aligner.prepare(prepared.points(), 0.25);
        Self { prepared, coarse }
    }

    fn keyframe(&self) -> Keyframe<'_> {
        Keyframe { prepared: &*self.prepared, coarse: &self.coarse }
    }
}

fn registration() -> PointToPlane {
    PointToPlane::new(RegistrationConfig { threads: 2, ..RegistrationConfig::default() })
}

fn aligner() -> CoarseAligner {
    CoarseAligner::new(CoarseConfig::default()).unwrap()
}

fn error_of(truth: &Pose, pose: &Pose) -> (f64, f64) {
    let error = truth.inverse() * pose;
    (error.translation.vector.norm(), rotation_angle(&error).to_degrees())
}

/// Errors of up to 5 m, 45 degrees of yaw and 5 degrees of tilt.
fn wrong_priors() -> [Pose; 3] {
    let turn = |yaw: f64, roll: f64| Vector3::new(roll.to_radians(), -0.5 * roll.to_radians(), yaw.to_radians());
    [
        Pose::new(Vector3::new(3.0, 4.0, 0.4), turn(44.0, 4.0)),
        Pose::new(Vector3::new(-4.5, 1.0, -0.3), turn(-40.0, -4.5)),
        Pose::new(Vector3::new(0.0, -5.0, 0.2), turn(25.0, 2.0)),
    ]
}

#[test]
fn the_synthetic_pair_is_recovered_from_priors_five_metres_and_forty_degrees_wrong() {
    let Some(folder) = data("coarse synth_pair", "synth_pair") else { return };
    let mut aligner = aligner();
    let [target, source] = ["target", "source"]
        .map(|name| Prepared::new(&read_xyz32(&folder.join(format!("{name}.xyz32.bin"))), &aligner));
    let truth = read_pose(&folder.join("target_from_source.txt"));
    for error in wrong_priors() {
        let answer = aligner
            .relocalise(
                &mut registration(),
                target.keyframe(),
                source.keyframe(),
                &(truth * error),
                &SearchRange::default(),
            )
            .unwrap();
        let trusted = answer.trusted().unwrap_or_else(|| panic!("{:?}", answer.verdict.doubt));
        let (metres, degrees) = error_of(&truth, &trusted.target_from_source);
        assert!(metres < 0.01 && degrees < 0.05, "{metres} m {degrees} deg");
    }
}

#[test]
fn neighbouring_handheld_scans_are_recovered_and_a_prior_out_of_reach_is_refused() {
    let Some(folder) = data("coarse handheld", "handheld") else { return };
    let mut aligner = aligner();
    let poses = read_tum(&folder.join("poses.tum"));
    let scans =
        [8, 9].map(|k| Prepared::new(&read_xyz32(&folder.join(format!("scan{:03}.xyz32.bin", 4 * k))), &aligner));
    let truth = poses[8].inverse() * poses[9];
    for error in wrong_priors() {
        let answer = aligner
            .relocalise(
                &mut registration(),
                scans[0].keyframe(),
                scans[1].keyframe(),
                &(truth * error),
                &SearchRange::default(),
            )
            .unwrap();
        let trusted = answer.trusted().unwrap_or_else(|| panic!("{:?}", answer.verdict.doubt));
        let (metres, degrees) = error_of(&truth, &trusted.target_from_source);
        assert!(metres < 0.1 && degrees < 0.5, "{metres} m {degrees} deg");
    }
    let far = truth * Pose::new(Vector3::new(3.0, 12.0, 0.0), Vector3::new(0.0, 0.0, 2.0));
    let answer = aligner
        .relocalise(&mut registration(), scans[0].keyframe(), scans[1].keyframe(), &far, &SearchRange::default())
        .unwrap();
    assert!(answer.trusted().is_none(), "{answer:?}");
}

#[test]
fn a_corridor_and_a_bare_floor_are_never_trusted_however_well_they_overlap() {
    let mut aligner = aligner();
    for scene in [&CORRIDOR[..], &FLOOR[..]] {
        let [target, source] =
            [1, 2].map(|seed| Prepared::new(&scan_of(scene, &Pose::identity(), 30.0, seed), &aligner));
        let answer = aligner
            .relocalise(
                &mut registration(),
                target.keyframe(),
                source.keyframe(),
                &Pose::identity(),
                &SearchRange::default(),
            )
            .unwrap();
        assert!(answer.trusted().is_none(), "{answer:?}");
    }
}

#[test]
fn scans_of_nothing_of_one_point_of_a_line_and_identical_ones_have_a_plain_answer() {
    let mut aligner = aligner();
    let line: Vec<[f32; 3]> = (0..500).map(|k| [k as f32 * 0.1 - 25.0, 2.0, 0.0]).collect();
    for points in [&[][..], &[[1.0, 2.0, 3.0]][..], &line[..]] {
        let scan = aligner.prepare(points, 0.25);
        let found = aligner.align(&scan, &scan, &Pose::identity(), &SearchRange::default()).unwrap();
        for hypothesis in &found.hypotheses {
            assert!(!aligner.verify(&scan, &scan, &hypothesis.target_from_source).is_trusted());
        }
        assert!(!aligner.verify(&scan, &scan, &Pose::identity()).is_trusted());
    }
    let yard: Vec<[f32; 3]> = scan_of(&YARD, &Pose::identity(), 30.0, 1).iter().map(|p| [p.x, p.y, p.z]).collect();
    let scan = aligner.prepare(&yard, 0.25);
    let verdict = aligner.verify(&scan, &scan, &Pose::identity());
    assert!(verdict.is_trusted(), "{verdict:?}");
    assert!(verdict.evidence.score() > 0.95, "{verdict:?}");
}

#[test]
fn a_pose_that_is_not_finite_or_a_range_that_is_none_is_an_error() {
    let mut aligner = aligner();
    let scan = aligner.prepare(&[], 0.25);
    let nan = Pose::translation(f64::NAN, 0.0, 0.0);
    let range = SearchRange::default();
    assert_eq!(aligner.align(&scan, &scan, &nan, &range).unwrap_err(), CoarseError::StartNotFinite);
    assert!(!aligner.verify(&scan, &scan, &nan).is_trusted());
    let none = SearchRange { tilt: -1.0, ..range };
    assert!(matches!(aligner.align(&scan, &scan, &Pose::identity(), &none), Err(CoarseError::Config(_))));
}

#[test]
fn the_answer_depends_neither_on_the_number_of_threads_nor_on_earlier_questions() {
    let [a, b] = [1, 2].map(|seed| {
        let pose = Pose::new(Vector3::new(0.5 * f64::from(seed), 0.0, 0.0), Vector3::new(0.0, 0.0, 0.1));
        let points = scan_of(&YARD, &pose, 30.0, u64::from(seed as u32));
        points.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>()
    });
    let with = |threads: usize, before: bool| {
        let mut aligner = CoarseAligner::new(CoarseConfig { threads, ..CoarseConfig::default() }).unwrap();
        let (a, b) = (aligner.prepare(&a, 0.25), aligner.prepare(&b, 0.25));
        if before {
            aligner.align(&b, &a, &Pose::identity(), &SearchRange::default()).unwrap();
        }
        aligner.align(&a, &b, &Pose::translation(1.0, 1.0, 0.0), &SearchRange::default()).unwrap()
    };
    let one = with(1, false);
    assert!(!one.hypotheses.is_empty());
    assert_eq!(one, with(2, true));
    assert_eq!(one, with(3, false));
}
