//! The one clock by which processes of a host compare times.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC [ns]: comparable between the processes of one host, never set back.
#[must_use]
pub fn monotonic_ns() -> u64 {
    nanoseconds(ClockId::Monotonic)
}

/// CLOCK_REALTIME [ns since 1970 UTC]; only for stamps in files, never for intervals.
#[must_use]
pub fn utc_ns() -> u64 {
    nanoseconds(ClockId::Realtime)
}

fn nanoseconds(id: ClockId) -> u64 {
    let t = clock_gettime(id);
    // Both clocks are non-negative from 1970 on.
    t.tv_sec.unsigned_abs() * 1_000_000_000 + t.tv_nsec.unsigned_abs()
}
