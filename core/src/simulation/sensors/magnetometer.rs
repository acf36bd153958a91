//! The magnetometer.

use nalgebra::{Rotation3, Vector3};

use super::config::MagnetometerConfig;
use super::noise::Noise;
use crate::simulation::physics::Motion;

/// A reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MagnetometerReading {
    /// Simulated time [s].
    pub time: f64,
    /// Field, robot frame [T].
    pub field: Vector3<f64>,
}

/// The earth's field, with noise and the constant field of the robot itself.
#[derive(Debug, Clone)]
pub struct Magnetometer {
    config: MagnetometerConfig,
    noise: Noise,
    bias: Vector3<f64>,
    field: Vector3<f64>,
}

impl Magnetometer {
    /// `east_from_map` is the heading of the map's x axis from east towards north [rad].
    #[must_use]
    pub fn new(config: MagnetometerConfig, east_from_map: f64, mut noise: Noise) -> Self {
        let bias = noise.normal3(config.bias);
        let (sin, cos) = config.declination_deg.to_radians().sin_cos();
        let east_north_up = Vector3::new(config.horizontal * sin, config.horizontal * cos, -config.down);
        let field = Rotation3::from_axis_angle(&Vector3::z_axis(), -east_from_map) * east_north_up;
        Self { config, noise, bias, field }
    }

    /// The next reading.
    pub fn read(&mut self, time: f64, motion: &Motion) -> MagnetometerReading {
        let field = motion.pose.rotation.inverse() * self.field + self.bias + self.noise.normal3(self.config.sigma);
        MagnetometerReading { time, field }
    }
}
