//! One thread of a process wakes another that waits for messages.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::event::{EventfdFlags, eventfd};

use super::Wakeable;

/// Something to wait for beside messages: it is ready from when it is rung until it is silenced.
#[derive(Debug)]
pub struct Bell {
    is_rung: AtomicBool,
    event: OwnedFd,
}

impl Bell {
    /// A silent bell.
    ///
    /// # Errors
    /// When the system has no descriptor left.
    pub fn new() -> io::Result<Self> {
        let event = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { is_rung: AtomicBool::new(false), event })
    }

    /// Wakes who waits for it.
    pub fn ring(&self) {
        self.is_rung.store(true, Ordering::Release);
        // A full counter means that the reader is awake anyway.
        let _ = rustix::io::write(&self.event, &1_u64.to_ne_bytes());
    }

    /// There is nothing to wake for any more.
    pub fn silence(&self) {
        self.is_rung.store(false, Ordering::Release);
    }
}

impl Wakeable for Bell {
    fn is_ready(&self) -> bool {
        self.is_rung.load(Ordering::Acquire)
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.event.as_fd())
    }

    fn drain_events(&self) {
        // Nothing to read means that nobody has rung.
        let _ = rustix::io::read(&self.event, &mut [0_u8; 8]);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::port::{StopSignal, Wake, wait};

    #[test]
    fn a_bell_rung_in_another_thread_ends_the_wait_and_a_silent_one_does_not() {
        let bell = Arc::new(Bell::new().unwrap());
        for wake in [Wake::Event, Wake::Poll] {
            let ringer = Arc::clone(&bell);
            let begin = Instant::now();
            let thread = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(20));
                ringer.ring();
            });
            wait::wait(wake, &[&*bell], Duration::from_secs(60), &StopSignal::default());
            thread.join().unwrap();
            assert!(bell.is_ready() && begin.elapsed() < Duration::from_secs(30), "{wake:?}");
            bell.silence();
            let begin = Instant::now();
            wait::wait(wake, &[&*bell], Duration::from_millis(30), &StopSignal::default());
            assert!(!bell.is_ready() && begin.elapsed() >= Duration::from_millis(30), "{wake:?}");
        }
    }
}
