//! Scans nobody would wish for: every method gives a defined answer, never a confidently wrong one.

use nalgebra::Vector3;

use super::test_scenes::{CORRIDOR, FLOOR, YARD, scan_of};
use super::{Limits, PrepareError, Registration, RegistrationConfig, Registry};
use crate::geometry::{Pose, rotation_angle};
use crate::scan::{Point, ScanView};

/// Runs a check for every built-in method.
fn for_each_method(mut check: impl FnMut(&mut dyn Registration)) {
    let registry = Registry::default();
    for name in registry.names() {
        check(&mut *registry.create(name, &RegistrationConfig::default()).unwrap());
    }
}

/// Aligns a scan to itself from a start 0.2 m off and returns the directions said to be known, and the pose.
fn to_itself(registration: &mut dyn Registration, points: &[Point]) -> (u32, Pose) {
    let [target, source] = [0, 1].map(|_| registration.prepare(ScanView::unordered(points)).unwrap());
    let start = Pose::translation(0.2, 0.0, 0.0);
    let found = registration.align(&*target, &*source, &start, &Limits::default()).unwrap();
    assert!(found.covariance.iter().all(|v| v.is_finite()), "{}", registration.name());
    (found.constraint.constrained_directions(), found.target_from_source)
}

#[test]
fn identical_scans_align_to_identity() {
    let points = scan_of(&YARD, &Pose::identity(), 40.0, 1);
    for_each_method(|registration| {
        let (known, pose) = to_itself(registration, &points);
        assert_eq!(known, 6);
        let name = registration.name();
        assert!(pose.translation.vector.norm() < 0.01 && rotation_angle(&pose) < 0.002, "{name}: {pose}");
    });
}

#[test]
fn a_plane_leaves_three_directions_open_and_a_corridor_one() {
    for_each_method(|registration| {
        let (known, pose) = to_itself(registration, &scan_of(&FLOOR, &Pose::identity(), 40.0, 1));
        assert_eq!(known, 3, "{}", registration.name());
        assert!((pose.translation.x - 0.2).abs() < 0.02, "the start is kept: {pose}");
        let (known, pose) = to_itself(registration, &scan_of(&CORRIDOR, &Pose::identity(), 40.0, 1));
        assert_eq!(known, 5, "{}", registration.name());
        assert!((pose.translation.x - 0.2).abs() < 0.02, "the start is kept: {pose}");
    });
}

#[test]
fn a_line_is_never_said_to_determine_a_pose() {
    let line: Vec<Point> = (0..4000).map(|k| Point::new(k as f32 * 0.01 - 20.0, 3.0, 0.5)).collect();
    for_each_method(|registration| {
        let (known, pose) = to_itself(registration, &line);
        assert_eq!(known, 0, "{}", registration.name());
        assert!((pose.translation.x - 0.2).abs() < 1e-9, "the start is kept: {pose}");
    });
}

#[test]
fn one_point_and_ten_thousand_times_the_same_point_are_too_few() {
    for_each_method(|registration| {
        for count in [1, 10_000] {
            let points = vec![Point::new(1.0, 2.0, 3.0); count];
            let error = registration.prepare(ScanView::unordered(&points)).err();
            assert!(matches!(error, Some(PrepareError::TooFewPoints { points: 1, .. })), "{error:?}");
        }
    });
}

#[test]
fn duplicates_and_values_that_are_not_finite_change_little() {
    let truth = Pose::new(Vector3::new(0.3, -0.2, 0.05), Vector3::new(0.01, 0.0, 0.05));
    let (target, clean) = (scan_of(&YARD, &Pose::identity(), 40.0, 1), scan_of(&YARD, &truth, 40.0, 2));
    let mut dirty = Vec::new();
    for (k, point) in clean.iter().enumerate() {
        dirty.extend(std::iter::repeat_n(*point, 1 + k % 7));
        dirty.push(Point::new([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX][k % 4], 1.0, 2.0));
    }
    for_each_method(|registration| {
        let target = registration.prepare(ScanView::unordered(&target)).unwrap();
        let source = registration.prepare(ScanView::unordered(&dirty)).unwrap();
        let found = registration.align(&*target, &*source, &Pose::identity(), &Limits::default()).unwrap();
        let error = truth.inverse() * found.target_from_source;
        assert!(error.translation.vector.norm() < 0.04, "{}: {error}", registration.name());
    });
}

#[test]
fn ten_million_points_are_thinned_like_any_other_number() {
    let some = scan_of(&YARD, &Pose::identity(), 40.0, 1);
    let many: Vec<Point> = some.iter().cycle().take(10_000_000).copied().collect();
    let registration = Registry::default().create("point_to_plane", &RegistrationConfig::default()).unwrap();
    let [few, many] = [&some, &many].map(|points| registration.prepare(ScanView::unordered(points)).unwrap());
    assert_eq!(few.points().len(), many.points().len());
    for (a, b) in few.points().iter().zip(many.points()) {
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-3), "{a:?} {b:?}");
    }
}
