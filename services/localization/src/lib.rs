//! The process that knows where the robot is.
//!
//! It hears the sensors, says `robot_pose` when a control step is complete (`robot_state`), and the prior of a scan
//! (`pose`) once for each that the clock releases. Aligned scans correct the estimate, corrections of the newest one move
//! it along. What is kept for a restart is the estimate itself.

mod kept;
mod messages;
mod sensors;
mod service;
#[cfg(test)]
mod service_tests;

pub use mirador_core::localization::LocalizationConfig;
pub use service::run;
