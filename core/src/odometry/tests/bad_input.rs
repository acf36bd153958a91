//! Frames that say little or nothing: a typed answer, no panic, and the next frame goes on.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::synthetic::{frame, indoor};
use crate::geometry::{Pose, Twist};
use crate::odometry::{FrameStatus, FrameTime, Odometry};
use crate::registration::test_scenes::{YARD, scan_of};
use crate::scan::{Point, ScanView};

fn register(odometry: &mut Odometry, points: &[Point]) -> FrameStatus {
    odometry.register_frame(ScanView::unordered(points), None, None).status
}

#[test]
fn frames_without_enough_returns_are_named_so_and_the_odometry_goes_on() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    let bad: [Vec<Point>; 5] = [
        vec![],
        vec![Point::new(1.0, 2.0, 3.0)],
        vec![Point::EMPTY; 5000],
        vec![Point::new(f32::INFINITY, 1.0, f32::NAN); 5000],
        vec![Point::new(4.0, 1.0, 0.5); 5000],
    ];
    for points in &bad {
        assert_eq!(register(&mut odometry, points), FrameStatus::TooFewPoints);
    }
    assert_eq!(frame(&mut odometry, &YARD, &Pose::identity(), 1).status, FrameStatus::Started);
    for (k, points) in bad.iter().enumerate() {
        assert_eq!(register(&mut odometry, points), FrameStatus::TooFewPoints);
        let truth = Pose::new(Vector3::new(0.2 * (k + 1) as f64, 0.0, 0.0), Vector3::zeros());
        let record = frame(&mut odometry, &YARD, &truth, k as u64 + 2);
        assert_eq!(record.status, FrameStatus::Tracked);
        assert!((truth.inverse() * record.map_from_scanner).translation.vector.norm() < 0.03);
    }
}

#[test]
fn a_frame_of_another_place_is_lost_and_leaves_the_map_as_it_was() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    for k in 0..3 {
        frame(&mut odometry, &YARD, &Pose::identity(), k + 1);
    }
    let before: Vec<_> = odometry.map_points().collect();
    // Slabs stacked every way, which the yard does not have.
    let elsewhere: Vec<Point> = (0..20_000_u32)
        .map(|k| {
            let (a, b) = ((k % 141) as f32 * 0.1 - 7.0, (k / 141) as f32 * 0.1 - 7.0);
            Point::new(a, b, 3.0 + 0.9 * a + 1.3 * (b * 0.7).sin())
        })
        .collect();
    let record = odometry.register_frame(ScanView::unordered(&elsewhere), None, None);
    assert_eq!(record.status, FrameStatus::Lost, "score {}", record.score);
    assert!(record.covariance.cholesky().is_some());
    assert_eq!(before, odometry.map_points().collect::<Vec<_>>());
    let record = frame(&mut odometry, &YARD, &Pose::identity(), 9);
    assert_eq!(record.status, FrameStatus::Tracked);
    assert!(record.map_from_scanner.translation.vector.norm() < 0.02);
}

#[test]
fn a_guess_that_is_no_pose_is_refused() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    let points = scan_of(&YARD, &Pose::identity(), 60.0, 1);
    for x in [f64::NAN, f64::INFINITY, 1e300] {
        let guess = Pose::from_parts(nalgebra::Translation3::new(x, 0.0, 0.0), nalgebra::UnitQuaternion::identity());
        let record = odometry.register_frame(ScanView::unordered(&points), None, Some(guess));
        assert_eq!(record.status, FrameStatus::InvalidGuess);
    }
    assert_eq!(register(&mut odometry, &points), FrameStatus::Started);
}

#[test]
fn times_that_stand_still_or_are_no_numbers_do_no_harm() {
    let mut odometry = Odometry::new(indoor()).unwrap();
    for (k, end_s) in [1.0, 1.0, 0.5, f64::NAN, f64::INFINITY, 2.0].into_iter().enumerate() {
        let points = scan_of(&YARD, &Pose::identity(), 60.0, k as u64 + 1);
        for duration_s in [0.1, f64::NAN, -1.0, 1e300] {
            let time = Some(FrameTime { end_s, duration_s });
            let record = odometry.register_frame(ScanView::unordered(&points), time, None);
            assert!(record.status.is_tracked() && record.map_from_scanner.translation.vector.norm() < 0.02);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn no_frame_makes_it_panic(
        seed in 0..1000_u64, kinds in prop::collection::vec((0..8_u8, 0..3000_usize), 1..6), bits in any::<[u32; 8]>(),
    ) {
        let mut odometry = Odometry::new(indoor()).unwrap();
        for (kind, count) in kinds {
            let points: Vec<Point> = match kind {
                0 => (0..count).map(|k| Point::new(0.01 * k as f32, 1.0, 1.0)).collect(),
                1 => (0..count).map(|k| Point::new((k % 60) as f32 * 0.2, (k / 60) as f32 * 0.2, -1.0)).collect(),
                2 => (0..count).map(|k| {
                    let value = |n: u32| f32::from_bits(bits[(k + n as usize) % 8].rotate_left(k as u32 % 31 + n));
                    Point { time: k as u16, ..Point::new(value(0), value(3), value(7)) }
                }).collect(),
                3 => vec![Point::new(2.0, 2.0, 2.0); count],
                4 => vec![],
                _ => scan_of(&YARD, &crate::geometry::exp(&Twist::repeat(0.01 * count as f64 / 30.0)), 60.0, seed),
            };
            let record = odometry.register_frame(ScanView::unordered(&points), None, None);
            prop_assert!(crate::geometry::rows_from_pose(&record.map_from_scanner).iter().all(|v| v.is_finite()));
            prop_assert!(record.covariance.iter().all(|v| v.is_finite()));
            prop_assert!(record.score.is_finite() && record.residual_rms_m.is_finite());
        }
    }
}
