//! What a driver is told of the robot at a control step, and what it answers.

use super::give_up::GiveUp;
use super::watch::SensorFault;
use crate::geometry::Pose;

/// Where the robot takes itself to be, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotNow {
    /// Time [ns].
    pub stamp_ns: i64,
    /// `map_from_robot`.
    pub map_from_robot: Pose,
    /// Forward speed [m/s].
    pub linear: f64,
    /// Whether localisation does not know where it is.
    pub is_lost: bool,
}

/// What the driver does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveState {
    /// On its way.
    Driving,
    /// Something is in the way.
    Blocked,
    /// Waits for a sensor or for localisation.
    Waiting,
    /// Backs up the way it came.
    Recovering,
    /// The target is reached.
    Arrived,
    /// The target is given up.
    GaveUp(GiveUp),
}

/// What to do in this control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Forward speed [m/s].
    pub linear: f64,
    /// Turning speed about z [rad/s].
    pub angular: f64,
    /// What is being done.
    pub state: DriveState,
    /// What is wrong with a sensor.
    pub fault: Option<SensorFault>,
}
