//! What the simulated robot's sensors say, as plain values: drawn from the truth, seeded, in simulated time.

mod battery;
mod config;
mod gnss;
mod imu;
mod magnetometer;
mod noise;
mod odometry;
mod planar_laser;
mod rangers;
mod sweeps_ahead;
#[cfg(test)]
mod tests;
mod turning_laser;

pub use battery::{Battery, BatteryReading};
pub use config::{
    BatteryConfig, GnssConfig, ImuConfig, MagnetometerConfig, OdometryConfig, RangerConfig, SensorsConfig,
};
pub use gnss::{Gnss, GnssReading};
pub use imu::{Imu, ImuReading};
pub use magnetometer::{Magnetometer, MagnetometerReading};
pub use noise::Noise;
pub use odometry::{OdometryReading, WheelOdometry};
pub use planar_laser::{LaserBeam, PlanarLaser};
pub use rangers::{RangerMount, RangerReading, Rangers};
pub use turning_laser::{EncoderTick, LaserSweep, TurningLaser, TurningLaserError};
