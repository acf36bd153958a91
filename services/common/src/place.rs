//! Where a payload lies.

use mirador_ipc_schema::{Received, topics};

/// Logs, when debugging, in which segment and at which offset the points of a scan lie: the same for every process,
/// because nobody copies them.
pub fn log_place(number: u32, scan: &Received<topics::Scan>) {
    if tracing::enabled!(tracing::Level::DEBUG)
        && let Some(place) = scan.location()
    {
        tracing::debug!(scan = number, inode = place.inode, offset = place.offset, "payload");
    }
}
