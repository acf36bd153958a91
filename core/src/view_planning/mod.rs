//! View planning (section 4.2 of the spec): where should the robot scan next, how does it get there, and is it done?
//!
//! A [`Strategy`] turns an information map and a [`Situation`] into a [`ViewPlan`], which is also the record that
//! explains the decision. Strategies are chosen by name from a [`StrategyRegistry`]. The parts (drawing candidates,
//! cost tree, visibility, gain, utility) stand alone, so that a strategy is a short composition of them.

mod candidates;
mod config;
mod cost_tree;
mod frontier;
mod gain;
mod grid;
mod multi_criteria;
mod path;
mod plan;
mod registry;
mod strategy;
mod survey;
mod utility;
mod visibility;

#[cfg(test)]
mod conformance;

pub use config::{Normalisation, PlanningConfig, PlanningConfigError, ScannerModel, Weights, WorkArea};
pub use frontier::Frontier;
pub use multi_criteria::MultiCriteria;
pub use plan::{Candidate, Decision, RawGain, Rejected, RejectionReason, Rejections, StopReason, ViewPlan};
pub use registry::{MakeStrategy, StrategyRegistry, UnknownStrategy};
pub use strategy::{Situation, Strategy};
