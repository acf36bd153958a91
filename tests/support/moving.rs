//! A recording of a spinning scanner in motion, cast ray by ray, each ray from where the scanner was when it was fired.

use std::path::Path;

use mirador_core::geometry::{Pose, Twist, exp};
use mirador_core::simulation::{CompiledScene, Scene};
use mirador_ipc_schema::messages::{Header, Point, ScanMeta};
use mirador_ipc_schema::{ScanId, topics};
use mirador_recorder::{RecorderConfig, RunWriter};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

const BEAMS: usize = 40;
const AZIMUTHS: usize = 720;
const INTERVAL_S: f64 = 0.1;

/// A building in a walled yard with a car, a shed and a pillar; the way around the building is free.
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
]
"#;

/// The motion of one scan: 10 m/s ahead, turning 45 degrees a second.
pub fn motion() -> Twist {
    Twist::new(10.0, 0.0, 0.0, 0.0, 0.0, 45_f64.to_radians()) * INTERVAL_S
}

/// Where the scanner is at a time, given in scans; circles the building.
pub fn map_from_scanner(scans: f64) -> Pose {
    let start = Pose::from_parts(Translation3::new(2.0, 2.0 - 12.7, 2.8), UnitQuaternion::identity());
    start * exp(&(motion() * scans))
}

/// Writes `scans` scans, one behind the other; scan k ends at time k + 1. Where every return truly is, by scan.
pub fn record(path: &Path, scans: u32) -> Vec<Vec<Point3<f64>>> {
    let scene = CompiledScene::new(Scene::from_toml(YARD, "yard").unwrap()).unwrap();
    let mut writer = RunWriter::create(path, &RecorderConfig::default()).unwrap();
    let mut truth = Vec::new();
    for scan in 0..scans {
        let (points, places) = cast(&scene, scan);
        let header = Header {
            id: ScanId { robot: 0, run: 1, scan }.pack(),
            stamp_ns: (f64::from(scan) * INTERVAL_S * 1e9) as i64,
            sequence: u64::from(scan),
            ..Header::default()
        };
        let meta = ScanMeta {
            header,
            rows: AZIMUTHS as u32,
            cols: BEAMS as u32,
            returns: places.len() as u32,
            duration_ns: (INTERVAL_S * 1e9) as u64,
            source_index: scan,
            range_max_m: 60.0,
            ..ScanMeta::default()
        };
        writer.record::<topics::Scan>(&meta, &points).unwrap();
        truth.push(places);
    }
    writer.finish().unwrap();
    truth
}

/// One scan, and where its returns are.
fn cast(scene: &CompiledScene, scan: u32) -> (Vec<Point>, Vec<Point3<f64>>) {
    let (mut points, mut places) = (Vec::new(), Vec::new());
    for azimuth in 0..AZIMUTHS {
        let fraction = azimuth as f64 / (AZIMUTHS - 1) as f64;
        let pose = map_from_scanner(f64::from(scan) + fraction);
        let angle = std::f64::consts::PI - std::f64::consts::TAU * azimuth as f64 / AZIMUTHS as f64;
        for beam in 0..BEAMS {
            let elevation = (-30.0 + beam as f64).to_radians();
            let ray = Vector3::new(elevation.cos() * angle.cos(), elevation.cos() * angle.sin(), elevation.sin());
            let hit = scene.cast(&Point3::from(pose.translation.vector), &(pose.rotation * ray), 60.0);
            let nan = f32::NAN;
            points.push(hit.map_or(Point { x: nan, y: nan, z: nan, intensity: 0, time: 0 }, |hit| {
                let seen = Point3::from(ray * hit.range);
                places.push(pose * seen);
                let time = (fraction * 65535.0).round() as u16;
                Point { x: seen.x as f32, y: seen.y as f32, z: seen.z as f32, intensity: 0, time }
            }));
        }
    }
    (points, places)
}
