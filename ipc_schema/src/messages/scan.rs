//! Scans and requests for them.

use super::Header;
use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

message! {
    /// One point: position in the scanner's frame [m], NaN where the laser got no return.
    pub struct Point: "mirador/Point/1", size 16 {
        /// Ahead [m].
        pub x: f32,
        /// To the left [m].
        pub y: f32,
        /// Up [m].
        pub z: f32,
        /// Sensor's own scale, 0 when unknown.
        pub intensity: u16,
        /// Fraction of the scan's duration, 0 to 65535.
        pub time: u16,
    }
}

message! {
    /// The meta part of a scan; the items are its [`Point`]s.
    pub struct ScanMeta: "mirador/ScanMeta/1", size 120 {
        /// Names the scan.
        pub header: Header,
        /// The points are relative to this position of the file's own frame [m] (UTM survives f32 this way).
        pub origin: [f64; 3],
        /// Lines of the grid, 0 for a cloud without order.
        pub rows: u32,
        /// Points a line, 0 for a cloud without order.
        pub cols: u32,
        /// Points with a return.
        pub returns: u32,
        /// Bit mask, see [`SCAN_HAS_PRIOR`].
        pub flags: u32,
        /// Duration of the scan [ns], 0 when unknown.
        pub duration_ns: u64,
        /// Position of the scan in its source: the file's place in the folder, or the pose's place in the scene.
        pub source_index: u32,
        /// Not used.
        pub reserved: u32,
        /// The shortest range that is a return [m]; nearer points were emptied.
        pub range_min_m: f32,
        /// The longest range that is a return [m]; farther points were emptied.
        pub range_max_m: f32,
        /// Number of returns emptied because of the two limits.
        pub out_of_range: u32,
        /// Not used.
        pub reserved2: u32,
    }
}

/// A `pose` message with the same id was sent before this scan: the prior of its alignment.
pub const SCAN_HAS_PRIOR: u32 = 1;

message! {
    /// Asks acquisition for scans.
    pub struct ScanRequest: "mirador/ScanRequest/1", size 16 {
        /// See [`ScanRequestKind`].
        pub kind: u32,
        /// The scan that is asked for: of a new one the number it is to have. Who is asked to take the scan that was taken
        /// last, or is being taken, takes it again.
        pub scan: u32,
        /// Not used.
        pub reserved: u64,
    }
}

/// What a [`ScanRequest`] asks for.
pub struct ScanRequestKind;

impl ScanRequestKind {
    /// Take a new scan here.
    pub const TAKE: u32 = 0;
    /// Send the named scan of this run once more; who has finished it ignores it.
    pub const RESEND: u32 = 1;
}
