//! Scans of a spinning scanner in motion, cast ray by ray through the built-in scene, each ray from where the scanner
//! was when it was fired.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal};

use crate::geometry::{Pose, Twist, exp, rotation_angle};
use crate::odometry::{FrameRecord, FrameTime, Odometry, OdometryConfig};
use crate::scan::{Point, ScanView};
use crate::simulation::{CompiledScene, Scene};

const BEAMS: usize = 40;
const AZIMUTHS: usize = 720;
const INTERVAL_S: f64 = 0.1;

/// Circles the house: 10 m/s ahead, turning 45 degrees a second, from 12.7 m off its middle, with a speed that swells
/// by `swell` twice a second.
fn map_from_scanner(time_s: f64, swell: f64) -> Pose {
    let start = Pose::from_parts(Translation3::new(2.0, 2.0 - 12.7, 2.8), UnitQuaternion::identity());
    let rate = Twist::new(10.0, 0.0, 0.0, 0.0, 0.0, 45_f64.to_radians());
    let omega = 4.0 * std::f64::consts::PI;
    start * exp(&(rate * (time_s + swell * (1.0 - (omega * time_s).cos()) / omega)))
}

/// The scan that ends at `end_s`, with ranges off by 1 cm.
fn scan(scene: &CompiledScene, end_s: f64, swell: f64, seed: u64) -> Vec<Point> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, 0.01).unwrap();
    let mut points = Vec::with_capacity(BEAMS * AZIMUTHS);
    for column in 0..AZIMUTHS {
        let fraction = column as f64 / (AZIMUTHS - 1) as f64;
        let pose = map_from_scanner(end_s - INTERVAL_S * (1.0 - fraction), swell);
        let origin = Point3::from(pose.translation.vector);
        let azimuth = std::f64::consts::PI - std::f64::consts::TAU * column as f64 / AZIMUTHS as f64;
        for beam in 0..BEAMS {
            let elevation = (-30.0 + beam as f64).to_radians();
            let ray = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let error = noise.sample(&mut random);
            let hit = scene.cast(&origin, &(pose.rotation * ray), 60.0);
            points.push(hit.map_or(Point::EMPTY, |hit| {
                let p = (ray * (hit.range + error)).cast::<f32>();
                Point { time: (fraction * 65535.0).round() as u16, ..Point::new(p.x, p.y, p.z) }
            }));
        }
    }
    points
}

/// The largest and the last error [m], and the last error [deg], over `frames` scans.
fn errors(config: &OdometryConfig, frames: usize, swell: f64, timed: bool) -> (f64, f64, f64) {
    let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let mut odometry = Odometry::new(config.clone()).unwrap();
    let end = |k: usize| 0.2 + INTERVAL_S * k as f64;
    let first = map_from_scanner(end(0), swell);
    let mut worst = 0.0_f64;
    let mut last = (0.0, 0.0);
    for k in 0..frames {
        let points = scan(&scene, end(k), swell, k as u64);
        let time = timed.then(|| FrameTime { end_s: end(k), duration_s: INTERVAL_S });
        let record: FrameRecord = odometry.register_frame(ScanView::unordered(&points), time, None);
        assert!(record.status.is_tracked(), "{k}: {record:?}");
        let error = (first.inverse() * map_from_scanner(end(k), swell)).inverse() * record.map_from_scanner;
        last = (error.translation.vector.norm(), rotation_angle(&error).to_degrees());
        worst = worst.max(last.0);
        println!(
            "{k} {:.3} m {:.3} deg score {:.3} it {} searched {} sigma {:.3}",
            last.0, last.1, record.score, record.iterations, record.searched, record.threshold_m
        );
    }
    (worst, last.0, last.1)
}

#[test]
fn deskewed_odometry_follows_a_fast_bend() {
    let config = OdometryConfig { threads: 2, max_range_m: 60.0, ..OdometryConfig::default() };
    let with = errors(&config, 20, 0.0, true);
    let without = errors(&OdometryConfig { deskew: false, ..config }, 20, 0.0, true);
    println!("with {with:?} without {without:?}");
    assert!(with.0 < 0.1 && with.2 < 0.3, "{with:?}");
    assert!(without.1 > 5.0 * with.1, "with {with:?}, without {without:?}");
}

#[test]
fn the_motion_found_deskews_better_than_the_one_predicted() {
    let config = OdometryConfig { threads: 2, max_range_m: 60.0, ..OdometryConfig::default() };
    let with = errors(&config, 20, 0.3, false);
    println!("with {with:?}");
    assert!(with.0 < 0.2 && with.2 < 0.5, "{with:?}");
}
