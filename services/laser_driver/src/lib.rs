//! The process that speaks to a planar laser: a SICK LMS1xx over TCP (CoLa A telegrams) becomes `laser_sweep` messages.
//!
//! A device that goes away, garbles its telegrams or is in the wrong state is said in the service's health, and
//! connected to again; the sweeps that came before stand.

mod cola;
mod config;
mod device_clock;
mod service;

#[cfg(test)]
mod emulator;

pub use config::{LaserDriverConfig, LaserDriverConfigError};
pub use service::run;
