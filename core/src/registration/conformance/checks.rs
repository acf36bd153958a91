//! The checks. Each panics at what it finds, as a test does.

// These functions are the bodies of tests, in this crate and in others: there nothing else can be done about a scan that
// should be prepared and is not.
#![allow(clippy::unwrap_used, reason = "the bodies of tests")]

use std::any::Any;

use nalgebra::Vector3;

use super::Make;
use super::draw::Draw;
use super::scenes::{CORRIDOR, FLOOR, Rectangle, YARD, scan_of};
use crate::geometry::{Pose, rotation_angle};
use crate::registration::{
    AlignError, Alignment, Limits, PrepareError, PreparedScan, Registration, RegistrationConfig,
};
use crate::scan::{Point, ScanView};

/// Motions that a check tries.
const CASES: usize = 12;

fn prepare(registration: &dyn Registration, points: &[Point]) -> Box<dyn PreparedScan> {
    registration.prepare(ScanView::unordered(points)).unwrap()
}

/// Two scans of a scene, from the origin and from `target_from_source`, with different points.
fn pair(registration: &dyn Registration, scene: &[Rectangle], pose: &Pose) -> [Box<dyn PreparedScan>; 2] {
    [
        prepare(registration, &scan_of(scene, &Pose::identity(), 40.0, 1)),
        prepare(registration, &scan_of(scene, pose, 40.0, 2)),
    ]
}

fn align(
    registration: &mut dyn Registration,
    [target, source]: &[Box<dyn PreparedScan>; 2],
    start: &Pose,
    limits: &Limits,
) -> Alignment {
    registration.align(&**target, &**source, start, limits).unwrap()
}

/// How far two poses are apart [m], [rad].
fn apart(a: &Pose, b: &Pose) -> (f64, f64) {
    let difference = a.inverse() * b;
    (difference.translation.vector.norm(), rotation_angle(&difference))
}

/// Motions of up to 0.6 m and 0.1 rad about each axis, the same in every run.
fn small_motions(seed: u64) -> Vec<Pose> {
    let mut draw = Draw::new(seed);
    (0..CASES).map(|_| draw.motion(0.6, 0.1)).collect()
}

/// A small motion is recovered from the identity.
pub fn a_small_motion_is_recovered_from_identity(make: Make<'_>) {
    let mut registration = make(&RegistrationConfig::default());
    for truth in small_motions(1) {
        let scans = pair(&*registration, &YARD, &truth);
        let found = align(&mut *registration, &scans, &Pose::identity(), &Limits::default());
        let (metres, radians) = apart(&truth, &found.target_from_source);
        // A sixth of the voxel: as well as points compared with points can do.
        assert!(metres < 0.04 && radians < 0.006, "{}: {metres} m, {radians} rad", registration.name());
        assert!(found.converged && !found.limit_reached && found.constraint.mask() == 0b11_1111);
        assert!(found.overlap > 0.7, "{}", found.overlap);
    }
}

/// The alignment of the source to the target is the inverse of that of the target to the source.
pub fn target_and_source_may_change_places(make: Make<'_>) {
    let mut registration = make(&RegistrationConfig::default());
    for truth in small_motions(2) {
        let [target, source] = pair(&*registration, &YARD, &truth);
        let there = registration.align(&*target, &*source, &Pose::identity(), &Limits::default()).unwrap();
        let back = registration.align(&*source, &*target, &Pose::identity(), &Limits::default()).unwrap();
        let (metres, radians) = apart(&there.target_from_source, &back.target_from_source.inverse());
        assert!(metres < 0.04 && radians < 0.008, "{}: {metres} m, {radians} rad", registration.name());
    }
}

/// Whatever the start and the limits: 0 iterations only judge the start, more never make it worse and never leave the
/// limits.
pub fn the_result_is_never_worse_than_the_start_nor_outside_the_limits(make: Make<'_>) {
    let mut registration = make(&RegistrationConfig::default());
    let mut draw = Draw::new(3);
    for truth in small_motions(4) {
        let start = draw.motion(3.0, 0.6);
        let (d_max, max_rotation) = (draw.between(0.0, 2.0), draw.between(0.0, 0.5));
        let limits = Limits { max_translation_m: d_max, max_rotation, ..Limits::default() };
        let scans = pair(&*registration, &YARD, &truth);
        let judged = align(&mut *registration, &scans, &start, &Limits { max_iterations: 0, ..limits });
        assert_eq!((judged.target_from_source, judged.iterations), (start, 0));
        let found = align(&mut *registration, &scans, &start, &limits);
        assert!(found.cost <= judged.cost, "{} > {}", found.cost, judged.cost);
        let (metres, radians) = apart(&start, &found.target_from_source);
        assert!(metres <= d_max + 1e-9 && radians <= max_rotation + 1e-9, "{metres} m, {radians} rad");
    }
}

/// A truth beyond `max_translation_m` ends at the border, with `limit_reached` and not `converged`.
pub fn a_truth_beyond_d_max_ends_at_the_border_and_says_so(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let scans = pair(registration, &YARD, &Pose::translation(0.36, 0.0, 0.0));
    let limits = Limits { max_translation_m: 0.3, ..Limits::default() };
    let found = align(registration, &scans, &Pose::identity(), &limits);
    let metres = found.target_from_source.translation.vector.norm();
    // On the border, unless an iterate just before it fitted a little better.
    assert!((0.25..0.3 + 1e-9).contains(&metres), "{}: {metres}", registration.name());
    assert!(found.limit_reached && !found.converged);
}

/// Scans of different places have overlap 0 and do not converge.
pub fn scans_of_different_places_have_no_overlap(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let elsewhere: Vec<Point> =
        scan_of(&YARD, &Pose::identity(), 40.0, 3).iter().map(|p| Point::new(p.x, p.y, p.z + 30.0)).collect();
    let scans = [prepare(registration, &scan_of(&YARD, &Pose::identity(), 40.0, 1)), prepare(registration, &elsewhere)];
    let found = align(registration, &scans, &Pose::identity(), &Limits::default());
    assert_eq!(found.overlap, 0.0);
    assert!(!found.converged);
    assert_eq!(found.constraint.constrained_directions(), 0);
    assert!(found.covariance.iter().all(|v| v.is_finite()) && found.covariance[(0, 0)] >= 1.0);
}

/// Along a corridor the start is kept, its direction is not constrained and has a variance of at least the square of the
/// pair distance.
pub fn along_a_corridor_the_start_is_kept_and_said_to_be_unknown(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let scans = pair(registration, &CORRIDOR, &Pose::translation(0.5, 0.1, 0.05));
    let found = align(registration, &scans, &Pose::translation(0.2, 0.0, 0.0), &Limits::default());
    assert_eq!(found.constraint.mask(), 0b11_1110, "{:?}", found.constraint.eigenvalues);
    assert!(found.constraint.directions[(0, 0)].abs() > 0.98, "{}", found.constraint.directions);
    let t = found.target_from_source.translation.vector;
    assert!((t.x - 0.2).abs() < 0.02, "the start's x is kept: {}", t.x);
    assert!((t.y - 0.1).abs() < 0.02 && (t.z - 0.05).abs() < 0.02, "{t}");
    assert!(found.covariance[(0, 0)] > 1.0 && found.covariance[(1, 1)] < 1e-2, "{}", found.covariance);
}

/// A bare floor constrains height, roll and pitch; the other directions keep the start.
pub fn a_bare_floor_constrains_height_roll_and_pitch_only(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let scans = pair(registration, &FLOOR, &Pose::new(Vector3::new(0.0, 0.0, 0.2), Vector3::new(0.03, 0.02, 0.0)));
    let found = align(registration, &scans, &Pose::identity(), &Limits::default());
    assert_eq!(found.constraint.mask(), 0b11_1000, "{:?}", found.constraint.eigenvalues);
    let moved = found.target_from_source;
    assert!((moved.translation.z - 0.2).abs() < 0.02, "{moved}");
    let (x, y) = (moved.translation.x, moved.translation.y);
    assert!(x.abs() < 0.02 && y.abs() < 0.02 && moved.rotation.scaled_axis().z.abs() < 0.005, "{moved}");
}

/// Cells without a return, and points that are not finite, change nothing.
pub fn cells_without_a_return_change_nothing(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let points = scan_of(&YARD, &Pose::translation(0.3, 0.0, 0.0), 40.0, 2);
    let mut with_gaps = Vec::new();
    for (k, point) in points.iter().enumerate() {
        with_gaps.push(*point);
        with_gaps.push([Point::EMPTY, Point::new(f32::INFINITY, 0.0, 1.0), Point::new(1.0, f32::NAN, 0.0)][k % 3]);
    }
    let target = prepare(registration, &scan_of(&YARD, &Pose::identity(), 40.0, 1));
    let (plain, gaps) = (prepare(registration, &points), prepare(registration, &with_gaps));
    assert_eq!(plain.points(), gaps.points());
    let a = registration.align(&*target, &*plain, &Pose::identity(), &Limits::default()).unwrap();
    let b = registration.align(&*target, &*gaps, &Pose::identity(), &Limits::default()).unwrap();
    assert_eq!(a, b);
}

/// The same bits come out for any number of threads, and after other work.
pub fn the_same_bits_come_out_for_any_number_of_threads_and_after_other_work(make: Make<'_>) {
    let run = |threads: usize, disturbed: bool| {
        let mut registration = make(&RegistrationConfig { threads, ..RegistrationConfig::default() });
        let truth = Pose::new(Vector3::new(0.4, -0.3, 0.1), Vector3::new(0.02, 0.0, 0.08));
        let scans = pair(&*registration, &YARD, &truth);
        if disturbed {
            let other = pair(&*registration, &CORRIDOR, &truth);
            align(&mut *registration, &other, &Pose::translation(0.1, 0.0, 0.0), &Limits::default());
        }
        let found = align(&mut *registration, &scans, &Pose::identity(), &Limits::default());
        let pose = crate::geometry::rows_from_pose(&found.target_from_source);
        let bits: Vec<u64> = pose.iter().chain(found.covariance.iter()).map(|v| v.to_bits()).collect();
        (found, bits)
    };
    let expected = run(1, false);
    for (threads, disturbed) in [(1, false), (2, false), (3, false), (8, false), (1, true), (3, true)] {
        assert_eq!(run(threads, disturbed), expected, "{threads} threads");
    }
}

/// The covariance is symmetric, positive definite and largest where the geometry is weakest.
pub fn the_covariance_is_positive_definite_and_largest_where_the_geometry_is_weakest(make: Make<'_>) {
    // The yard with its ends and inner walls reduced to slivers holds x only weakly.
    let mut scene = CORRIDOR.to_vec();
    scene.push(([6.0, -2.0, -1.0], [0.0, 4.0, 0.0], [0.0, 0.0, 3.0]));
    let registration = &mut *make(&RegistrationConfig::default());
    let scans = pair(registration, &scene, &Pose::translation(0.2, 0.1, 0.0));
    let found = align(registration, &scans, &Pose::identity(), &Limits::default());
    assert_eq!(found.constraint.mask(), 0b11_1111, "{:?}", found.constraint.eigenvalues);
    assert_eq!(found.covariance, found.covariance.transpose());
    assert!(found.covariance.cholesky().is_some(), "{}", found.covariance);
    assert!(found.covariance[(0, 0)] > 2.0 * found.covariance[(1, 1)], "{}", found.covariance);
    let error = found.target_from_source.translation.x - 0.2;
    assert!(error.abs() < 5.0 * found.covariance[(0, 0)].sqrt().max(0.005), "{error}");
}

/// A scan with nothing to align is refused by [`PrepareError`].
pub fn a_scan_with_nothing_to_align_is_refused_by_type(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let nothing = [Point::EMPTY, Point::new(0.1, 0.0, 0.0)];
    let error = registration.prepare(ScanView::unordered(&nothing)).err();
    assert!(matches!(error, Some(PrepareError::NoPoints { returns: 1, .. })), "{error:?}");
    assert!(matches!(registration.prepare(ScanView::unordered(&[])).err(), Some(PrepareError::NoPoints { .. })));
    let few = scan_of(&FLOOR, &Pose::identity(), 0.05, 1);
    let error = registration.prepare(ScanView::unordered(&few)).err();
    assert!(matches!(error, Some(PrepareError::TooFewPoints { required: 100, .. })), "{error:?}");
}

/// A prepared scan of nobody's.
struct Foreign;

impl PreparedScan for Foreign {
    fn points(&self) -> &[[f32; 3]] {
        &[]
    }

    fn bytes(&self) -> usize {
        0
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// A question without sense is refused by [`AlignError`].
pub fn a_question_that_makes_no_sense_is_refused_by_type(make: Make<'_>) {
    let registration = &mut *make(&RegistrationConfig::default());
    let scan = prepare(registration, &scan_of(&YARD, &Pose::identity(), 40.0, 1));
    let (start, limits) = (Pose::identity(), Limits::default());
    let error = registration.align(&*scan, &Foreign, &start, &limits).unwrap_err();
    assert!(matches!(error, AlignError::ForeignScan { role: "source", .. }), "{error}");
    let error = registration.align(&*scan, &*scan, &Pose::translation(f64::NAN, 0.0, 0.0), &limits).unwrap_err();
    assert_eq!(error, AlignError::StartNotFinite);
    let limits = Limits { pair_distance_m: -1.0, ..limits };
    let error = registration.align(&*scan, &*scan, &start, &limits).unwrap_err();
    assert!(error.to_string().contains("limits.pair_distance_m"), "{error}");
    assert!(scan.bytes() > 12 * scan.points().len());
}
