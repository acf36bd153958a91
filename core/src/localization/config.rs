//! Settings of localisation.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::geometry::Pose;
use crate::registration::ConfigError;

/// Where the robot starts, how its scanner is fixed, and what its sensors are worth. The errors are those of the
/// simulated parts; a robot with others states its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalizationConfig {
    /// Where the robot stands at first, map frame [m], each -100,000 to 100,000.
    pub start_xyz: [f64; 3],
    /// Its heading there [deg], -360 to 360. Roll and pitch are felt by the accelerometers.
    pub start_yaw_deg: f64,
    /// Standard deviation of each coordinate of the start [m], 0.001 to 100.
    pub start_sigma_m: f64,
    /// Standard deviation of the heading at the start [deg], 0.01 to 180.
    pub start_yaw_sigma_deg: f64,
    /// Position of the scanner in the robot's frame [m], each -10 to 10.
    pub robot_from_scanner_xyz: [f64; 3],
    /// Roll, pitch and yaw of the scanner in the robot's frame [deg], each -360 to 360.
    pub robot_from_scanner_rpy_deg: [f64; 3],
    /// The inertial unit.
    pub imu: ImuModel,
    /// The wheels.
    pub wheels: WheelModel,
    /// A laser that looks level.
    pub laser: LaserModel,
    /// The satellite receiver.
    pub gnss: GnssModel,
    /// The magnetometer.
    pub magnetometer: MagnetometerModel,
    /// Poses of scans from alignment.
    pub scans: ScanPoseModel,
    /// When it does not know where it is.
    pub lost: LostConfig,
}

impl Default for LocalizationConfig {
    fn default() -> Self {
        Self {
            start_xyz: [0.0; 3],
            start_yaw_deg: 0.0,
            start_sigma_m: 0.02,
            start_yaw_sigma_deg: 0.5,
            robot_from_scanner_xyz: [0.0, 0.0, 1.0],
            robot_from_scanner_rpy_deg: [0.0; 3],
            imu: ImuModel::default(),
            wheels: WheelModel::default(),
            laser: LaserModel::default(),
            gnss: GnssModel::default(),
            magnetometer: MagnetometerModel::default(),
            scans: ScanPoseModel::default(),
            lost: LostConfig::default(),
        }
    }
}

/// Errors of gyroscopes and accelerometers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImuModel {
    /// Standard deviation of an acceleration [m/s^2], 1e-4 to 10. More than the accelerometers' own noise, as the attitude
    /// trembles between two readings.
    pub acceleration_sigma: f64,
    /// Standard deviation of its bias [m/s^2], 1e-5 to 10.
    pub acceleration_bias: f64,
    /// Standard deviation of an angular velocity [rad/s], 1e-5 to 1; again more than the gyroscopes' own noise.
    pub angular_sigma: f64,
    /// Standard deviation of its bias [rad/s], 1e-6 to 1.
    pub angular_bias: f64,
    /// Correlation time of both biases [s], 1 to 100,000.
    pub bias_correlation_s: f64,
    /// Gravity at the site [m/s^2], 9.7 to 9.9.
    pub gravity: f64,
    /// A longer time between two readings is a gap, over which the robot is taken to go on as it did [s], 0.02 to 1.
    pub gap_s: f64,
}

impl Default for ImuModel {
    fn default() -> Self {
        Self {
            acceleration_sigma: 0.2,
            acceleration_bias: 0.02,
            angular_sigma: 0.006,
            angular_bias: 0.0005,
            bias_correlation_s: 300.0,
            gravity: 9.81,
            gap_s: 0.1,
        }
    }
}

/// Errors of the wheels' odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WheelModel {
    /// Standard deviation of a forward speed [m/s], 0.001 to 1: what is not slip, mostly the width of an encoder's tick.
    pub sigma: f64,
    /// Standard deviation of the share by which the wheels go farther than the robot, 0 to 0.5.
    pub slip_sigma: f64,
    /// Time over which that share holds [s], 0.1 to 1,000.
    pub slip_correlation_s: f64,
    /// Standard deviation of a speed sideways or off the ground that each reading of the wheels excludes [m/s], 0.01 to 10.
    pub sideways_sigma: f64,
    /// The same for each rad/s that the robot turns, as skidding then has no fixed centre [m/rad], 0 to 10.
    pub turning_sigma: f64,
    /// The same for the forward speed: when one side of the robot skids more than the other, the robot goes forwards or backwards
    /// while it turns, and its wheels do not say so [m/rad], 0 to 10.
    pub turning_forward_sigma: f64,
    /// On a slope the robot slides: standard deviation of its position after a metre, for a slope of 45 degrees; it grows with
    /// the root of the way and the tangent of the slope [m], 0 to 10.
    pub slide_sigma_m: f64,
    /// On a slope a robot that turns slides downhill: by so much for each rad, times the sine of the slope [m/rad], 0 to 10.
    pub turning_slide_m: f64,
    /// The wheels are taken to stand after so long without a tick [s], 0.05 to 10.
    pub standing_s: f64,
    /// Standard deviation of the speed of a standing robot [m/s], 1e-4 to 1.
    pub standing_sigma: f64,
    /// A standing robot turns no faster than this [rad/s], 0.005 to 1.
    pub standing_turn: f64,
}

impl Default for WheelModel {
    fn default() -> Self {
        Self {
            sigma: 0.03,
            slip_sigma: 0.02,
            slip_correlation_s: 10.0,
            sideways_sigma: 0.15,
            turning_sigma: 0.3,
            turning_forward_sigma: 0.08,
            slide_sigma_m: 0.4,
            turning_slide_m: 0.8,
            standing_s: 0.3,
            standing_sigma: 0.01,
            standing_turn: 0.03,
        }
    }
}

/// A laser that looks level: what it sees of the surroundings tells how far the robot turns, and whether it goes where its wheels go.
/// For floors and streets: among hills what it sees is mostly ground, which seems to go along.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LaserModel {
    /// Whether its sweeps count.
    pub is_used: bool,
    /// Two sweeps are compared when so many of their points fit, 10 to 10,000,
    pub least_beams: u32,
    /// and this share of those that could, 0.1 to 1,
    pub least_share: f64,
    /// and fit so well, root mean square [m], 0.001 to 1,
    pub rms_max_m: f64,
    /// and, where the way is asked for, so tell it with no larger standard deviation than this in any direction [m], 0.001 to 1.
    pub sigma_max_m: f64,
    /// They are compared only while the robot leans by less than this [deg], 0.1 to 45.
    pub level_deg: f64,
    /// The robot is stuck where it lags behind its wheels by this share of their way, 0.1 to 1.
    pub slip_share: f64,
}

impl Default for LaserModel {
    fn default() -> Self {
        Self {
            is_used: true,
            least_beams: 40,
            least_share: 0.7,
            rms_max_m: 0.04,
            sigma_max_m: 0.015,
            level_deg: 2.0,
            slip_share: 0.5,
        }
    }
}

/// The satellite receiver, and how the map lies on the earth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GnssModel {
    /// Whether its positions and velocities count.
    pub is_used: bool,
    /// Latitude of the map's origin [deg], -90 to 90.
    pub latitude_deg: f64,
    /// Longitude of the map's origin [deg], -180 to 360.
    pub longitude_deg: f64,
    /// Height of the map's origin over the ellipsoid [m], -1,000 to 10,000.
    pub height: f64,
    /// Heading of the map's x axis from east towards north [deg], -360 to 360: `enu_from_map`.
    pub east_from_map_deg: f64,
    /// Position of the antenna in the robot's frame [m], each -10 to 10.
    pub antenna_xyz: [f64; 3],
    /// Standard deviation of the drifting part of a horizontal coordinate [m], 0.001 to 100; twice that upwards.
    pub drift_sigma: f64,
    /// Correlation time of the drift [s], 1 to 100,000.
    pub drift_correlation_s: f64,
    /// Standard deviation of the rest [m], 0.001 to 100; twice that upwards.
    pub noise_sigma: f64,
    /// Standard deviation of a velocity [m/s], 0.001 to 10.
    pub velocity_sigma: f64,
    /// A reading farther than this many standard deviations (as the square root of chi-square, three degrees of freedom)
    /// from what is expected does not count, 2 to 100.
    pub gate: f64,
}

impl Default for GnssModel {
    fn default() -> Self {
        Self {
            is_used: true,
            latitude_deg: 42.17,
            longitude_deg: -8.68,
            height: 460.0,
            east_from_map_deg: 0.0,
            antenna_xyz: [0.0, 0.0, 0.9],
            drift_sigma: 1.5,
            drift_correlation_s: 120.0,
            noise_sigma: 0.4,
            velocity_sigma: 0.15,
            gate: 4.0,
        }
    }
}

/// The magnetometer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MagnetometerModel {
    /// Whether its headings count.
    pub is_used: bool,
    /// Declination: magnetic north from true north towards east [deg], -180 to 180.
    pub declination_deg: f64,
    /// Standard deviation of one heading [deg], 0.1 to 90.
    pub sigma_deg: f64,
    /// Standard deviation of the part that the iron of robot and surroundings makes [deg], 0.1 to 90.
    pub iron_sigma_deg: f64,
    /// Time over which that part holds [s], 0.1 to 100,000; it changes as the robot turns.
    pub iron_correlation_s: f64,
    /// Only one reading in this time counts [s], 0 to 100.
    pub period_s: f64,
    /// A heading farther than this many standard deviations off does not count, 1 to 100.
    pub gate: f64,
}

impl Default for MagnetometerModel {
    fn default() -> Self {
        Self {
            is_used: true,
            declination_deg: -1.5,
            sigma_deg: 2.0,
            iron_sigma_deg: 4.0,
            iron_correlation_s: 20.0,
            period_s: 0.2,
            gate: 3.0,
        }
    }
}

/// Poses of scans from alignment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanPoseModel {
    /// Standard deviation added to that of each coordinate [m], 0 to 10: registration is surer of itself than it should be.
    pub extra_sigma_m: f64,
    /// The same of each rotation [deg], 0 to 45.
    pub extra_sigma_deg: f64,
    /// A pose farther off than this many standard deviations (six degrees of freedom) moves the estimate there, as
    /// alignment has checked it against the map, 3 to 1,000.
    pub gate: f64,
}

impl Default for ScanPoseModel {
    fn default() -> Self {
        Self { extra_sigma_m: 0.01, extra_sigma_deg: 0.1, gate: 5.0 }
    }
}

/// When localisation says that it does not know where the robot is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LostConfig {
    /// Largest standard deviation of a horizontal position [m], 0.05 to 1,000.
    pub position_sigma_m: f64,
    /// Largest standard deviation of the heading [deg], 0.5 to 180.
    pub yaw_sigma_deg: f64,
    /// A sensor may contradict the estimate for so long [s], 1 to 1,000.
    pub contradiction_s: f64,
    /// Inertial unit and wheels may be silent for so long [s], 0.1 to 10.
    pub silence_s: f64,
    /// A robot that leans farther than this has tipped over [deg], 20 to 90.
    pub tipped_deg: f64,
}

impl Default for LostConfig {
    fn default() -> Self {
        Self { position_sigma_m: 2.0, yaw_sigma_deg: 15.0, contradiction_s: 15.0, silence_s: 0.5, tipped_deg: 50.0 }
    }
}

impl LocalizationConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first field that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        for (field, value, least, most) in self.bounds() {
            ConfigError::check(field, value, least, most)?;
        }
        let vectors: [(&'static str, &[f64; 3], f64); 4] = [
            ("start_xyz", &self.start_xyz, 1e5),
            ("robot_from_scanner_xyz", &self.robot_from_scanner_xyz, 10.0),
            ("robot_from_scanner_rpy_deg", &self.robot_from_scanner_rpy_deg, 360.0),
            ("gnss.antenna_xyz", &self.gnss.antenna_xyz, 10.0),
        ];
        for (field, values, most) in vectors {
            for value in values {
                ConfigError::check(field, *value, -most, most)?;
            }
        }
        Ok(())
    }

    /// Every number: field, value, least, greatest.
    fn bounds(&self) -> impl Iterator<Item = (&'static str, f64, f64, f64)> {
        let (imu, wheels, gnss) = (&self.imu, &self.wheels, &self.gnss);
        let (magnetometer, scans, lost) = (&self.magnetometer, &self.scans, &self.lost);
        [
            ("start_yaw_deg", self.start_yaw_deg, -360.0, 360.0),
            ("start_sigma_m", self.start_sigma_m, 1e-3, 100.0),
            ("start_yaw_sigma_deg", self.start_yaw_sigma_deg, 0.01, 180.0),
            ("imu.acceleration_sigma", imu.acceleration_sigma, 1e-4, 10.0),
            ("imu.acceleration_bias", imu.acceleration_bias, 1e-5, 10.0),
            ("imu.angular_sigma", imu.angular_sigma, 1e-5, 1.0),
            ("imu.angular_bias", imu.angular_bias, 1e-6, 1.0),
            ("imu.bias_correlation_s", imu.bias_correlation_s, 1.0, 1e5),
            ("imu.gravity", imu.gravity, 9.7, 9.9),
            ("imu.gap_s", imu.gap_s, 0.02, 1.0),
            ("wheels.sigma", wheels.sigma, 1e-3, 1.0),
            ("wheels.slip_sigma", wheels.slip_sigma, 0.0, 0.5),
            ("wheels.slip_correlation_s", wheels.slip_correlation_s, 0.1, 1e3),
            ("wheels.sideways_sigma", wheels.sideways_sigma, 0.01, 10.0),
            ("wheels.turning_sigma", wheels.turning_sigma, 0.0, 10.0),
            ("wheels.turning_forward_sigma", wheels.turning_forward_sigma, 0.0, 10.0),
            ("wheels.standing_s", wheels.standing_s, 0.05, 10.0),
            ("wheels.standing_sigma", wheels.standing_sigma, 1e-4, 1.0),
            ("wheels.slide_sigma_m", wheels.slide_sigma_m, 0.0, 10.0),
            ("wheels.turning_slide_m", wheels.turning_slide_m, 0.0, 10.0),
            ("wheels.standing_turn", wheels.standing_turn, 0.005, 1.0),
            ("laser.least_beams", f64::from(self.laser.least_beams), 10.0, 1e4),
            ("laser.least_share", self.laser.least_share, 0.1, 1.0),
            ("laser.rms_max_m", self.laser.rms_max_m, 1e-3, 1.0),
            ("laser.sigma_max_m", self.laser.sigma_max_m, 1e-3, 1.0),
            ("laser.level_deg", self.laser.level_deg, 0.1, 45.0),
            ("laser.slip_share", self.laser.slip_share, 0.1, 1.0),
            ("gnss.latitude_deg", gnss.latitude_deg, -90.0, 90.0),
            ("gnss.longitude_deg", gnss.longitude_deg, -180.0, 360.0),
            ("gnss.height", gnss.height, -1e3, 1e4),
            ("gnss.east_from_map_deg", gnss.east_from_map_deg, -360.0, 360.0),
            ("gnss.drift_sigma", gnss.drift_sigma, 1e-3, 100.0),
            ("gnss.drift_correlation_s", gnss.drift_correlation_s, 1.0, 1e5),
            ("gnss.noise_sigma", gnss.noise_sigma, 1e-3, 100.0),
            ("gnss.velocity_sigma", gnss.velocity_sigma, 1e-3, 10.0),
            ("gnss.gate", gnss.gate, 2.0, 100.0),
            ("magnetometer.declination_deg", magnetometer.declination_deg, -180.0, 180.0),
            ("magnetometer.sigma_deg", magnetometer.sigma_deg, 0.1, 90.0),
            ("magnetometer.iron_sigma_deg", magnetometer.iron_sigma_deg, 0.1, 90.0),
            ("magnetometer.iron_correlation_s", magnetometer.iron_correlation_s, 0.1, 1e5),
            ("magnetometer.period_s", magnetometer.period_s, 0.0, 100.0),
            ("magnetometer.gate", magnetometer.gate, 1.0, 100.0),
            ("scans.extra_sigma_m", scans.extra_sigma_m, 0.0, 10.0),
            ("scans.extra_sigma_deg", scans.extra_sigma_deg, 0.0, 45.0),
            ("scans.gate", scans.gate, 3.0, 1e3),
            ("lost.position_sigma_m", lost.position_sigma_m, 0.05, 1e3),
            ("lost.yaw_sigma_deg", lost.yaw_sigma_deg, 0.5, 180.0),
            ("lost.contradiction_s", lost.contradiction_s, 1.0, 1e3),
            ("lost.silence_s", lost.silence_s, 0.1, 10.0),
            ("lost.tipped_deg", lost.tipped_deg, 20.0, 90.0),
        ]
        .into_iter()
    }

    /// The mount of the scanner.
    #[must_use]
    pub fn robot_from_scanner(&self) -> Pose {
        let [roll, pitch, yaw] = self.robot_from_scanner_rpy_deg.map(f64::to_radians);
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Pose::from_parts(Translation3::from(self.robot_from_scanner_xyz), rotation)
    }

    /// Where the robot starts, upright.
    #[must_use]
    pub fn map_from_start(&self) -> Pose {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.start_yaw_deg.to_radians());
        Pose::from_parts(Translation3::from(self.start_xyz), yaw)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid() {
        LocalizationConfig::default().validate().unwrap();
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let mut config = LocalizationConfig::default();
        config.gnss.gate = f64::NAN;
        assert!(config.validate().unwrap_err().to_string().starts_with("gnss.gate = NaN is out of range"));
        let config = LocalizationConfig { start_xyz: [0.0, 1e9, 0.0], ..LocalizationConfig::default() };
        assert!(config.validate().unwrap_err().to_string().starts_with("start_xyz = 1000000000"));
    }

    #[test]
    fn a_misspelt_key_is_refused() {
        let error = toml::from_str::<LocalizationConfig>("[gnss]\nlattitude_deg = 3").unwrap_err().to_string();
        assert!(error.contains("lattitude_deg"), "{error}");
    }
}
