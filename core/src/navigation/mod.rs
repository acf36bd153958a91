//! Driving: along a path by regulated pure pursuit, with an eye on obstacles, sensors and its own progress; and from one
//! scan to the next. On the robot's board, which of several references for the drives counts.
//!
//! [`Driver`] takes one path and says at every control step how fast to go, until it has arrived or gives the target up
//! with a typed reason. [`Mission`] goes from scan to scan: request, wait for the plan, drive, request. Neither has a
//! clock: time is that of the stamps, and the same input gives the same output.

mod config;
mod drive;
mod driver;
mod give_up;
mod lean;
mod mission;
mod motion_sources;
mod obstacles;
mod path;
mod progress;
mod pursuit;
mod recover;
#[cfg(test)]
mod tests;
mod watch;

pub use config::{FollowConfig, NavigationConfig, ObstacleConfig, RecoveryConfig, WatchConfig};
pub use drive::{Drive, DriveState, RobotNow};
pub use driver::Driver;
pub use give_up::GiveUp;
pub use mission::{Decision, Mission, MissionState, MissionStep, RobotWord};
pub use motion_sources::{Arbitration, Conditions, MotionSources, Reference, Refusal, Source, Standstill};
pub use obstacles::{Echo, LaserView, Surroundings};
pub use path::{Path, PathError};
pub use watch::{SensorFault, WatchCounters, Watched};
