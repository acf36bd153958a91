//! Where the robot is: an error-state Kalman filter over inertial unit, wheels, a level laser, satellites, magnetometer and
//! the poses of aligned scans.
//!
//! After J. Sola, "Quaternion kinematics for the error-state Kalman filter" (2017), sections 5 and 6: the inertial unit
//! drives the prediction, everything else corrects it. Errors that hold for a while (drift of the satellite receiver,
//! slip of the wheels, iron near the magnetometer) are states of their own, so that many readings with the same error
//! do not count as many. [`Localizer`] takes readings in any order of the sensors, uses them in the order of their
//! stamps, and says in an [`Estimate`] where the robot is, how well that is known, and whether it is [`Lost`].

mod config;
mod geodesy;
mod intake;
mod laser_heading;
mod laser_track;
mod localizer;
mod lost;
mod measurements;
mod readings;
mod state;
mod sweep_matching;
#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::ride as test_ride;

pub use config::{
    GnssModel, ImuModel, LaserModel, LocalizationConfig, LostConfig, MagnetometerModel, ScanPoseModel, WheelModel,
};
pub use intake::{Refusals, SensorRefusals};
pub use localizer::{Counters, Estimate, Localizer, ScanPoseUse, ScanPrior};
pub use lost::{Lost, Source};
pub use readings::{GnssSample, ImuSample, MagneticSample, SweepSample, WheelSample};
