//! Robots as a world file describes them: body, wheels, sensors.
//!
//! The robot's frame has its origin on the ground under the middle of the robot, x ahead, y to the left, z up.

use std::sync::Arc;

use nalgebra::{Translation3, UnitQuaternion};

use super::model::Mesh;
use super::scanner_config::ScannerConfig;
use super::scene::ScanPose;
use crate::geometry::Pose;

/// What a wheel can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WheelKind {
    /// Type 1: turns freely about its axle.
    Free,
    /// Type 2: a caster, turns freely about its axle and about z.
    Caster,
    /// Type 3: a motor turns it about its axle.
    Driven,
    /// Type 4: as driven, and another motor turns it about z.
    Steered,
}

/// A wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheel {
    /// What it can do.
    pub kind: WheelKind,
    /// Its radius [m].
    pub radius: f64,
    /// Along its axle [m].
    pub width: f64,
    /// Its middle in the robot's frame [m]; a caster's middle trails behind this by half its radius.
    pub mount: [f64; 3],
}

/// A cuboid of the body, upright in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyBox {
    /// Along x, y and z [m].
    pub size: [f64; 3],
    /// Its middle in the robot's frame [m].
    pub centre: [f64; 3],
}

/// What a sensor measures.
#[derive(Debug, Clone, PartialEq)]
pub enum SensorKind {
    /// An image; looks along its x axis.
    Camera {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Horizontal field of view [rad].
        field_of_view: f64,
    },
    /// One range along the sensor's x axis.
    Laser1d {
        /// Longest range [m].
        range: f64,
        /// Standard deviation of a range [m].
        noise: f64,
    },
    /// Ranges in the sensor's x-y plane, from the right to the left.
    Laser2d {
        /// Longest range [m].
        range: f64,
        /// Standard deviation of a range [m].
        noise: f64,
        /// Angle from beam to beam [rad].
        resolution: f64,
        /// Angle from the first to the last beam, symmetric about x [rad].
        field_of_view: f64,
    },
    /// A planar laser whose plane is upright and turns about the sensor's z axis.
    Laser3d(Box<ScannerConfig>),
}

/// A sensor and where it is fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Its name, unique on the robot.
    pub name: String,
    /// Position [m] in the robot's frame.
    pub position: [f64; 3],
    /// Roll, pitch and yaw in the robot's frame [rad].
    pub rotation: [f64; 3],
    /// What it measures.
    pub kind: SensorKind,
}

/// A robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Its name, unique in the world.
    pub name: String,
    /// Where it starts.
    pub start: ScanPose,
    /// The solids of its body.
    pub boxes: Vec<BodyBox>,
    /// A mesh instead of, or besides, the boxes; its convex hull is what touches things.
    pub mesh: Option<Arc<Mesh>>,
    /// Of all but the wheels [kg].
    pub mass: f64,
    /// Height of the centre of that mass in the robot's frame [m].
    pub mass_height: f64,
    /// Its wheels.
    pub wheels: Vec<Wheel>,
    /// Its sensors.
    pub sensors: Vec<Sensor>,
    /// Fastest speed of a wheel's rim [m/s].
    pub max_speed: f64,
    /// Line of the world file that describes it, 0 when none does.
    pub line: usize,
}

impl Sensor {
    /// The pose `robot_from_sensor`.
    #[must_use]
    pub fn robot_from_sensor(&self) -> Pose {
        let [roll, pitch, yaw] = self.rotation;
        Pose::from_parts(Translation3::from(self.position), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }
}

impl Default for Robot {
    /// The source's robot (section 1): six driven wheels, skid steering; 1.04 m long, 0.85 m wide, 0.21 m clearance, the
    /// deck at 0.38 m, 1 m tall with the scanner. Wheels of 0.165 m radius fit its length, a centimetre behind the
    /// body's ends, so that it runs against walls with its body; 90 kg are assumed.
    fn default() -> Self {
        let wheel = |x, y| Wheel { kind: WheelKind::Driven, radius: 0.165, width: 0.13, mount: [x, y, 0.165] };
        let wheels = [0.345, 0.0, -0.345].into_iter().flat_map(|x| [wheel(x, 0.36), wheel(x, -0.36)]).collect();
        let front = SensorKind::Laser2d {
            range: 32.0,
            noise: 0.015,
            resolution: 0.5_f64.to_radians(),
            field_of_view: std::f64::consts::PI,
        };
        let camera = SensorKind::Camera { width: 640, height: 480, field_of_view: 1.0 };
        let sensor = |name: &str, position, kind| Sensor { name: name.into(), position, rotation: [0.0; 3], kind };
        Self {
            name: "robot".into(),
            start: ScanPose { x: 0.0, y: 0.0, yaw: 0.0 },
            boxes: vec![
                BodyBox { size: [1.04, 0.59, 0.17], centre: [0.0, 0.0, 0.295] },
                BodyBox { size: [0.2, 0.2, 0.62], centre: [0.0, 0.0, 0.69] },
            ],
            mesh: None,
            mass: 90.0,
            mass_height: 0.3,
            wheels,
            sensors: vec![
                sensor("scanner", [0.0, 0.0, 1.0], SensorKind::Laser3d(Box::new(ScannerConfig::lms111()))),
                sensor("front", [0.5, 0.0, 0.42], front),
                sensor("camera", [0.45, 0.0, 0.5], camera),
            ],
            max_speed: 1.5,
            line: 0,
        }
    }
}
