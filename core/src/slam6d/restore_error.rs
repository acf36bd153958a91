//! What may keep an aligner from going on where another stopped.

use thiserror::Error;

use crate::registration::{ConfigError, PrepareError};

/// Why an aligner could not be restored.
#[derive(Debug, Error)]
pub enum RestoreError {
    /// The settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The state names a target, and its scan was not given.
    #[error("the state's target is scan {scan_id}; its points are needed to go on")]
    TargetMissing {
        /// The target's id.
        scan_id: u64,
    },
    /// The target's scan cannot be prepared, so it is not the scan that was accepted.
    #[error("the target, scan {scan_id}, cannot be prepared again: {error}")]
    Target {
        /// The target's id.
        scan_id: u64,
        /// Why not.
        #[source]
        error: PrepareError,
    },
    /// The scan given is not the target, or the method or its settings are not those of the state.
    #[error("scan {scan_id} reduces to {points} points, but it had {expected}: another scan, method or voxel size")]
    OtherTarget {
        /// The target's id.
        scan_id: u64,
        /// Reduced points now.
        points: u64,
        /// Reduced points when it was accepted.
        expected: u64,
    },
}
