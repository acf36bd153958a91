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

/// How long a message that was announced is looked for before the reader sleeps again: announcements come some tens of
/// microseconds ahead, and whoever is looked for in vain for so long has been interrupted.
const ANNOUNCED: Duration = Duration::from_micros(300);

/// Looks for an announced message without sleeping; whether one of the ports has one.
pub(super) fn look(ports: &[&dyn Wakeable], stop: &StopSignal) -> bool {
    let begin = Instant::now();
    loop {
        if ports.iter().any(|port| port.is_ready()) {
            return true;
        }
        if stop.is_set() || begin.elapsed() > ANNOUNCED {
            return false;
        }
        // Who has announced it may be waiting for this very core.
        rustix::thread::sched_yield();
    }
}

/// As [`wait`]; after an event without a message it looks for the message before it sleeps again.
pub(super) fn wait_announced(wake: Wake, ports: &[&dyn Wakeable], timeout: Duration, stop: &StopSignal) -> Pause {
    let pause = wait(wake, ports, timeout, stop);
    let was_woken = u128::from(pause.woke_ns.saturating_sub(pause.asleep_ns)) < timeout.as_nanos();
    if wake == Wake::Event && was_woken {
        look(ports, stop);
        return Pause { woke_ns: clock::monotonic_ns(), ..pause };
    }
    pause
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::thread;

    use super::*;
    use crate::port::Bell;

    /// A port whose message comes after its event, as one that is announced.
    struct Announced {
        event: Arc<Bell>,
        message: Arc<Bell>,
    }

    impl Wakeable for Announced {
        fn is_ready(&self) -> bool {
            self.message.is_ready()
        }

        fn descriptor(&self) -> Option<BorrowedFd<'_>> {
            self.event.descriptor()
        }

        fn drain_events(&self) {
            self.event.drain_events();
        }
    }

    #[test]
    fn after_an_announcement_the_message_is_looked_for_and_without_one_the_reader_goes_on_after_a_moment() {
        let (event, message) = (Arc::new(Bell::new().unwrap()), Arc::new(Bell::new().unwrap()));
        let port = Announced { event: Arc::clone(&event), message: Arc::clone(&message) };
        let (hour, stop) = (Duration::from_secs(3600), StopSignal::default());
        // Nothing follows this one.
        event.ring();
        let begin = Instant::now();
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(Duration::from_millis(5));
                event.ring();
            });
            let pause = wait_announced(Wake::Event, &[&port], hour, &stop);
            assert!(!port.is_ready() && pause.woke_ns > pause.asleep_ns);
        });
        assert!(begin.elapsed() >= Duration::from_millis(5) && begin.elapsed() < hour);
        // This one is followed by its message.
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(Duration::from_millis(5));
                message.ring();
                event.ring();
            });
            wait_announced(Wake::Event, &[&port], hour, &stop);
            assert!(port.is_ready() && look(&[&port], &stop));
        });
        message.silence();
        stop.set();
        assert!(!look(&[&port], &stop), "who is to stop does not look on");
    }
}
