//! The algorithms of mirador, from raw points to the next best view.
//!
//! No processes, no clocks, no printing: every function takes borrowed data and returns a value or a typed error, so
//! that the same code runs inside a service, a test, a bench or somebody else's program.
//! Modules stand in the order in which data flows and depend only on those before them.
//!
//! Conventions used everywhere (written out in `docs/conventions.md`): metres, radians, seconds; x ahead, z up;
//! poses are named `target_from_source`; covariances are 6x6, translation before rotation, perturbation on the right,
//! in the source's frame.

pub mod geometry;
pub mod scan;
mod simd;
mod threads;

pub mod surface;

pub mod registration;

pub mod odometry;
pub mod slam6d;

pub mod analysis;
pub mod information_map;
pub mod view_planning;

pub mod localization;
pub mod navigation;

pub mod simulation;

pub mod formats;

#[cfg(test)]
mod test_data;
