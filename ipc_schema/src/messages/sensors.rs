//! Raw sensor messages: what a driver or the simulator says.

use super::Header;
use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

message! {
    /// One beam of a planar laser.
    pub struct Beam: "mirador/Beam/1", size 8 {
        /// Range [m]; NaN where the laser got no return.
        pub range: f32,
        /// Sensor's own scale, 0 when unknown.
        pub intensity: u16,
        /// Time of the beam as a fraction of the sweep, 0 to 65535.
        pub time: u16,
    }
}

message! {
    /// One sweep of the planar laser on the turning head; the items are its [`Beam`]s.
    pub struct LaserSweepMeta: "mirador/LaserSweepMeta/1", size 88 {
        /// Names the scan the sweep belongs to; the stamp is the time of the first beam.
        pub header: Header,
        /// Duration of the sweep [ns].
        pub duration_ns: u64,
        /// Angle of the first beam [rad].
        pub first_angle: f64,
        /// Angle between two beams [rad].
        pub angle_step: f64,
        /// Counts the sweeps of the device, to tell missing and repeated ones.
        pub sweep: u32,
        /// Not used.
        pub reserved: u32,
        /// Longest range of the device [m].
        pub range_max: f64,
    }
}

message! {
    /// One reading of the turning head's encoder.
    pub struct EncoderReading: "mirador/EncoderReading/1", size 32 {
        /// Time of the reading, in the header's clock [ns].
        pub stamp_ns: i64,
        /// Angle of the head since the home switch [rad].
        pub angle: f64,
        /// Angular velocity [rad/s].
        pub velocity: f64,
        /// 1 while the home switch is pressed.
        pub home: u32,
        /// Counts the readings of the device.
        pub reading: u32,
    }
}

message! {
    /// One planar scan of a fixed 2D laser; the items are its [`Beam`]s.
    pub struct PlanarScanMeta: "mirador/PlanarScanMeta/1", size 120 {
        /// The stamp is the time of the first beam.
        pub header: Header,
        /// Angle of the first beam, anticlockwise from straight ahead [rad].
        pub first_angle: f64,
        /// Angle between two beams [rad].
        pub angle_step: f64,
        /// Longest range [m].
        pub range_max: f64,
        /// Duration of the sweep [ns].
        pub duration_ns: u64,
        /// Position of the laser in the robot's frame [m].
        pub mount_xyz: [f64; 3],
        /// Yaw of the laser in the robot's frame [rad].
        pub mount_yaw: f64,
        /// Which of the robot's planar lasers.
        pub sensor: u32,
        /// Not used.
        pub reserved: u32,
    }
}

message! {
    /// Wheel odometry.
    pub struct Odometry: "mirador/Odometry/1", size 88 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// odom_from_robot: x, y, z [m].
        pub position: [f64; 3],
        /// odom_from_robot: quaternion x, y, z, w.
        pub orientation: [f64; 4],
        /// Forward speed [m/s].
        pub linear: f64,
        /// Turning speed about z [rad/s].
        pub angular: f64,
        /// Distance driven since the start [m].
        pub distance: f64,
    }
}

message! {
    /// Inertial measurement in the robot's frame.
    pub struct Imu: "mirador/Imu/1", size 80 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Acceleration including gravity [m/s^2].
        pub acceleration: [f64; 3],
        /// Angular velocity [rad/s].
        pub angular_velocity: [f64; 3],
        /// Standard deviation of one acceleration component [m/s^2].
        pub acceleration_sigma: f64,
        /// Standard deviation of one angular velocity component [rad/s].
        pub angular_velocity_sigma: f64,
        /// Temperature [K], 0 when unknown.
        pub temperature: f64,
    }
}

message! {
    /// Satellite position.
    pub struct Gnss: "mirador/Gnss/1", size 88 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Latitude [rad].
        pub latitude: f64,
        /// Longitude [rad].
        pub longitude: f64,
        /// Height over the ellipsoid [m].
        pub height: f64,
        /// Velocity east, north, up [m/s].
        pub velocity: [f64; 3],
        /// Standard deviation east, north, up [m].
        pub sigma: [f64; 3],
        /// 0 none, 1 single, 2 differential, 3 real-time kinematic.
        pub fix: u32,
        /// Satellites used.
        pub satellites: u32,
    }
}

message! {
    /// Magnetic field in the robot's frame.
    pub struct Magnetometer: "mirador/Magnetometer/1", size 40 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Field [T].
        pub field: [f64; 3],
        /// Standard deviation of one component [T].
        pub sigma: f64,
    }
}

message! {
    /// One ultrasonic ranger.
    pub struct Ranger: "mirador/Ranger/1", size 64 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Position of the ranger in the robot's frame [m].
        pub mount_xyz: [f64; 3],
        /// Direction of the ranger: yaw and pitch in the robot's frame [rad].
        pub mount_yaw_pitch: [f64; 2],
        /// Opening angle of the cone [rad].
        pub aperture: f64,
        /// Range [m], NaN where nothing was heard.
        pub range: f32,
        /// Which ranger.
        pub sensor: u32,
    }
}

message! {
    /// Battery state.
    pub struct Battery: "mirador/Battery/1", size 40 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Voltage [V].
        pub voltage: f64,
        /// Current drawn [A].
        pub current: f64,
        /// Charge left in [0, 1].
        pub charge: f64,
        /// 1 when so low that the robot must stop.
        pub low: u32,
        /// Not used.
        pub reserved: u32,
    }
}
