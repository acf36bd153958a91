//! Waiting for several topics at once.

use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::{StopSignal, Wake};
use crate::clock;

/// Something that a message can wake.
pub trait Wakeable {
    /// Whether a message is there.
    fn is_ready(&self) -> bool;
    /// The descriptor that becomes readable with an event; none when polling.
    fn descriptor(&self) -> Option<BorrowedFd<'_>>;
    /// Takes the events, so that they do not wake again.
    fn drain_events(&self);
}

/// When a thread waited, CLOCK_MONOTONIC [ns].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pause {
    /// It had nothing to do any more.
    pub asleep_ns: u64,
    /// Something came, or the time was over.
    pub woke_ns: u64,
}

/// Waits until a port has a message, the time is over or the process should end.
pub(super) fn wait(wake: Wake, ports: &[&dyn Wakeable], timeout: Duration, stop: &StopSignal) -> Pause {
    let asleep_ns = clock::monotonic_ns();
    match wake {
        Wake::Event => wait_for_event(ports, timeout, stop),
        Wake::Poll => spin(ports, timeout, stop),
    }
    Pause { asleep_ns, woke_ns: clock::monotonic_ns() }
}

fn wait_for_event(ports: &[&dyn Wakeable], timeout: Duration, stop: &StopSignal) {
    // Events first, messages second: a message that comes between the two leaves its event for the poll.
    for port in ports {
        port.drain_events();
    }
    if stop.is_set() || ports.iter().any(|p| p.is_ready()) {
        return;
    }
    let descriptors: Vec<BorrowedFd<'_>> = ports.iter().filter_map(|p| p.descriptor()).collect();
    let mut fds: Vec<PollFd<'_>> = descriptors.iter().map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
    let timeout = Timespec::try_from(timeout).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
    // A signal ends the wait early, which is what it is for; the caller looks again in any case.
    let _ = poll(&mut fds, Some(&timeout));
    for port in ports {
        port.drain_events();
    }
}

fn spin(ports: &[&dyn Wakeable], timeout: Duration, stop: &StopSignal) {
    /// Looks between two glances at the clock and the wish to stop.
    const LOOKS: usize = 64;
    let begin = Instant::now();
    while !stop.is_set() && begin.elapsed() < timeout {
        for _ in 0..LOOKS {
            if ports.iter().any(|p| p.is_ready()) {
                return;
            }
            std::hint::spin_loop();
        }
    }
}
