//! The recorder: everything that the processes of a graph say goes into `run.mcap`, and comes back out of it.
//!
//! Raw records are lossless: the bytes of a message's meta part, then the bytes of its items, on a channel
//! `mirador/<topic>` whose schema record holds the JSON description of the layout. Beside them stands a view of the
//! same run in foxglove's message types, for viewers.

mod config;
mod ledger;
mod read;
mod records;
mod recover;
mod service;
mod write;

#[cfg(test)]
mod testing;

pub use config::{Compression, ConfigError, RecorderConfig};
pub use read::{ReadError, RunReader};
pub use recover::RecoverError;
pub use service::{RecorderError, run};
pub use write::{RunStatistics, RunWriter, WriteError};

/// Name of the recording inside a run directory.
pub const RUN_FILE: &str = "run.mcap";

/// What the channels of raw records begin with; the name of the topic follows.
pub const CHANNEL_PREFIX: &str = "mirador/";
/// Message encoding of raw records.
pub const MESSAGE_ENCODING: &str = "mirador";
/// Schema encoding of raw records.
pub const SCHEMA_ENCODING: &str = "mirador-json";
