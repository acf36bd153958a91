//! The process that is the robot where there is none: physics and sensors in a world, in control steps of simulated time.
//!
//! At every step it says what its sensors have said, `robot_state` last, and, in lockstep, waits for the answer of
//! navigation before time goes on. Nobody can tell it from a robot by its messages.

mod config;
mod outputs;
mod sensor_fault;
mod service;
mod wheels;

pub use config::{ConfigError, DrivenRobot, SimulatorConfig};
pub use sensor_fault::{SensorFault, SensorTopic};
pub use service::run;
