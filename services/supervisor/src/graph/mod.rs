//! The graph file: which services run, how, and with what configuration.

mod load;
mod overrides;
mod tables;

pub use load::{GraphError, load, load_text};
pub use tables::{Graph, GraphTable, RestartPolicy, SERVICES, ServiceEntry, ServiceTables, WakeWord};

/// The graph of `mirador replay` and of the demonstration.
pub const STANDARD: &str = include_str!("../../graphs/replay.toml");
/// The graph of `mirador explore`.
pub const EXPLORATION: &str = include_str!("../../graphs/explore.toml");
