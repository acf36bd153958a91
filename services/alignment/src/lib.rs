//! The process that finds the pose of every scan.
//!
//! It keeps one reduced keyframe, publishes each pose with the record of how it was found, and writes down after every
//! scan what it needs to go on after a restart.

mod config;
mod messages;
mod service;

pub use config::AlignmentConfig;
pub use service::run;
