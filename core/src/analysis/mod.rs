//! Scores of every point: can I drive here, is it an obstacle, how good is this data?

mod point_score;

pub use point_score::PointScore;
