//! A whole exploration in one process, without processes, motion or errors of localisation (the kinematic mode): scan,
//! surface, scores, map, plan, and a jump along the path to the next view. Deterministic: the same world, settings and
//! seed give the same run, but for the times. `bench planning` and `experiment` both use it.

mod drive;
mod error;
mod mapper;
mod run;
mod weights;
mod world;

pub use drive::GivenUp;
pub use error::ExplorationError;
pub(crate) use mapper::Mapper;
pub use mapper::{coarser, for_scanner, planning_config};
pub use run::{Exploration, Outcome, SCAN_S, SPEED_M_S, Step};
pub(crate) use run::{situation, timed_plan};
pub(crate) use weights::weights_of;
pub use weights::{WEIGHTS, WeightSet};
pub use world::{World, WorldQuality};
