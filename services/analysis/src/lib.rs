//! The process that scores every point of a scan.
//!
//! Mesh, normals, areas and quality need no pose: they are worked out as soon as the scan is there, beside alignment on
//! the other core. When the alignment comes, only what needs the level frame is left.

mod config;
mod service;

pub use config::AnalysisConfig;
pub use service::run;
