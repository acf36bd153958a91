//! A second thread that takes a port over whenever the first is at work, without being woken only to be told so.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::time::Duration;

use rustix::event::{Timespec, epoll};

use super::{Bell, Pause, Wakeable};
use crate::clock;

/// What a port without a descriptor is looked at in: nothing wakes a reader that polls.
const LOOK: Duration = Duration::from_millis(1);

/// Waits in one thread for the events of a port that another thread arms and disarms. Arming a port costs the other thread a
/// system call and nobody a wake-up, unless there is an event.
#[derive(Debug)]
pub struct Watch {
    set: OwnedFd,
    bell: Bell,
    has_descriptor: bool,
}

impl Watch {
    /// Watches `port`, disarmed at first. The port must outlive the watch, or at least its last use.
    ///
    /// # Errors
    /// When the system has no descriptor left.
    pub fn new(port: &dyn Wakeable) -> io::Result<Self> {
        let (set, bell) = (epoll::create(epoll::CreateFlags::CLOEXEC)?, Bell::new()?);
        if let Some(descriptor) = bell.descriptor() {
            epoll::add(&set, descriptor, epoll::EventData::new_u64(0), epoll::EventFlags::IN)?;
        }
        let descriptor = port.descriptor();
        if let Some(descriptor) = descriptor {
            epoll::add(&set, descriptor, epoll::EventData::new_u64(1), epoll::EventFlags::empty())?;
        }
        Ok(Self { set, bell, has_descriptor: descriptor.is_some() })
    }

    /// From now on an event of the port ends [`Watch::wait`], also one that has come already.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn arm(&self, port: &dyn Wakeable) -> io::Result<()> {
        self.set_interest(port, epoll::EventFlags::IN)
    }

    /// From now on events of the port wake nobody here.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn disarm(&self, port: &dyn Wakeable) -> io::Result<()> {
        self.set_interest(port, epoll::EventFlags::empty())
    }

    fn set_interest(&self, port: &dyn Wakeable, interest: epoll::EventFlags) -> io::Result<()> {
        if let Some(descriptor) = port.descriptor() {
            epoll::modify(&self.set, descriptor, epoll::EventData::new_u64(1), interest)?;
        }
        Ok(())
    }

    /// Ends [`Watch::wait`], now or the next time.
    pub fn wake(&self) {
        self.bell.ring();
    }

    /// Waits for an event of the armed port or for [`Watch::wake`]; a while for a port that is polled. May end without either.
    pub fn wait(&self) -> Pause {
        let asleep_ns = clock::monotonic_ns();
        let timeout = (!self.has_descriptor).then(|| Timespec::try_from(LOOK).unwrap_or_default());
        let mut events = [epoll::Event { flags: epoll::EventFlags::empty(), data: epoll::EventData::new_u64(0) }; 2];
        // A signal ends the wait early; the caller looks again in any case.
        let _ = epoll::wait(self.set.as_fd(), &mut events, timeout.as_ref());
        self.bell.drain_events();
        self.bell.silence();
        Pause { asleep_ns, woke_ns: clock::monotonic_ns() }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    /// What waits for the next event, and how long that took.
    fn waits(watch: &Watch) -> Duration {
        let begin = Instant::now();
        watch.wait();
        begin.elapsed()
    }

    #[test]
    fn an_event_ends_the_wait_only_while_the_port_is_armed() {
        let port = Bell::new().unwrap();
        let watch = Watch::new(&port).unwrap();
        port.ring();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| waits(&watch));
            std::thread::sleep(Duration::from_millis(30));
            assert!(!waiting.is_finished(), "a disarmed port wakes nobody");
            watch.arm(&port).unwrap();
            assert!(waiting.join().unwrap() >= Duration::from_millis(30), "the event from before counts");
            watch.disarm(&port).unwrap();
            let waiting = scope.spawn(|| waits(&watch));
            std::thread::sleep(Duration::from_millis(30));
            assert!(!waiting.is_finished());
            watch.wake();
            waiting.join().unwrap();
        });
    }

    #[test]
    fn a_wake_before_the_wait_counts_once() {
        let port = Bell::new().unwrap();
        let watch = Watch::new(&port).unwrap();
        watch.wake();
        watch.wait();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| waits(&watch));
            std::thread::sleep(Duration::from_millis(30));
            assert!(!waiting.is_finished());
            watch.wake();
            waiting.join().unwrap();
        });
    }
}
