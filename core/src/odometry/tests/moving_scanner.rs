//! Scans of a spinning scanner in motion, cast ray by ray, each ray from where the scanner was when it was fired.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal};

use crate::geometry::{Pose, Twist, exp, rotation_angle};
use crate::odometry::{FrameRecord, FrameStatus, FrameTime, Odometry, OdometryConfig};
use crate::scan::{Point, ScanView};
use crate::simulation::{CompiledScene, Scene};

const BEAMS: usize = 40;
const AZIMUTHS: usize = 720;
const INTERVAL_S: f64 = 0.1;

/// A building in a walled yard with a car, a shed and two pillars; the way around the building is free.
const YARD: &str = r#"
name = "yard"
start = { x_m = 0, y_m = 0 }
area = { x_m = [-20, 24], y_m = [-20, 24] }
terrain = { cell_m = 0.5, margin_m = 10, waves = [{ amplitude_m = 0.1, wavelength_m = 9, heading_deg = 30 }] }
box = [
    { label = "building", x_m = 2, y_m = 2, yaw_deg = 20, length_m = 9, width_m = 6, height_m = 5 },
    { label = "wall", x_m = 2, y_m = -15, yaw_deg = 4, length_m = 26, width_m = 0.4, height_m = 3 },
    { label = "wall", x_m = 20, y_m = 3, yaw_deg = 90, length_m = 22, width_m = 0.4, height_m = 4 },
    { label = "wall", x_m = -4, y_m = 19, length_m = 24, width_m = 0.4, height_m = 3 },
    { label = "wall", x_m = -15, y_m = 2, yaw_deg = 80, length_m = 16, width_m = 0.4, height_m = 5 },
    { label = "vehicle", x_m = 11, y_m = -12, yaw_deg = 30, length_m = 4, width_m = 1.8, height_m = 1.6 },
    { label = "building", x_m = -11, y_m = -12, yaw_deg = 50, length_m = 4, width_m = 3, height_m = 3 },
    { label = "other", x_m = 16, y_m = 17, length_m = 1, width_m = 1, height_m = 5 },
    { label = "other", x_m = 17.5, y_m = -8, length_m = 0.8, width_m = 0.8, height_m = 5 },
]
"#;

/// Circles the building: 10 m/s ahead, turning 45 degrees a second, 12.7 m from its middle, with a speed that swells by
/// `swell` twice a second.
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

/// What became of a drive.
struct Drive {
    records: Vec<FrameRecord>,
    /// Greatest error of a position [m].
    worst_m: f64,
    /// Error of the last pose [m], [deg].
    last_m: f64,
    last_deg: f64,
}

fn drive(scene: &CompiledScene, config: &OdometryConfig, swell: f64, timed: bool) -> Drive {
    let mut odometry = Odometry::new(config.clone()).unwrap();
    let end = |k: usize| 0.2 + INTERVAL_S * k as f64;
    let first = map_from_scanner(end(0), swell);
    let mut drive = Drive { records: Vec::new(), worst_m: 0.0, last_m: 0.0, last_deg: 0.0 };
    for k in 0..20 {
        let points = scan(scene, end(k), swell, k as u64);
        let time = timed.then(|| FrameTime { end_s: end(k), duration_s: INTERVAL_S });
        let record = odometry.register_frame(ScanView::unordered(&points), time, None);
        assert!(record.status.is_tracked(), "{k}: {record:?}");
        let error = (first.inverse() * map_from_scanner(end(k), swell)).inverse() * record.map_from_scanner;
        drive.last_m = error.translation.vector.norm();
        drive.last_deg = rotation_angle(&error).to_degrees();
        drive.worst_m = drive.worst_m.max(drive.last_m);
        drive.records.push(record);
    }
    println!("swell {swell} {}: {:.3} m {:.3} m {:.3} deg", config.deskew, drive.worst_m, drive.last_m, drive.last_deg);
    drive
}

fn yard() -> CompiledScene {
    CompiledScene::new(Scene::from_toml(YARD, "yard").unwrap()).unwrap()
}

fn config() -> OdometryConfig {
    OdometryConfig { threads: 2, max_range_m: 60.0, ..OdometryConfig::default() }
}

#[test]
fn deskewed_odometry_follows_a_fast_bend() {
    let scene = yard();
    let with = drive(&scene, &config(), 0.0, true);
    let without = drive(&scene, &OdometryConfig { deskew: false, ..config() }, 0.0, true);
    // Over 19 m and 86 degrees of arc.
    assert!(with.worst_m < 0.02 && with.last_deg < 0.05, "{} m {} deg", with.worst_m, with.last_deg);
    assert!(without.last_m > 5.0 * with.last_m, "with {} m, without {} m", with.last_m, without.last_m);
}

#[test]
fn the_motion_that_was_found_deskews_where_the_speed_swells() {
    let with = drive(&yard(), &config(), 0.3, false);
    // The speed changes by up to 38 m/s^2. The first scan is deskewed by the motion of the second, up to 0.38 m more or
    // less than its own, until the map is made of later ones.
    assert!(with.worst_m < 0.38, "{} m", with.worst_m);
    assert!(with.last_m < 0.05 && with.last_deg < 0.1, "{} m {} deg", with.last_m, with.last_deg);
}

#[test]
fn a_scene_that_is_nearly_all_ground_is_flagged() {
    let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let records = drive(&scene, &config(), 0.0, true).records;
    let flagged = records.iter().filter(|record| record.status == FrameStatus::UnderConstrained).count();
    assert!(flagged >= 15, "{flagged}");
}
