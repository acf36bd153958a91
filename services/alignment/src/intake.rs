//! Takes scans in while others are worked on: the next scan is prepared, which needs neither its prior nor the poses of
//! those before, while the last is aligned, sent, or older ones are corrected.
//!
//! One thread owns the port. It holds one scan, made ready, until that is taken; with the one that is worked on these are
//! the two that a reader of `scan` may hold. Preparing is a pure function of the scan, so it does not matter when it is
//! done.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mirador_core::registration::{PrepareError, PreparedScan, Registration};
use mirador_ipc_schema::messages::WorkSpan;
use mirador_ipc_schema::service::HEARTBEAT;
use mirador_ipc_schema::{Bell, Pause, Received, Subscriber, Waiter, Wakeable, clock, topics};
use mirador_service_common::{ServiceError, view};

/// A scan ready to be aligned.
pub(crate) struct Ready {
    pub scan: Received<topics::Scan>,
    /// As the registration method prepared it; nothing for a scan that is known, or where nothing is to be prepared.
    pub prepared: Option<Result<Box<dyn PreparedScan>, PrepareError>>,
    /// When work on it began, CLOCK_MONOTONIC [ns].
    pub began_ns: u64,
    /// How long the preparation took.
    pub prepare_time: Duration,
    /// The preparation as work of the thread that takes scans in.
    pub span: WorkSpan,
}

/// What the two threads share.
struct Shared {
    slot: Mutex<Slot>,
    /// The slot is empty again, or nobody takes anything any more.
    taken: Condvar,
    /// Something is in the slot.
    bell: Bell,
    /// A scan has come that was not taken yet, be it ready or not.
    has_arrived: AtomicBool,
    /// Scans below this are done and only acknowledged.
    done: AtomicU32,
    is_closed: AtomicBool,
}

enum Slot {
    Empty,
    Ready(Box<Ready>),
    Failed(ServiceError),
}

/// The receiving end of `scan`, with a thread of its own.
pub(crate) struct Intake {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Intake {
    /// Begins to take scans in; `registration` prepares those from `done` on.
    ///
    /// # Errors
    /// When the system refuses the thread or a descriptor.
    pub fn start(
        scans: Subscriber<topics::Scan>,
        waiter: Waiter,
        registration: Option<Box<dyn Registration>>,
        done: u32,
    ) -> Result<Self, ServiceError> {
        let fail = |e: std::io::Error| ServiceError::Work(format!("scans cannot be taken in: {e}"));
        let shared = Arc::new(Shared {
            slot: Mutex::new(Slot::Empty),
            taken: Condvar::new(),
            bell: Bell::new().map_err(fail)?,
            has_arrived: AtomicBool::new(false),
            done: AtomicU32::new(done),
            is_closed: AtomicBool::new(false),
        });
        let own = Arc::clone(&shared);
        let work = move || {
            let _end = End(&own);
            own.take_in(&scans, &waiter, registration.as_deref());
        };
        let thread = std::thread::Builder::new().name("intake".into()).spawn(work).map_err(fail)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// The next scan, if one is ready.
    ///
    /// # Errors
    /// What the thread could not go on for.
    pub fn take(&self) -> Result<Option<Ready>, ServiceError> {
        let mut slot = self.shared.lock();
        match std::mem::replace(&mut *slot, Slot::Empty) {
            Slot::Empty => Ok(None),
            Slot::Failed(error) => Err(error),
            Slot::Ready(ready) => {
                self.shared.bell.silence();
                self.shared.has_arrived.store(false, Ordering::Relaxed);
                self.shared.taken.notify_one();
                Ok(Some(*ready))
            }
        }
    }

    /// Whether a scan has come that was not taken yet, be it ready or not.
    pub fn has_arrived(&self) -> bool {
        self.shared.has_arrived.load(Ordering::Relaxed)
    }

    /// What wakes when a scan is ready.
    pub fn bell(&self) -> &dyn Wakeable {
        &self.shared.bell
    }

    /// Scans below this are done.
    pub fn set_done(&self, done: u32) {
        self.shared.done.store(done, Ordering::Relaxed);
    }
}

impl Drop for Intake {
    fn drop(&mut self) {
        self.shared.is_closed.store(true, Ordering::Relaxed);
        drop(self.shared.lock());
        self.shared.taken.notify_one();
        if let Some(thread) = self.thread.take() {
            // It says in the slot what it could not go on for.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take_in(&self, scans: &Subscriber<topics::Scan>, waiter: &Waiter, registration: Option<&dyn Registration>) {
        let mut pause = Pause::default();
        while !self.is_closed() && !waiter.stop().is_set() {
            match scans.receive() {
                Ok(None) => pause = waiter.wait(&[scans], HEARTBEAT),
                Ok(Some(scan)) => self.make_ready(scan, registration, std::mem::take(&mut pause)),
                Err(error) => {
                    self.hand_over(Slot::Failed(error.into()));
                    return;
                }
            }
        }
    }

    fn make_ready(&self, scan: Received<topics::Scan>, registration: Option<&dyn Registration>, pause: Pause) {
        self.has_arrived.store(true, Ordering::Relaxed);
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        let is_new = scan.header().scan() >= self.done.load(Ordering::Relaxed);
        let prepared =
            registration.filter(|_| is_new).map(|method| method.prepare(view::scan(scan.meta(), scan.items())));
        let (number, sent_ns, prepare_time) = (scan.header().scan(), scan.header().sent_ns, begin.elapsed());
        let span = WorkSpan { thread: 1, ..WorkSpan::until_now("prepare", number, sent_ns, pause, began_ns) };
        self.hand_over(Slot::Ready(Box::new(Ready { scan, prepared, began_ns, prepare_time, span })));
    }

    /// Puts something into the slot and waits until it is taken: until then no further scan may be held.
    fn hand_over(&self, content: Slot) {
        let mut slot = self.lock();
        *slot = content;
        self.bell.ring();
        while !matches!(*slot, Slot::Empty) && !self.is_closed() {
            slot = self.taken.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn is_closed(&self) -> bool {
        self.is_closed.load(Ordering::Relaxed)
    }
}

/// Says that the thread has ended when it ends by a fault of the program.
struct End<'a>(&'a Shared);

impl Drop for End<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            *self.0.lock() = Slot::Failed(ServiceError::Work("the thread that prepares scans has ended".into()));
            self.0.bell.ring();
        }
    }
}
