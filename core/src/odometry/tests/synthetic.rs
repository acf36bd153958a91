//! Simple scenes with a known answer.

use nalgebra::Vector3;
use proptest::prelude::*;

use crate::geometry::{Pose, rotation_angle};
use crate::odometry::{
    FrameRecord, FrameStatus, FrameTime, KeyframeConfig, KeyframeSelector, Odometry, OdometryConfig,
};
use crate::registration::test_scenes::{CORRIDOR, FLOOR, Rectangle, YARD, scan_of};
use crate::scan::ScanView;

pub(super) fn indoor() -> OdometryConfig {
    OdometryConfig { voxel_m: 0.6, max_range_m: 30.0, ..OdometryConfig::default() }
}

pub(super) fn frame(odometry: &mut Odometry, scene: &[Rectangle], pose: &Pose, seed: u64) -> FrameRecord {
    let points = scan_of(scene, pose, 60.0, seed);
    odometry.register_frame(ScanView::unordered(&points), None, None)
}

fn pose(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::new(Vector3::new(x, y, 0.0), Vector3::new(0.0, 0.0, yaw))
}

#[test]
fn a_scanner_that_stands_stays_where_it_is() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    for k in 0..12 {
        let record = frame(&mut odometry, &YARD, &Pose::identity(), k + 1);
        assert!(record.status.is_tracked());
        assert!(record.map_from_scanner.translation.vector.norm() < 0.01, "{k}: {record:?}");
    }
}

#[test]
fn a_walk_through_the_yard_is_followed_and_its_error_matches_the_covariance() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    let mut normalised = Vec::new();
    for k in 0..15 {
        let truth = pose(0.15 * f64::from(k), 0.05 * f64::from(k), 0.03 * f64::from(k));
        let record = frame(&mut odometry, &YARD, &truth, k as u64 + 1);
        let error = truth.inverse() * record.map_from_scanner;
        assert!(error.translation.vector.norm() < 0.03 && rotation_angle(&error) < 0.01, "{k}: {error}");
        if k > 0 {
            assert_eq!(record.status, FrameStatus::Tracked);
            assert!(record.converged && record.score > 0.4, "{record:?}");
            let xi = crate::geometry::log(&error);
            normalised.push(xi.dot(&(record.covariance.try_inverse().unwrap() * xi)) / 6.0);
        }
    }
    normalised.sort_by(f64::total_cmp);
    let median = normalised[normalised.len() / 2];
    println!("normalised squared errors {normalised:.2?}");
    assert!((0.02..10.0).contains(&median), "{median}");
}

#[test]
fn a_corridor_is_flagged_and_keeps_the_prediction_along_its_axis() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    frame(&mut odometry, &CORRIDOR, &Pose::identity(), 1);
    let record = frame(&mut odometry, &CORRIDOR, &pose(0.0, 0.1, 0.0), 2);
    assert_eq!(record.status, FrameStatus::UnderConstrained, "{:?}", record.constraint.eigenvalues);
    assert_eq!(record.constraint.constrained_directions(), 5);
    let along = record.constraint.directions.column(0);
    assert!(along[0].abs() > 0.99, "{along}");
    let t = record.map_from_scanner.translation.vector;
    assert!(t.x.abs() < 0.02 && (t.y - 0.1).abs() < 0.02, "{t}");
    assert!(record.covariance[(0, 0)] > 0.9 && record.covariance[(1, 1)] < 0.01, "{}", record.covariance);
}

#[test]
fn a_bare_floor_constrains_three_directions() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    frame(&mut odometry, &FLOOR, &Pose::identity(), 1);
    let record = frame(&mut odometry, &FLOOR, &pose(0.3, 0.0, 0.1), 2);
    assert_eq!(record.status, FrameStatus::UnderConstrained);
    assert_eq!(record.constraint.constrained_directions(), 3, "{:?}", record.constraint.eigenvalues);
    assert!(record.map_from_scanner.translation.vector.norm() < 0.02);
}

#[test]
fn after_a_gap_in_time_the_scanner_is_found_again() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    let mut record = None;
    for (k, end_s) in [0.0, 0.1, 0.2, 0.3, 5.0].into_iter().enumerate() {
        let truth = if end_s > 1.0 { pose(2.0, -1.5, 1.2) } else { pose(0.1 * k as f64, 0.0, 0.0) };
        let points = scan_of(&YARD, &truth, 60.0, k as u64 + 1);
        let time = FrameTime { end_s, duration_s: 0.1 };
        let answer = odometry.register_frame(ScanView::unordered(&points), Some(time), None);
        let error = truth.inverse() * answer.map_from_scanner;
        assert!(answer.status.is_tracked() && error.translation.vector.norm() < 0.05, "{end_s}: {error}");
        record = Some(answer);
    }
    assert!(record.unwrap().threshold_m >= 1.9, "the motion model has to be learnt anew");
}

#[test]
fn a_guess_is_used_as_the_start() {
    let mut odometry = Odometry::new(OdometryConfig { search_radius_m: 0.0, ..indoor() }).unwrap();
    let origin = Pose::new(Vector3::new(400_000.0, 5_000_000.0, 300.0), Vector3::new(0.0, 0.0, 1.0));
    for (k, truth) in [pose(0.0, 0.0, 0.0), pose(3.0, 1.0, 1.0)].into_iter().enumerate() {
        let points = scan_of(&YARD, &truth, 60.0, k as u64 + 1);
        let guess = origin * truth * pose(0.1, 0.0, 0.02);
        let guess = if k == 0 { origin } else { guess };
        let record = odometry.register_frame(ScanView::unordered(&points), None, Some(guess));
        let error = (origin * truth).inverse() * record.map_from_scanner;
        assert!(record.status.is_tracked() && error.translation.vector.norm() < 0.03, "{error}");
    }
}

#[test]
fn keyframes_are_apart_and_their_motions_compose_to_the_trajectory() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    let config = KeyframeConfig { distance_m: 0.5, overlap: 0.0, ..KeyframeConfig::default() };
    let mut selector = KeyframeSelector::new(config).unwrap();
    let mut composed = Pose::identity();
    let mut count = 0;
    for k in 0..13 {
        let record = frame(&mut odometry, &YARD, &pose(0.2 * f64::from(k), 0.0, 0.0), k as u64 + 1);
        if let Some(keyframe) = selector.consider(&record, odometry.frame_points()) {
            composed *= keyframe.last_from_this;
            assert!((composed.translation.vector - record.map_from_scanner.translation.vector).norm() < 1e-9);
            assert!(keyframe.points.len() > 100 && keyframe.points.len() < odometry.frame_points().len());
            assert!(count == 0 || keyframe.covariance.cholesky().is_some());
            count += 1;
        }
    }
    assert_eq!(count, 5, "at 0, 0.6, 1.2, 1.8 and 2.4 m");
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let run = |threads| {
        let mut odometry = Odometry::new(OdometryConfig { threads, ..indoor() }).unwrap();
        // The third frame is far off, so that the search takes part.
        let poses = [pose(0.0, 0.0, 0.0), pose(0.2, 0.0, 0.0), pose(2.5, -1.0, 2.0), pose(2.6, -1.0, 2.1)];
        let records: Vec<_> =
            poses.iter().enumerate().map(|(k, p)| frame(&mut odometry, &YARD, p, k as u64 + 1)).collect();
        (records, odometry.map_points().collect::<Vec<_>>())
    };
    let one = run(1);
    assert!(one.0[2].searched > 0);
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
}

#[test]
fn the_memory_stays_the_same_over_a_long_way() {
    let config = OdometryConfig { max_voxels: 2000, max_range_m: 15.0, ..indoor() };
    let mut odometry = Odometry::new(config).unwrap();
    let mut bytes = Vec::new();
    for k in 0..60 {
        // A new yard every 0.4 m: the guess says how far, the map has to make room.
        let points = scan_of(&YARD, &Pose::identity(), 60.0, k + 1);
        let guess = pose(0.4 * k as f64, 0.0, 0.0);
        odometry.register_frame(ScanView::unordered(&points), None, Some(guess));
        bytes.push(odometry.bytes());
        assert!(odometry.map_points().count() <= 2000);
    }
    // The map is there from the start; buffers have the size of the largest frame, and come with the first search.
    assert!(bytes.iter().all(|b| *b <= 3_000_000), "{bytes:?}");
    assert!(bytes[30..].iter().all(|b| *b == bytes[30]), "{bytes:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_turn_on_the_spot_of_any_angle_is_found(yaw in -3.1..3.1f64, x in -1.5..1.5f64, y in -1.5..1.5f64) {
        let mut odometry = Odometry::new(indoor()).unwrap();
        (1..4).for_each(|seed| drop(frame(&mut odometry, &YARD, &Pose::identity(), seed)));
        let truth = pose(x, y, yaw);
        let record = frame(&mut odometry, &YARD, &truth, 4);
        let error = truth.inverse() * record.map_from_scanner;
        let right = error.translation.vector.norm() < 0.05 && rotation_angle(&error) < 0.02;
        prop_assert!(right || record.status == FrameStatus::Lost, "{error} {record:?}");
        prop_assert!(right, "lost: {record:?}");
    }
}
