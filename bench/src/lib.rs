//! What mirador costs, measured: `mirador bench WHAT`.
//!
//! Every benchmark is a function that takes its options and returns a [`BenchReport`], which prints itself as a table
//! and as JSON with stable names. A figure in a report is either measured in that run or marked as literature, never
//! a mixture.

pub mod compare;
pub mod experiment;
pub mod exploration;
pub mod ipc;
mod machine;
pub mod planning;
pub mod registration;
mod report;
pub mod simulator;
pub mod stages;

pub use machine::Machine;
pub use report::{BenchReport, Provenance, Row, Summary};
