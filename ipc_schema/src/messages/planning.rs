//! View plans, their paths, and requests to plan again.

use super::Header;
use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

/// The plan goes to the chosen candidate.
pub const DECISION_GO: u32 = 0;
/// The plan stops; `reason` says why.
pub const DECISION_STOP: u32 = 1;
/// Status of a candidate that was valued; anything else is the code of its rejection, in words in `reason`.
pub const CANDIDATE_OPEN: u32 = 0;

message! {
    /// A view plan: the decision; the items are the candidates with their terms.
    pub struct ViewPlanMeta: "mirador/ViewPlanMeta/1", size 496 {
        /// Names the newest scan the plan knows of.
        pub header: Header,
        /// When that scan was sent, CLOCK_MONOTONIC [ns].
        pub scan_sent_ns: u64,
        /// Time the map update took [ns].
        pub map_ns: u64,
        /// Time the planning took [ns].
        pub planning_ns: u64,
        /// Revision of the map it was taken on.
        pub map_revision: u64,
        /// map_from_scanner it was taken at, row-major 4x4.
        pub map_from_scanner: [f64; 16],
        /// Weights A, Q, O, C.
        pub weights: [f64; 4],
        /// C_p: below this utility the model is good enough.
        pub utility_threshold: f64,
        /// Mean quality of the known cells, in [0, 1].
        pub mean_quality: f64,
        /// Mean quality asked for, in [0, 1].
        pub quality_asked: f64,
        /// Known cells of the map.
        pub cells_known: u32,
        /// Navigable cells of the map.
        pub cells_navigable: u32,
        /// [`DECISION_GO`] or [`DECISION_STOP`].
        pub decision: u32,
        /// Index of the chosen candidate; u32::MAX for none.
        pub chosen: u32,
        /// Zones of interest known.
        pub zones: u32,
        /// Tiles of the map.
        pub map_tiles: u32,
        /// Length of the path [m].
        pub path_length_m: f64,
        /// Bytes the map takes in memory.
        pub map_bytes: u64,
        /// Name of the strategy.
        pub strategy: [u8; 32],
        /// The typed reason of the decision, a short name such as `best_utility`, `done`, `nothing_reachable`.
        pub reason_code: [u8; 32],
        /// The reason of the decision in words.
        pub reason: [u8; 128],
    }
}

message! {
    /// One candidate view.
    pub struct CandidateView: "mirador/CandidateView/1", size 144 {
        /// Position in the map [m].
        pub position: [f64; 3],
        /// Direction the robot arrives in [rad].
        pub heading: f64,
        /// A: information gain in [0, 1].
        pub information: f64,
        /// Q: quality gain in [0, 1].
        pub quality: f64,
        /// O: zones of interest in [0, 1].
        pub zones: f64,
        /// C: travel cost [m, weighted by navigability].
        pub cost: f64,
        /// u: utility.
        pub utility: f64,
        /// Unexplored cells that would be seen.
        pub unexplored_cells: u32,
        /// [`CANDIDATE_OPEN`] or the code of the rejection.
        pub status: u32,
        /// The rejection in words; empty when valued.
        pub reason: [u8; 64],
    }
}

message! {
    /// The path to the chosen view; the items are its [`Waypoint`]s from the robot on.
    pub struct PathMeta: "mirador/PathMeta/1", size 72 {
        /// Names the scan whose view plan this belongs to.
        pub header: Header,
        /// Revision of the map it was planned on.
        pub map_revision: u64,
        /// Length [m].
        pub length_m: f64,
        /// Travel cost [m, weighted by navigability].
        pub cost: f64,
    }
}

message! {
    /// One point of a path in the map.
    pub struct Waypoint: "mirador/Waypoint/1", size 32 {
        /// Position [m].
        pub position: [f64; 3],
        /// Navigability of its cell, in [0, 1].
        pub navigability: f64,
    }
}

message! {
    /// Asks planning to decide again on the map it has.
    pub struct ReplanRequest: "mirador/ReplanRequest/1", size 80 {
        /// Weights A, Q, O, C; NaN keeps the configured one.
        pub weights: [f64; 4],
        /// Why: 0 asked by a user, 1 target given up by navigation, 2 pose corrected.
        pub cause: u32,
        /// Not used.
        pub reserved: u32,
        /// Name of the strategy; empty keeps the configured one.
        pub strategy: [u8; 40],
    }
}
