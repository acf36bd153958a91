//! The keyframe of the built-in methods: what is kept of a scan to align others to it, and it to others.

mod cells;
mod cloud;
mod moments;
mod planes;
mod search;
mod voxels;
mod windows;

pub(super) use cells::Cell;
pub use cloud::PreparedCloud;
pub(super) use search::LastBrick;
pub(crate) use voxels::floor;
