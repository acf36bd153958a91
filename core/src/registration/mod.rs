//! Registration of two scans: where the scanner stood when it took the source, seen from where it took the target.
//!
//! A method implements [`Registration`]: it prepares a scan once and aligns any two prepared scans. Methods are chosen
//! by name through a [`Registry`], to which a user's crate adds its own.
//!
//! Conventions: poses map the source's frame to the target's, `target_from_source`; a perturbation `delta` acts on the
//! right, `target_from_source * exp(delta)`, so it is a motion in the source's frame, translation [m] before rotation
//! [rad]; covariances and Hessians are 6x6 in that order. Results depend neither on the number of threads nor on
//! earlier calls.

// Values side by side are walked by index, so that one loop serves several arrays and becomes one wide instruction.
#![allow(clippy::needless_range_loop)]

mod alignment;
pub mod coarse;
mod config;
pub mod conformance;
mod evidence;
pub mod global;
mod information;
mod iteration;
mod kdtree;
mod keyframe;
mod limits;
mod methods;
mod pairs;
mod registry;
mod robust;
mod symmetric3;
mod traits;
mod walk;

#[cfg(test)]
mod bad_input;
#[cfg(test)]
mod real_data;
#[cfg(test)]
pub(crate) mod test_scenes;

pub use alignment::{Alignment, Constraint};
pub use config::{ConfigError, Optimiser, PreparationConfig, RegistrationConfig};
pub(crate) use information::{ErrorModel, constraint_of, covariance_of};
pub use kdtree::{KdTree, Neighbours};
pub use keyframe::PreparedCloud;
pub(crate) use keyframe::floor;
pub use limits::Limits;
pub use registry::{Registry, RegistryError};
pub use robust::RobustKernel;
pub use traits::{AlignError, PairIds, PrepareError, PreparedScan, Registration};
