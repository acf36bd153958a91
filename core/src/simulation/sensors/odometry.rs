//! Dead reckoning from the wheels.

use super::config::OdometryConfig;

/// Where the wheels say the robot is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryReading {
    /// Simulated time [s].
    pub time: f64,
    /// `odom_from_robot`: x, y [m] and yaw [rad].
    pub pose: [f64; 3],
    /// Forward speed [m/s].
    pub linear: f64,
    /// Turning speed about z [rad/s].
    pub angular: f64,
    /// Distance driven since the start [m].
    pub distance: f64,
}

/// Adds up what the encoders of the left and right wheels count.
#[derive(Debug, Clone)]
pub struct WheelOdometry {
    config: OdometryConfig,
    ticks: [f64; 2],
    pose: [f64; 3],
    distance: f64,
    time: f64,
}

impl WheelOdometry {
    /// Starts at the origin.
    #[must_use]
    pub fn new(config: OdometryConfig) -> Self {
        Self { config, ticks: [0.0; 2], pose: [0.0; 3], distance: 0.0, time: 0.0 }
    }

    /// The next reading, from how far the left and right wheels have rolled since the start [m].
    pub fn read(&mut self, time: f64, rolled: [f64; 2]) -> OdometryReading {
        let ticks = rolled.map(|way| (way / self.config.tick).floor());
        let [left, right] = [0, 1].map(|side: usize| (ticks[side] - self.ticks[side]) * self.config.tick);
        self.ticks = ticks;
        let (ahead, turn) = (0.5 * (left + right), (right - left) / self.config.track);
        // On the chord of the arc.
        let heading = self.pose[2] + 0.5 * turn;
        self.pose = [self.pose[0] + ahead * heading.cos(), self.pose[1] + ahead * heading.sin(), self.pose[2] + turn];
        self.distance += ahead.abs();
        let step = (time - self.time).max(1e-6);
        self.time = time;
        OdometryReading { time, pose: self.pose, linear: ahead / step, angular: turn / step, distance: self.distance }
    }
}
