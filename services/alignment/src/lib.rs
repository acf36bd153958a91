//! The process that finds the pose of every scan.
//!
//! It publishes each pose with the record of how it was found; then, while nobody waits for it, it closes loops and
//! publishes the poses of older scans that change. It keeps one packed keyframe a scan, and writes down after every scan
//! what it needs to go on after a restart. The next scan is prepared meanwhile.

mod aligner;
mod config;
mod external;
mod intake;
mod journal;
mod messages;
mod restart;
mod service;
mod state;

pub use config::{AlignmentConfig, AlignmentMode};
pub use external::{ExternalConfig, FAULT_WORDS, ForeignRegistration, NAME as EXTERNAL};
pub use service::run;
