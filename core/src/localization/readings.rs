//! What the sensors say, as the filter takes it. Stamps are nanoseconds of one clock.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::geometry::Pose;

/// Inertial unit, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Time at the end of the interval it is the mean of [ns].
    pub stamp_ns: i64,
    /// Acceleration against free fall [m/s^2].
    pub acceleration: Vector3<f64>,
    /// Angular velocity [rad/s].
    pub angular_velocity: Vector3<f64>,
}

/// Wheel odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelSample {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Forward speed [m/s].
    pub linear: f64,
    /// Turning speed about z [rad/s]; of a skidding robot only good to tell standing from turning.
    pub angular: f64,
}

/// Satellite receiver, with a fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssSample {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Latitude [rad].
    pub latitude: f64,
    /// Longitude [rad].
    pub longitude: f64,
    /// Height over the ellipsoid [m].
    pub height: f64,
    /// Velocity east, north, up [m/s].
    pub velocity: Vector3<f64>,
    /// What the receiver says of its own errors east, north and up [m].
    pub sigma: Vector3<f64>,
}

/// Magnetic field, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MagneticSample {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Field [T].
    pub field: Vector3<f64>,
}

/// A sweep of a laser that looks level.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSample {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Angle of the first beam, anticlockwise from straight ahead [rad].
    pub first_angle: f64,
    /// Angle between two beams [rad].
    pub angle_step: f64,
    /// Position in the robot's frame [m].
    pub mount_xyz: [f64; 3],
    /// Yaw in the robot's frame [rad].
    pub mount_yaw: f64,
    /// Ranges [m], NaN without a return.
    pub ranges: Vec<f32>,
}

impl SweepSample {
    pub(super) fn robot_from_laser(&self) -> Pose {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.mount_yaw);
        Pose::from_parts(Translation3::from(self.mount_xyz), yaw)
    }
}

/// Any of them.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Reading {
    Imu(ImuSample),
    Wheels(WheelSample),
    Gnss(GnssSample),
    Magnetic(MagneticSample),
    Sweep(SweepSample),
}

impl Reading {
    pub fn stamp_ns(&self) -> i64 {
        match self {
            Self::Imu(sample) => sample.stamp_ns,
            Self::Wheels(sample) => sample.stamp_ns,
            Self::Gnss(sample) => sample.stamp_ns,
            Self::Magnetic(sample) => sample.stamp_ns,
            Self::Sweep(sample) => sample.stamp_ns,
        }
    }

    /// Number of the sensor; at equal stamps the lower one counts first, so that predictions come before corrections.
    pub fn sensor(&self) -> usize {
        match self {
            Self::Imu(_) => 0,
            Self::Wheels(_) => 1,
            Self::Gnss(_) => 2,
            Self::Magnetic(_) => 3,
            Self::Sweep(_) => 4,
        }
    }

    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        match self {
            Self::Imu(s) => finite(&s.acceleration) && finite(&s.angular_velocity),
            Self::Wheels(s) => s.linear.is_finite() && s.angular.is_finite(),
            Self::Gnss(s) => {
                let place = [s.latitude, s.longitude, s.height];
                place.iter().all(|x| x.is_finite()) && finite(&s.velocity) && finite(&s.sigma)
            }
            Self::Magnetic(s) => finite(&s.field),
            Self::Sweep(s) => {
                let mount = s.mount_xyz.iter().chain([&s.mount_yaw, &s.first_angle, &s.angle_step]);
                mount.copied().all(f64::is_finite) && !s.ranges.iter().any(|range| range.is_infinite())
            }
        }
    }

    /// Whether no sensor of its kind on a robot could mean it.
    pub fn is_absurd(&self) -> bool {
        match self {
            Self::Imu(s) => s.acceleration.norm() > 200.0 || s.angular_velocity.norm() > 50.0,
            Self::Wheels(s) => s.linear.abs() > 20.0 || s.angular.abs() > 50.0,
            Self::Gnss(s) => {
                s.latitude.abs() > 1.6 || s.longitude.abs() > 6.4 || s.height.abs() > 2e4 || s.velocity.norm() > 100.0
            }
            Self::Magnetic(s) => !(1e-6..1e-3).contains(&s.field.norm()),
            Self::Sweep(s) => !(1e-4..1.0).contains(&s.angle_step),
        }
    }
}
