//! What the ports of one process count.

use std::cell::Cell;

/// Counters shared by the ports of one [`Participant`](super::Participant).
#[derive(Debug, Default)]
pub struct Counters {
    /// Payload bytes copied into or out of shared memory on request of the service.
    pub copied_payload_bytes: Cell<u64>,
    /// Messages that a gap in the sequence numbers shows to be missing.
    pub lost: Cell<u64>,
    /// Messages that did not reach every reader within the back-pressure limit.
    pub undelivered: Cell<u64>,
    /// Messages sent.
    pub sent: Cell<u64>,
    /// Messages received.
    pub received: Cell<u64>,
}

impl Counters {
    pub(super) fn add(cell: &Cell<u64>, n: u64) {
        cell.set(cell.get() + n);
    }
}
