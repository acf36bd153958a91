//! The built-in methods on real scans and on the exact synthetic pair.

use std::time::Instant;

use super::test_scenes::{YARD, data, read_pose, read_xyz32, scan_of};
use super::{Alignment, Limits, Optimiser, RegistrationConfig, Registry, RobustKernel};
use crate::geometry::{Pose, rotation_angle};
use crate::scan::{Point, ScanView};

/// Aligns one pair from identity and prints the figures; returns the errors [m], [deg].
fn pair(method: &str, name: &str, source: &[Point], target: &[Point], truth: &Pose) -> (f64, f64, Alignment) {
    let config = RegistrationConfig { threads: 2, ..RegistrationConfig::default() };
    let mut registration = Registry::default().create(method, &config).unwrap();
    let begin = Instant::now();
    let target = registration.prepare(ScanView::unordered(target)).unwrap();
    let source = registration.prepare(ScanView::unordered(source)).unwrap();
    let prepared = begin.elapsed();
    let result = registration.align(&*target, &*source, &Pose::identity(), &Limits::default()).unwrap();
    let error = truth.inverse() * result.target_from_source;
    let (metres, degrees) = (error.translation.vector.norm(), rotation_angle(&error).to_degrees());
    println!(
        "{name} {method}: {metres:.4} m {degrees:.4} deg, {} steps, overlap {:.3}, residual {:.4}, converged {}, \
         eigenvalues {:.3?}, sigma {:.4?}, {} points, {} bytes, {prepared:?} + {:?}",
        result.iterations,
        result.overlap,
        result.residual_rms_m,
        result.converged,
        result.constraint.eigenvalues,
        result.covariance.diagonal().map(f64::sqrt).as_slice(),
        source.points().len(),
        source.bytes(),
        begin.elapsed() - prepared,
    );
    (metres, degrees, result)
}

/// Methods on a folder with source, target and truth: the largest errors allowed of each.
fn folder(name: &str, allowed: &[(&str, f64, f64)]) {
    let Some(path) = data(name, name) else { return };
    let source = read_xyz32(&path.join("source.xyz32.bin"));
    let target = read_xyz32(&path.join("target.xyz32.bin"));
    let truth = read_pose(&path.join("target_from_source.txt"));
    for &(method, most_m, most_deg) in allowed {
        let (metres, degrees, result) = pair(method, name, &source, &target, &truth);
        assert!(metres < most_m && degrees < most_deg, "{method}: {metres} m, {degrees} deg");
        assert!(result.converged && result.constraint.mask() == 0b11_1111);
    }
}

#[test]
fn the_exact_synthetic_pair_is_recovered_from_identity() {
    folder(
        "synth_pair",
        &[
            ("point_to_plane", 0.0006, 0.008),
            ("symmetric_point_to_plane", 0.0006, 0.008),
            ("gicp", 0.0006, 0.008),
            ("vgicp", 0.0006, 0.008),
            ("ndt", 0.001, 0.008),
            ("point_to_point", 0.02, 0.06),
        ],
    );
}

#[test]
fn the_handheld_pair_is_recovered_from_identity() {
    folder(
        "handheld_pair",
        &[
            ("point_to_plane", 0.010, 0.07),
            ("symmetric_point_to_plane", 0.012, 0.07),
            ("gicp", 0.010, 0.07),
            ("vgicp", 0.010, 0.07),
            ("ndt", 0.010, 0.07),
            ("point_to_point", 0.02, 0.2),
        ],
    );
}

#[test]
fn kernels_trimming_and_both_optimisers_agree_on_the_handheld_pair() {
    let Some(path) = data("handheld_pair", "handheld_pair") else { return };
    let source = read_xyz32(&path.join("source.xyz32.bin"));
    let target = read_xyz32(&path.join("target.xyz32.bin"));
    let truth = read_pose(&path.join("target_from_source.txt"));
    let variants = [
        RegistrationConfig { robust_kernel: RobustKernel::Huber, ..RegistrationConfig::default() },
        RegistrationConfig { robust_kernel: RobustKernel::Tukey, ..RegistrationConfig::default() },
        RegistrationConfig { robust_kernel: RobustKernel::GemanMcclure, ..RegistrationConfig::default() },
        RegistrationConfig { trimmed_overlap: 0.8, ..RegistrationConfig::default() },
        RegistrationConfig { optimiser: Optimiser::LevenbergMarquardt, ..RegistrationConfig::default() },
    ];
    for config in variants {
        for method in ["point_to_plane", "gicp"] {
            let mut registration = Registry::default().create(method, &config).unwrap();
            let target = registration.prepare(ScanView::unordered(&target)).unwrap();
            let source = registration.prepare(ScanView::unordered(&source)).unwrap();
            let result = registration.align(&*target, &*source, &Pose::identity(), &Limits::default()).unwrap();
            let error = truth.inverse() * result.target_from_source;
            let (metres, degrees) = (error.translation.vector.norm(), rotation_angle(&error).to_degrees());
            println!(
                "{method} {:?} {:?}: {metres:.4} m, {degrees:.4} deg, {} steps",
                config.robust_kernel, config.optimiser, result.iterations
            );
            assert!(
                result.converged && metres < 0.015 && degrees < 0.1,
                "{method}, {config:?}: {metres} m, {degrees} deg"
            );
        }
    }
}

/// Of a yard the second scan sees boards as well, a hand's breadth before the walls, that the first one did not.
#[test]
fn the_last_steps_are_not_pulled_by_surfaces_that_only_one_scan_saw() {
    let boards =
        YARD[1..5].iter().map(|(corner, u, v)| ([corner[0], corner[1] + 0.4, corner[2]], u.map(|x| 0.5 * x), *v));
    let with_boards: Vec<_> = YARD.into_iter().chain(boards).collect();
    let truth = Pose::new(nalgebra::Vector3::new(1.5, 0.6, 0.0), nalgebra::Vector3::new(0.0, 0.0, 0.3));
    let target = scan_of(&YARD, &Pose::identity(), 80.0, 3);
    let source = scan_of(&with_boards, &truth, 80.0, 4);
    for method in ["gicp", "point_to_plane", "symmetric_point_to_plane"] {
        let (metres, degrees, _) = pair(method, "boards", &source, &target, &truth);
        assert!(metres < 0.003 && degrees < 0.03, "{method}: {metres} m, {degrees} deg");
    }
}
