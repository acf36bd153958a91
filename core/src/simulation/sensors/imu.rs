//! The inertial unit.

use nalgebra::{UnitQuaternion, Vector3};

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
    last: Option<Before>,
}

/// The robot at the reading before.
#[derive(Debug, Clone, Copy)]
struct Before {
    time: f64,
    velocity: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
}

impl Imu {
    /// Draws the first bias.
    #[must_use]
    pub fn new(config: ImuConfig, mut noise: Noise) -> Self {
        let acceleration_bias = noise.normal3(config.acceleration_bias);
        let angular_bias = noise.normal3(config.angular_bias);
        Self { config, noise, acceleration_bias, angular_bias, last: None }
    }

    /// The next reading: the means since the one before, as parts that integrate give them. Between two readings a skidding robot
    /// trembles; what it turns and how its speed changes all the same is in what they say.
    pub fn read(&mut self, time: f64, motion: &Motion) -> ImuReading {
        let (config, noise) = (&self.config, &mut self.noise);
        let rotation = motion.pose.rotation;
        let before = self.last.filter(|before| time > before.time);
        let mean = |change: Vector3<f64>, before: &Before| change / (time - before.time);
        let acceleration = before.map_or_else(Vector3::zeros, |b| mean(motion.linear - b.velocity, &b));
        let angular = before.map_or(motion.angular, |b| mean((b.rotation.inverse() * rotation).scaled_axis(), &b));
        self.last = Some(Before { time, velocity: motion.linear, rotation });
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
            angular_velocity: angular + self.angular_bias + noise.normal3(config.angular_sigma),
        }
    }
}
