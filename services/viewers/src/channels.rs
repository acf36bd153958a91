//! The channels of the view.

use foxglove::messages::{FrameTransform, Grid, Log, PointCloud, PosesInFrame, SceneUpdate};
use foxglove::{Encode, Schema};

/// The newest scan, coloured by quality.
pub const CLOUD: &str = "/cloud";
/// All aligned scans, thinned, coloured by quality.
pub const MODEL: &str = "/model";
/// The poses of the aligned scans, map_from_scanner.
pub const POSES: &str = "/poses";
/// The path to the chosen view.
pub const PATH: &str = "/path";
/// The candidate views, each with its terms.
pub const CANDIDATES: &str = "/candidates";
/// The zones of interest.
pub const ZONES: &str = "/zones";
/// The lowest level of the information map, coloured by navigability.
pub const GRID: &str = "/map";
/// Frames: the scanner at the newest aligned scan, and the robot.
pub const TF: &str = "/tf";
/// Decisions, and what did not go well, in words.
pub const LOG: &str = "/log";
pub(crate) const DOTS_MAP: &str = "/dots/map";
pub(crate) const DOTS_POSES: &str = "/dots/poses";
pub(crate) const DOTS_PATH: &str = "/dots/path";
pub(crate) const DOTS_CANDIDATES: &str = "/dots/candidates";
pub(crate) const DOTS_ZONES: &str = "/dots/zones";
/// The channels for viewers that draw nothing but clouds.
pub const DOTS: [&str; 5] = [DOTS_MAP, DOTS_POSES, DOTS_PATH, DOTS_CANDIDATES, DOTS_ZONES];

/// A channel of the view.
#[derive(Debug, Clone, Copy)]
pub struct Channel {
    /// Its name.
    pub topic: &'static str,
    /// Schema and message encoding.
    pub declaration: fn() -> (Schema, String),
}

fn declaration<M: Encode>() -> (Schema, String) {
    // All foxglove message types have a schema; one without would be written as a channel that viewers list unnamed.
    let schema = M::get_schema().unwrap_or_else(|| Schema::new("", "", Vec::new()));
    (schema, M::get_message_encoding())
}

const fn channel<M: Encode>(topic: &'static str) -> Channel {
    Channel { topic, declaration: declaration::<M> }
}

/// Every channel, in the order in which they are drawn: frames before what lies in them.
pub const CHANNELS: [Channel; 14] = [
    channel::<FrameTransform>(TF),
    channel::<PosesInFrame>(POSES),
    channel::<PointCloud>(CLOUD),
    channel::<PointCloud>(MODEL),
    channel::<SceneUpdate>(ZONES),
    channel::<SceneUpdate>(CANDIDATES),
    channel::<PosesInFrame>(PATH),
    channel::<Grid>(GRID),
    channel::<Log>(LOG),
    channel::<PointCloud>(DOTS_MAP),
    channel::<PointCloud>(DOTS_POSES),
    channel::<PointCloud>(DOTS_PATH),
    channel::<PointCloud>(DOTS_CANDIDATES),
    channel::<PointCloud>(DOTS_ZONES),
];
