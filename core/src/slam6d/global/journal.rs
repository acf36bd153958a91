//! What a restarted aligner needs: everything that ever changed its map, in order, to be written behind one another.
//!
//! Running and restoring go through the same functions with the same entries, so that the map after a restart is the
//! map before it, to the last bit. An entry is as large as what happened, not as the map.

use serde::{Deserialize, Serialize};

use crate::geometry::{Covariance, Pose};

/// Something that changed the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JournalEntry {
    /// A scan was aligned, or not.
    Scan(Box<ScanEntry>),
    /// What followed an accepted scan: pairs with earlier ones, and the poses that were corrected.
    Correction(CorrectionEntry),
}

/// A scan and its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanEntry {
    /// The scan.
    pub scan_id: u64,
    /// Its pose, a guess when it was not accepted.
    pub map_from_scanner: Pose,
    /// Of a node, covariance of the pair with the target; else of its pose.
    pub covariance: Covariance,
    /// Whether it is a node from now on: it was accepted, and in continuous mode it is a keyframe.
    pub is_node: bool,
    /// The scan it was aligned to, or for one that is no node, the scan it moves along with.
    pub target_id: Option<u64>,
    /// `target_from_scanner` as measured; for a scan that was not accepted, by the poses.
    pub target_from_scanner: Option<Pose>,
}

/// What followed an accepted scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorrectionEntry {
    /// The scan.
    pub scan_id: u64,
    /// The pairs that were accepted.
    pub pairs: Vec<MeasuredPair>,
    /// The edges that are switched off from now on (true) or count again (false).
    pub switched: Vec<(usize, bool)>,
    /// The nodes that moved, with their new poses.
    pub poses: Vec<(usize, Pose)>,
}

/// A pair that was accepted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPair {
    /// Node of the target.
    pub target: usize,
    /// Node of the source.
    pub source: usize,
    /// The motion measured.
    pub target_from_source: Pose,
    /// Its covariance.
    pub covariance: Covariance,
    /// Whether it closes a loop.
    pub closes_loop: bool,
}
