//! A run as viewers like it: mirador's messages become foxglove's message types, in `run.mcap` by the recorder and over
//! a WebSocket by the gateway. Nothing here is read back by mirador.
//!
//! [`View`] takes in messages and draws channels to a [`Sink`]. A scan appears when both its pose and its scores are
//! there, and only if it was aligned, so that a wrong guess does not spoil the picture. While a scan waits for its plan
//! nothing is drawn: drawing takes a processor, and the plan comes first.
//!
//! Foxglove draws every channel. Rerun draws clouds of points and frames, but neither grids nor scenes nor bare poses:
//! the channels below `/dots` are the same things as coloured points. All of it is in the frame `map`.
//!
//! The time of a drawing is when the message behind it was sent, in the clock that MCAP's log times are in; the publish
//! time is the sensor's.

mod channels;
pub mod colour;
mod dots;
mod map;
mod model;
mod points;
mod scene;
mod state;
mod view;

pub use channels::{CANDIDATES, CHANNELS, CLOUD, Channel, DOTS, GRID, LOG, MODEL, PATH, POSES, TF, ZONES};
pub use view::{TOPICS, View, ViewConfig};

use foxglove::Encode;

/// The frame of everything that is drawn.
pub const MAP: &str = "map";
/// The frame of the newest aligned scan.
pub const SCANNER: &str = "scanner";
/// The frame of the robot, where localisation tells it.
pub const ROBOT: &str = "robot";

/// Number and times of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// The scan it is about.
    pub sequence: u32,
    /// When the message behind it was sent [ns].
    pub log_time: u64,
    /// The sensor's time [ns].
    pub publish_time: u64,
}

/// Where drawings go.
pub trait Sink {
    /// Why a drawing cannot be taken.
    type Error;

    /// Whether anyone wants this channel now; what nobody wants is not drawn.
    fn wants(&self, channel: &'static str) -> bool;

    /// Takes a drawing.
    ///
    /// # Errors
    /// What the sink fails of.
    fn draw<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M) -> Result<(), Self::Error>;
}
