//! What a robot's sensors have said.

use crate::simulation::sensors::{
    BatteryReading, EncoderTick, GnssReading, ImuReading, LaserBeam, LaserSweep, MagnetometerReading, OdometryReading,
    RangerReading,
};

/// A sweep of one of a robot's fixed lasers.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarSweep {
    /// Simulated time of its first beam [s].
    pub time: f64,
    /// Which of the robot's sensors, in the order of the world file.
    pub sensor: usize,
    /// Its beams, the rightmost first.
    pub beams: Vec<LaserBeam>,
}

/// What a robot's sensors have said since the readings were cleared, each kind in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Readings {
    /// Wheels.
    pub odometry: Vec<OdometryReading>,
    /// Inertial unit.
    pub imu: Vec<ImuReading>,
    /// Satellite receiver.
    pub gnss: Vec<GnssReading>,
    /// Magnetometer.
    pub magnetometer: Vec<MagnetometerReading>,
    /// Ultrasonic rangers.
    pub rangers: Vec<RangerReading>,
    /// Battery.
    pub battery: Vec<BatteryReading>,
    /// Fixed lasers.
    pub planar: Vec<PlanarSweep>,
    /// The laser on the turning head.
    pub sweeps: Vec<LaserSweep>,
    /// The head itself.
    pub ticks: Vec<EncoderTick>,
}

impl Readings {
    /// Forgets all, keeps the memory.
    pub fn clear(&mut self) {
        self.odometry.clear();
        self.imu.clear();
        self.gnss.clear();
        self.magnetometer.clear();
        self.rangers.clear();
        self.battery.clear();
        self.planar.clear();
        self.sweeps.clear();
        self.ticks.clear();
    }
}
