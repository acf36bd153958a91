//! The process that delivers scans: from files, from a recording, from the ray-cast scanner in a scene, or from the
//! sweeps and the encoder of a robot's turning laser.
//!
//! It writes each cloud once, straight into shared memory, and in lockstep waits with the next one until every service
//! has finished the last. It keeps the clock of the run.

mod config;
mod live;
mod no_return;
mod scan_store;
mod service;
mod source;

pub use config::{AcquisitionConfig, ConfigError, SourceKind, parse_grid};
pub use service::run;
pub use source::{ScanInfo, Source, SourceError, Written, open_source, scene_of, true_poses};
