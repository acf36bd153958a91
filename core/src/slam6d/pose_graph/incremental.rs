//! Optimisation of the end of a growing graph.

use serde::{Deserialize, Serialize};

/// What an update of a growing graph did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Update {
    /// Nothing to do.
    Nothing,
}
