//! The process that keeps the information map and chooses the next best view.
//!
//! After every scored scan it updates the map, plans, and publishes the decision with its candidates and the path.
//! Only then come the changed tiles of the map and the checkpoint.

mod config;
mod messages;
mod service;

pub use config::PlanningServiceConfig;
pub use service::run;
