//! Ultrasonic rangers: the nearest surface within a cone.

use nalgebra::{Point3, Rotation3, Vector3};

use super::config::RangerConfig;
use super::noise::Noise;
use crate::geometry::Pose;
use crate::simulation::compiled_scene::{CompiledScene, Viewpoint};

/// Rays of a cone: its axis and two rings.
const RINGS: [(usize, f64); 2] = [(6, 0.5), (12, 0.95)];
/// Sound comes back from surfaces that lie this square to it, cosine of incidence. Rough ground returns some at any
/// angle within the cone; walls seen obliquely throw it away.
const LEAST_COSINE: f64 = 0.25;

/// Where a ranger is and where it looks, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangerMount {
    /// Its place [m].
    pub position: Vector3<f64>,
    /// Yaw and pitch of its axis, pitch positive downwards [rad].
    pub yaw_pitch: [f64; 2],
}

/// A reading of one ranger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangerReading {
    /// Simulated time [s].
    pub time: f64,
    /// Which: 0 to 2 in front from left to right, 3 to 5 behind.
    pub sensor: usize,
    /// Range [m], NaN where nothing was heard.
    pub range: f64,
}

/// The six rangers.
#[derive(Debug, Clone)]
pub struct Rangers {
    config: RangerConfig,
    noise: Noise,
    mounts: Vec<RangerMount>,
    /// What each hears, and where the robot was.
    heard: Vec<Option<f64>>,
    heard_from: Option<Viewpoint>,
}

impl Rangers {
    /// Three in front and three behind.
    #[must_use]
    pub fn new(config: RangerConfig, noise: Noise) -> Self {
        let half_turn = std::f64::consts::PI;
        let mut mounts = Vec::new();
        for facing in [0.0, half_turn] {
            for side in [1.0, 0.0, -1.0] {
                let local = Vector3::new(config.ahead, side * config.apart, config.height);
                let position = Rotation3::from_axis_angle(&Vector3::z_axis(), facing) * local;
                let yaw = facing + side * config.outwards_deg.to_radians();
                mounts.push(RangerMount { position, yaw_pitch: [yaw, config.tilt_deg.to_radians()] });
            }
        }
        Self { config, noise, mounts, heard: Vec::new(), heard_from: None }
    }

    /// Where they are.
    #[must_use]
    pub fn mounts(&self) -> &[RangerMount] {
        &self.mounts
    }

    /// A reading of each.
    pub fn read(&mut self, time: f64, map_from_robot: &Pose, scene: &CompiledScene, out: &mut Vec<RangerReading>) {
        // A robot that stands hears what it has heard.
        let viewpoint = scene.viewpoint(map_from_robot);
        if self.heard_from != Some(viewpoint) {
            let listen = |mount| nearest_in_cone(scene, map_from_robot, mount, &self.config);
            (self.heard, self.heard_from) = (self.mounts.iter().map(listen).collect(), Some(viewpoint));
        }
        for (sensor, heard) in self.heard.iter().enumerate() {
            let error = self.noise.normal(self.config.sigma);
            let range = heard.map_or(f64::NAN, |range| (range + error).max(self.config.range[0]));
            out.push(RangerReading { time, sensor, range });
        }
    }
}

/// The range of the nearest surface in a cone that sends sound back.
fn nearest_in_cone(
    scene: &CompiledScene,
    map_from_robot: &Pose,
    mount: &RangerMount,
    config: &RangerConfig,
) -> Option<f64> {
    let [yaw, pitch] = mount.yaw_pitch;
    let turn = map_from_robot.rotation.to_rotation_matrix() * Rotation3::from_euler_angles(0.0, pitch, yaw);
    let half = config.aperture_deg.to_radians() / 2.0;
    let mut directions = vec![turn * Vector3::x()];
    for (rays, share) in RINGS {
        let (sin, cos) = (share * half).sin_cos();
        directions.extend((0..rays).map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / rays as f64;
            turn * Vector3::new(cos, sin * angle.cos(), sin * angle.sin())
        }));
    }
    let origin = map_from_robot * Point3::from(mount.position);
    let mut hits = vec![None; directions.len()];
    scene.cast_all(&origin, &directions, config.range[1], &mut hits);
    let heard = hits.iter().zip(&directions).filter_map(|(hit, direction)| {
        let hit = hit.as_ref()?;
        (scene.normal(hit).dot(direction).abs() >= LEAST_COSINE).then_some(hit.range)
    });
    heard.min_by(f64::total_cmp)
}
