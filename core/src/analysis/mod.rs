//! Scores of every point: can I drive here, is it an obstacle, how good is this data? And where does the scan suggest
//! that something is hidden?
//!
//! Works in the level frame: the scan turned by the rotation of its alignment only, so that z is up and the scanner
//! stays at the origin (spec section 3, levelling). Sections 4 and 5 of the spec; the calibrated forms are the defaults.

mod cloud;
mod config;
mod ground_height;
mod lines;
mod navigable;
mod obstacle;
mod point_score;
mod ring;
mod scorer;
mod zones;

pub use config::{HeightForm, ObstacleForm, ScoreConfig, ScoreConfigError};
pub use ground_height::{GroundHeight, GroundHeightOrigin, estimate_ground_height};
pub use navigable::{height_factor, slope_factor};
pub use obstacle::{obstacle_score, step_score, within_reach};
pub use point_score::PointScore;
pub use scorer::{ScoreError, ScoreSummary, Scorer};
pub use zones::{Zone, ZoneConfig, ZoneFinder, zones};
