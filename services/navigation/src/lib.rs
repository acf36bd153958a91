//! The process that drives the robot from one scan to the next.
//!
//! At every `robot_pose` it sends one `motion_command` with its stamp. It asks for scans, waits for their plans, drives
//! their paths, and says in `navigation_status` what it does and why.

mod inbox;
mod service;
#[cfg(test)]
mod service_tests;

pub use mirador_core::navigation::NavigationConfig;
pub use service::run;
