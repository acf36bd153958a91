//! The process that keeps the information map and chooses the next best view.
//!
//! After every scored scan it updates the map, plans, and publishes the decision with its candidates and the path.
//! Only then come the changed tiles of the map and the checkpoint; and when alignment corrects older scans, these are
//! moved in the map, one after the other, before the scan counts as finished.

mod config;
mod corrections;
mod figures;
mod inbox;
mod messages;
mod outbox;
mod replan;
mod scan_file;
mod service;
mod state;
mod way;

pub use config::{CorrectionConfig, PlanningServiceConfig};
pub use service::run;
