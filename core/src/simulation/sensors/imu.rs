//! The inertial unit.

use nalgebra::Vector3;

use super::config::ImuConfig;
use super::noise::Noise;
use crate::simulation::physics::Motion;

/// Gravity as the accelerometers feel it at rest, upwards [m/s^2].
const GRAVITY: f64 = 9.81;

/// A reading, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuReading {
    /// Simulated time [s].
    pub time: f64,
    /// Acceleration against free fall: at rest and level (0, 0, 9.81) [m/s^2].
    pub acceleration: Vector3<f64>,
    /// Angular velocity [rad/s].
    pub angular_velocity: Vector3<f64>,
}

/// Gyroscopes and accelerometers at the robot's origin, with noise and drifting bias.
#[derive(Debug, Clone)]
pub struct Imu {
    config: ImuConfig,
    noise: Noise,
    acceleration_bias: Vector3<f64>,
    angular_bias: Vector3<f64>,
    last: Option<(f64, Vector3<f64>)>,
}

impl Imu {
    /// Draws the first bias.
    #[must_use]
    pub fn new(config: ImuConfig, mut noise: Noise) -> Self {
        let acceleration_bias = noise.normal3(config.acceleration_bias);
        let angular_bias = noise.normal3(config.angular_bias);
        Self { config, noise, acceleration_bias, angular_bias, last: None }
    }

    /// The next reading: the mean acceleration since the one before.
    pub fn read(&mut self, time: f64, motion: &Motion) -> ImuReading {
        let (config, noise) = (&self.config, &mut self.noise);
        let acceleration = match self.last {
            Some((before, velocity)) if time > before => (motion.linear - velocity) / (time - before),
            _ => Vector3::zeros(),
        };
        self.last = Some((time, motion.linear));
        let correlation = config.bias_correlation;
        for bias in self.acceleration_bias.iter_mut() {
            *bias = noise.drift(*bias, config.acceleration_bias, correlation, config.period);
        }
        for bias in self.angular_bias.iter_mut() {
            *bias = noise.drift(*bias, config.angular_bias, correlation, config.period);
        }
        let felt = motion.pose.rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, GRAVITY));
        ImuReading {
            time,
            acceleration: felt + self.acceleration_bias + noise.normal3(config.acceleration_sigma),
            angular_velocity: motion.angular + self.angular_bias + noise.normal3(config.angular_sigma),
        }
    }
}
