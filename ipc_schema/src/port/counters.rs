//! What the ports of one process count.

use std::sync::atomic::{AtomicU64, Ordering};

/// A number that only grows. Ports of several threads may add to it.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// The number so far.
    #[must_use]
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    pub(super) fn add(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }
}

/// Counters shared by the ports of one [`Participant`](super::Participant).
#[derive(Debug, Default)]
pub struct Counters {
    /// Payload bytes copied into or out of shared memory on request of the service.
    pub copied_payload_bytes: Counter,
    /// Messages that a gap in the sequence numbers shows to be missing.
    pub lost: Counter,
    /// Messages that did not reach every reader within the back-pressure limit.
    pub undelivered: Counter,
    /// Messages sent.
    pub sent: Counter,
    /// Messages received.
    pub received: Counter,
}
