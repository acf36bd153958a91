//! Rates and errors of the robot's sensors. The defaults are those of the parts the source's robot carries: wheel
//! encoders, a MEMS inertial unit with satellite receiver and magnetometer (MTi-G), ultrasonic rangers.

use serde::{Deserialize, Serialize};

/// All sensors of a robot but its lasers and cameras.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorsConfig {
    /// Wheel encoders.
    pub odometry: OdometryConfig,
    /// Gyroscopes and accelerometers.
    pub imu: ImuConfig,
    /// Satellite receiver.
    pub gnss: GnssConfig,
    /// Magnetometer.
    pub magnetometer: MagnetometerConfig,
    /// Ultrasonic rangers.
    pub rangers: RangerConfig,
    /// Battery.
    pub battery: BatteryConfig,
}

/// Odometry of the driven wheels. It believes that they do not slip; that they do is not an error drawn here but
/// happens in the physics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryConfig {
    /// Time between readings [s].
    pub period: f64,
    /// Distance rolled a tick of the encoders [m].
    pub tick: f64,
    /// Distance of the left from the right wheels that turning is computed with [m]. For a skidding robot it is larger
    /// than the true one, 0.72 m: on level ground the default is what the usual robot turns by.
    pub track: f64,
}

impl Default for OdometryConfig {
    fn default() -> Self {
        Self { period: 0.02, tick: 0.001, track: 1.03 }
    }
}

/// The inertial unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImuConfig {
    /// Time between readings [s].
    pub period: f64,
    /// Standard deviation of an acceleration [m/s^2].
    pub acceleration_sigma: f64,
    /// Standard deviation of its bias [m/s^2], which drifts with `bias_correlation`.
    pub acceleration_bias: f64,
    /// Standard deviation of an angular velocity [rad/s].
    pub angular_sigma: f64,
    /// Standard deviation of its bias [rad/s].
    pub angular_bias: f64,
    /// Correlation time of both biases [s].
    pub bias_correlation: f64,
}

impl Default for ImuConfig {
    fn default() -> Self {
        Self {
            period: 0.01,
            acceleration_sigma: 0.02,
            acceleration_bias: 0.02,
            angular_sigma: 0.005,
            angular_bias: 0.0005,
            bias_correlation: 300.0,
        }
    }
}

/// The satellite receiver.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GnssConfig {
    /// Time between readings [s].
    pub period: f64,
    /// Latitude of the map's origin [deg].
    pub latitude_deg: f64,
    /// Longitude of the map's origin [deg].
    pub longitude_deg: f64,
    /// Height of the map's origin over the ellipsoid [m].
    pub height: f64,
    /// Heading of the map's x axis from east towards north [deg].
    pub east_from_map_deg: f64,
    /// Standard deviation of the drifting part of a horizontal coordinate [m]; twice that upwards.
    pub drift_sigma: f64,
    /// Correlation time of the drift [s].
    pub drift_correlation: f64,
    /// Standard deviation of the rest [m].
    pub noise_sigma: f64,
    /// Standard deviation of a velocity [m/s].
    pub velocity_sigma: f64,
    /// Mean time between outages [s]; 0 means none.
    pub outage_every: f64,
    /// Mean length of an outage [s].
    pub outage_length: f64,
    /// There is no fix where less of the sky than this share is free.
    pub least_sky: f64,
}

impl Default for GnssConfig {
    fn default() -> Self {
        Self {
            period: 0.25,
            latitude_deg: 42.17,
            longitude_deg: -8.68,
            height: 460.0,
            east_from_map_deg: 0.0,
            drift_sigma: 1.5,
            drift_correlation: 120.0,
            noise_sigma: 0.3,
            velocity_sigma: 0.1,
            outage_every: 180.0,
            outage_length: 15.0,
            least_sky: 0.35,
        }
    }
}

/// The magnetometer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MagnetometerConfig {
    /// Time between readings [s].
    pub period: f64,
    /// Horizontal part of the earth's field, towards magnetic north [T].
    pub horizontal: f64,
    /// Its part downwards [T].
    pub down: f64,
    /// Declination: magnetic north from true north towards east [deg].
    pub declination_deg: f64,
    /// Standard deviation of a component [T].
    pub sigma: f64,
    /// Standard deviation of a constant error fixed to the robot (iron and motors) [T].
    pub bias: f64,
}

impl Default for MagnetometerConfig {
    fn default() -> Self {
        Self { period: 0.02, horizontal: 24e-6, down: 38e-6, declination_deg: -1.5, sigma: 0.2e-6, bias: 0.6e-6 }
    }
}

/// The ultrasonic rangers: three at each end, tilted to the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RangerConfig {
    /// Time between readings of all [s].
    pub period: f64,
    /// Height of the mounts over the ground [m].
    pub height: f64,
    /// Distance of the mounts from the middle of the robot [m].
    pub ahead: f64,
    /// Distance of the outer mounts from the middle one [m].
    pub apart: f64,
    /// How far they look down [deg].
    pub tilt_deg: f64,
    /// How far the outer ones look outwards [deg].
    pub outwards_deg: f64,
    /// Opening angle of their cone [deg].
    pub aperture_deg: f64,
    /// Nearest and farthest range [m].
    pub range: [f64; 2],
    /// Standard deviation of a range [m].
    pub sigma: f64,
}

impl Default for RangerConfig {
    fn default() -> Self {
        Self {
            period: 0.1,
            height: 0.36,
            ahead: 0.52,
            apart: 0.25,
            tilt_deg: 25.0,
            outwards_deg: 20.0,
            aperture_deg: 20.0,
            range: [0.05, 3.0],
            sigma: 0.01,
        }
    }
}

/// The battery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BatteryConfig {
    /// Time between readings [s].
    pub period: f64,
    /// Energy when full [J].
    pub capacity: f64,
    /// Voltage when full and when empty, without load [V].
    pub voltage: [f64; 2],
    /// Resistance within [ohm].
    pub resistance: f64,
    /// What computers and sensors draw [W].
    pub idle_power: f64,
    /// Share of the electrical power that the motors turn into motion.
    pub efficiency: f64,
    /// Below this charge the robot must stop.
    pub low: f64,
}

impl Default for BatteryConfig {
    fn default() -> Self {
        // Two lead-acid batteries of 12 V and 40 A h.
        Self {
            period: 1.0,
            capacity: 24.0 * 40.0 * 3600.0,
            voltage: [25.6, 23.2],
            resistance: 0.04,
            idle_power: 90.0,
            efficiency: 0.6,
            low: 0.15,
        }
    }
}
