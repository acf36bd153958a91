//! Where a payload lies.

use mirador_ipc_schema::SegmentLocation;

/// Logs, when debugging, in which segment and at which offset the points of a scan lie: the same for every process,
/// because nobody copies them.
pub fn log_place(number: u32, location: impl FnOnce() -> Option<SegmentLocation>) {
    if tracing::enabled!(tracing::Level::DEBUG)
        && let Some(place) = location()
    {
        tracing::debug!(scan = number, inode = place.inode, offset = place.offset, "payload");
    }
}

/// As [`log_place`], for the keyframes of a request about a scan.
pub fn log_keyframes(number: u32, location: impl FnOnce() -> Option<SegmentLocation>) {
    if tracing::enabled!(tracing::Level::DEBUG)
        && let Some(place) = location()
    {
        tracing::debug!(scan = number, inode = place.inode, offset = place.offset, "keyframes");
    }
}
