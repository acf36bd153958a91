//! View planning (section 4.2 of the spec): where should the robot scan next, how does it get there, and is it done?
//!
//! A [`Strategy`] turns an information map and a [`Situation`] into a [`ViewPlan`], which is also the record that
//! explains the decision. Strategies are chosen by name from a [`StrategyRegistry`]. The parts stand alone, so that a
//! strategy is a short composition of them: `tiles` and `grid` read the map, `cost_tree` finds the ways, `candidates`
//! draws places, `sweep` sees from them, `quality` and `gain` say what that is worth. What they find is kept from plan to
//! plan in a [`Workspace`].

mod bits;
mod candidates;
mod config;
mod cost_tree;
mod exponential;
mod frontier;
mod gain;
mod greedy;
mod grid;
mod multi_criteria;
mod path;
mod plan;
mod quality;
mod random;
mod registry;
mod relief;
mod strategy;
mod survey;
mod sweep;
mod tile_digest;
mod tiles;
mod tour;
mod tour_order;
mod turning_place;
mod utility;
mod visited;
mod workspace;

#[cfg(test)]
mod clearance_tests;
#[cfg(test)]
mod conformance;
#[cfg(test)]
mod conformance_ground;
#[cfg(test)]
mod conformance_steps;
#[cfg(test)]
mod test_worlds;

pub use config::{
    FootprintRule, Normalisation, PlanningConfig, PlanningConfigError, ScannerModel, TourConfig, Weights, WorkArea,
};
pub use exponential::ExponentialGain;
pub use frontier::Frontier;
pub use greedy::{Greedy, GreedyTarget};
pub use multi_criteria::MultiCriteria;
pub use plan::{Candidate, Decision, RawGain, Rejected, RejectionReason, Rejections, StopReason, ViewPlan};
pub use random::Random;
pub use registry::{MakeStrategy, StrategyRegistry, UnknownStrategy};
pub use strategy::{Situation, Strategy};
pub use tour::CoverageTour;
pub use workspace::Workspace;
