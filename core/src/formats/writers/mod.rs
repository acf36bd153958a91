//! Clouds and trajectories out. Every writer streams at fixed memory into a temporary file beside its goal, patches the
//! count in the header at the end, and takes the final name only when the file is complete.

mod las;
mod pcd;
mod ply;
mod temporary;
mod tum;
mod xyz32;

pub use las::LasWriter;
pub use pcd::{PcdOptions, PcdWriter};
pub use ply::{PlyOptions, PlyWriter};
pub(super) use temporary::TemporaryFile;
pub use tum::TumWriter;
pub use xyz32::Xyz32Writer;

use super::error::WriteError;
use crate::scan::Point;

/// A point on its way to a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutPoint {
    /// Position in the frame of the file [m], its origin included; NaN is an empty cell.
    pub position: [f64; 3],
    /// Quality in [0, 1], 0 when unknown.
    pub quality: f32,
    /// Id of the scan the point comes from.
    pub scan: u32,
    /// Sensor's own scale, 0 when unknown.
    pub intensity: u16,
    /// Whether the point's scan is aligned with the others.
    pub is_aligned: bool,
}

impl OutPoint {
    /// A point of a scan as it is, `origin` added to it [m], without scores.
    #[must_use]
    pub fn from_point(point: &Point, origin: [f64; 3]) -> Self {
        let [ox, oy, oz] = origin;
        let position = [f64::from(point.x) + ox, f64::from(point.y) + oy, f64::from(point.z) + oz];
        Self { position, quality: 0.0, scan: 0, intensity: point.intensity, is_aligned: false }
    }

    /// Whether the position is finite.
    #[must_use]
    pub fn is_return(&self) -> bool {
        self.position.iter().all(|c| c.is_finite())
    }
}

/// A cloud file being written. Dropped before [`CloudWriter::finish`], it leaves nothing behind.
pub trait CloudWriter {
    /// Appends points.
    ///
    /// # Errors
    /// The disk, or what the format cannot hold.
    fn write(&mut self, points: &[OutPoint]) -> Result<(), WriteError>;
    /// Completes the header, gives the file its name and returns the number of points in it.
    ///
    /// # Errors
    /// The disk, or a grid that the points do not fill.
    fn finish(self: Box<Self>) -> Result<u64, WriteError>;
}

#[cfg(test)]
mod tests;
