//! Coarse alignment: from a pose that may be metres and tens of degrees wrong to one that registration converges from,
//! and the judgement whether a pose can be trusted.
//!
//! The criterion is the source's (section 3, step 2): the number of cubes of an octree that both scans occupy. It is
//! maximised by branch and bound instead of depth by depth, on points drawn evenly over the directions that surfaces
//! face. The best maxima are moved to where surfaces meet and ranked by evidence that the search does not use: surfaces
//! matched both ways, and points of one scan in space that the other has seen to be free.

mod aligner;
mod coarse_scan;
mod config;
mod depth_by_depth;
mod evidence;
mod lattice;
mod occupancy;
mod polish;
mod range_image;
mod relocalise;
mod sampling;
mod search;
mod thinning;
mod verdict;

#[cfg(test)]
mod tests;

pub use aligner::{CoarseAligner, CoarseAlignment, CoarseError, CoarseHypothesis};
pub use coarse_scan::CoarseScan;
pub use config::{CoarseConfig, Method, SearchRange, TrustConfig};
pub use evidence::{Agreement, Evidence};
pub use relocalise::{Keyframe, Relocalisation};
pub use verdict::{Doubt, Verdict};
