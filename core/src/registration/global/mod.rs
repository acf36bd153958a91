//! Alignment without any prior: keypoints that look alike, sets of them that one motion explains, and the verification
//! of [`super::coarse`].

mod aligner;
mod config;
mod consistency;
mod features;
mod matching;
mod neighbourhood;
mod rigid;
pub mod trials;

#[cfg(test)]
mod tests;

pub use aligner::{GlobalAligner, GlobalKeyframe};
pub use config::GlobalConfig;
pub use features::Features;
