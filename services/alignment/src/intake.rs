//! Takes scans in, and prepares them, which needs neither their prior nor the poses of those before.
//!
//! Whoever has the [`Desk`] does: the service's own thread while it waits for a scan, so that no other thread has to be woken
//! between the scan and its pose; a second thread while the service is at work on the last scan or on older ones. That one sleeps
//! until a scan comes: to lend it the desk wakes nobody, and neither does to take it back. It holds one scan, made ready, until
//! that is taken; with the one that is worked on these are the two that a reader of `scan` may hold. Preparing is a pure function
//! of the scan, so it does not matter who does it when.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mirador_core::registration::{PrepareError, PreparedScan, Registration};
use mirador_ipc_schema::messages::WorkSpan;
use mirador_ipc_schema::{Pause, Received, Subscriber, Wakeable, Watch, clock, topics};
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
    /// The preparation as a piece of work.
    pub span: WorkSpan,
}

/// What the two threads share.
struct Shared {
    /// Wakes the second thread.
    watch: Watch,
    counter: Mutex<Counter>,
    /// The second thread has put the desk back.
    is_back: Condvar,
    /// A scan has come that was not taken yet, be it ready or not.
    has_arrived: AtomicBool,
    /// Scans below this are done and only acknowledged.
    done: AtomicU32,
}

/// Where the desk changes hands.
#[derive(Default)]
struct Counter {
    /// Here while it is lent and the second thread sleeps.
    desk: Option<Desk>,
    /// What the second thread has taken in.
    taken: Option<Result<Ready, ServiceError>>,
    /// The intake is being dropped, or the second thread has ended by a fault of the program.
    is_closed: bool,
}

impl Shared {
    fn counter(&self) -> MutexGuard<'_, Counter> {
        self.counter.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.counter().is_closed = true;
        self.is_back.notify_all();
    }
}

/// The receiving end of `scan` with the method that prepares.
struct Desk {
    scans: Subscriber<topics::Scan>,
    registration: Option<Box<dyn Registration>>,
    shared: Arc<Shared>,
}

/// The number that stands for a thread in its pieces of work.
#[derive(Clone, Copy)]
enum By {
    Service = 0,
    SecondThread = 1,
}

impl Desk {
    /// Takes the next scan, if there is one, and makes it ready; `pause` is how long the thread has slept for it.
    fn take_in(&self, by: By, pause: &mut Pause) -> Result<Option<Ready>, ServiceError> {
        let Some(scan) = self.scans.receive()? else { return Ok(None) };
        self.shared.has_arrived.store(true, Ordering::Relaxed);
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        let is_new = scan.header().scan() >= self.shared.done.load(Ordering::Relaxed);
        let method = self.registration.as_deref().filter(|_| is_new);
        let prepared = method.map(|method| method.prepare(view::scan(scan.meta(), scan.items())));
        let (number, sent_ns, prepare_time) = (scan.header().scan(), scan.header().sent_ns, begin.elapsed());
        let slept = std::mem::take(pause);
        let span = WorkSpan { thread: by as u32, ..WorkSpan::until_now("prepare", number, sent_ns, slept, began_ns) };
        Ok(Some(Ready { scan, prepared, began_ns, prepare_time, span }))
    }
}

/// The second thread: takes the desk whenever it is lent and a scan has come.
fn stand_in(shared: &Shared) {
    /// However the thread ends, nobody waits for it any more.
    struct Closes<'a>(&'a Shared);
    impl Drop for Closes<'_> {
        fn drop(&mut self) {
            self.0.close();
        }
    }
    let _closes = Closes(shared);
    loop {
        let mut pause = shared.watch.wait();
        let desk = {
            let mut counter = shared.counter();
            if counter.is_closed {
                return;
            }
            let is_free = counter.taken.is_none();
            counter.desk.take_if(|_| is_free)
        };
        let Some(desk) = desk else { continue };
        desk.scans.drain_events();
        let taken = desk.take_in(By::SecondThread, &mut pause).transpose();
        if taken.is_some() {
            // Whatever comes next is left where it is until this one is taken. A port that cannot be disarmed only wakes for nothing.
            let _ = shared.watch.disarm(&desk.scans);
        }
        let mut counter = shared.counter();
        (counter.desk, counter.taken) = (Some(desk), taken);
        shared.is_back.notify_all();
    }
}

/// The receiving end of `scan`, with a second thread for when the service is at work.
pub(crate) struct Intake {
    /// Here unless it is lent.
    desk: Option<Desk>,
    /// What the second thread has taken in.
    ready: Option<Ready>,
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
        registration: Option<Box<dyn Registration>>,
        done: u32,
    ) -> Result<Self, ServiceError> {
        let fail = |e: std::io::Error| ServiceError::Work(format!("scans cannot be taken in: {e}"));
        let shared = Arc::new(Shared {
            watch: Watch::new(&scans).map_err(fail)?,
            counter: Mutex::default(),
            is_back: Condvar::new(),
            has_arrived: AtomicBool::new(false),
            done: AtomicU32::new(done),
        });
        let of_thread = Arc::clone(&shared);
        let work = move || stand_in(&of_thread);
        let thread = std::thread::Builder::new().name("intake".into()).spawn(work).map_err(fail)?;
        let desk = Desk { scans, registration, shared: Arc::clone(&shared) };
        Ok(Self { desk: Some(desk), ready: None, shared, thread: Some(thread) })
    }

    /// The next scan made ready, if one has come; by the caller, unless the second thread has done so. `pause` is how long the
    /// caller has slept for it.
    ///
    /// # Errors
    /// When the scan cannot be received, or the second thread has ended by a fault of the program.
    pub fn take(&mut self, pause: &mut Pause) -> Result<Option<Ready>, ServiceError> {
        self.take_back()?;
        let taken = match (self.ready.take(), &self.desk) {
            (None, Some(desk)) => desk.take_in(By::Service, pause)?,
            (ready, _) => ready,
        };
        self.shared.has_arrived.store(false, Ordering::Relaxed);
        Ok(taken)
    }

    /// Leaves it to the second thread to take the next scan in: the caller is about to work.
    pub fn lend(&mut self) {
        if self.ready.is_some() {
            return;
        }
        let Some(desk) = self.desk.take() else { return };
        let mut counter = self.shared.counter();
        // The event of what is taken already.
        desk.scans.drain_events();
        // Without an event the second thread would not come: then the caller goes on by itself.
        if self.shared.watch.arm(&desk.scans).is_err() {
            self.desk = Some(desk);
            return;
        }
        // One that came with the last has lost its event with it.
        let is_there = desk.scans.is_ready();
        counter.desk = Some(desk);
        drop(counter);
        if is_there {
            self.shared.watch.wake();
        }
    }

    /// Takes it upon the caller's thread again; waits while the second thread makes a scan ready.
    ///
    /// # Errors
    /// As [`Intake::take`].
    pub fn take_back(&mut self) -> Result<(), ServiceError> {
        if self.desk.is_some() {
            return Ok(());
        }
        let mut counter = self.shared.counter();
        while counter.desk.is_none() && !counter.is_closed {
            counter = self.shared.is_back.wait(counter).unwrap_or_else(PoisonError::into_inner);
        }
        let ended = || ServiceError::Work("the thread that takes scans in has ended".into());
        let desk = counter.desk.take().ok_or_else(ended)?;
        // One that cannot be disarmed wakes the second thread for nothing.
        let _ = self.shared.watch.disarm(&desk.scans);
        self.desk = Some(desk);
        self.ready = counter.taken.take().transpose()?;
        Ok(())
    }

    /// Whether a scan has come that was not taken yet, be it ready or not.
    pub fn has_arrived(&self) -> bool {
        self.shared.has_arrived.load(Ordering::Relaxed)
    }

    /// What wakes when a scan comes; nothing while one is ready, or the second thread waits for it.
    pub fn awaited(&self) -> Option<&dyn Wakeable> {
        self.desk.as_ref().filter(|_| self.ready.is_none()).map(|desk| &desk.scans as &dyn Wakeable)
    }

    /// Scans below this are done.
    pub fn set_done(&self, done: u32) {
        self.shared.done.store(done, Ordering::Relaxed);
    }
}

impl Drop for Intake {
    fn drop(&mut self) {
        self.shared.close();
        self.shared.watch.wake();
        if let Some(thread) = self.thread.take() {
            // A panic of it has been told of by the standard hook.
            let _ = thread.join();
        }
        // The desk knows what it lies in: left there, neither it nor its port would ever be dropped.
        let left = std::mem::take(&mut *self.shared.counter());
        drop(left);
    }
}

#[cfg(test)]
mod tests {
    use mirador_core::registration::{RegistrationConfig, Registry};
    use mirador_core::scan::Point;
    use mirador_ipc_schema::messages::{Header, ScanId, ScanMeta};
    use mirador_ipc_schema::{Domain, Participant, Publisher, Sizes, StopSignal, Wake};

    use super::*;

    /// A domain with a sender of scans and an intake that begins with scan 1.
    struct Stage {
        domain: Domain,
        scans: Publisher<topics::Scan>,
        intake: Intake,
        _participants: [Participant; 2],
    }

    impl Stage {
        fn new(name: &str) -> Self {
            let domain = Domain::new(&format!("{name}{}", std::process::id())).unwrap();
            let join = |name| {
                let (domain, sizes) = (domain.clone(), Sizes { scan_points: 2000 });
                Participant::join(domain, name, 0, sizes, Wake::Event, StopSignal::default()).unwrap()
            };
            let participants = [join("sender"), join("alignment")];
            let method = Registry::default().create("point_to_point", &RegistrationConfig::default()).unwrap();
            let intake = Intake::start(participants[1].subscriber().unwrap(), Some(method), 1).unwrap();
            Self { scans: participants[0].publisher().unwrap(), domain, intake, _participants: participants }
        }

        fn send(&self, scan: u32) {
            let points: Vec<Point> = (0..2000)
                .map(|k| Point::new((k % 50) as f32 * 0.3, (k / 50) as f32 * 0.3, 0.1 * (k % 7) as f32))
                .collect();
            let header = Header::new(ScanId { robot: 0, run: 0, scan }.pack(), 0);
            let meta = ScanMeta { header, returns: 2000, ..ScanMeta::default() };
            self.scans.send_copy(meta, bytemuck::cast_slice(&points)).unwrap();
        }

        /// Number, thread and whether it was prepared, of the scan that is ready.
        fn take(&mut self) -> Option<(u32, u32, bool)> {
            let ready = self.intake.take(&mut Pause::default()).unwrap()?;
            let is_prepared = matches!(ready.prepared, Some(Ok(_)));
            Some((ready.scan.header().scan(), ready.span.thread, is_prepared))
        }
    }

    impl Drop for Stage {
        fn drop(&mut self) {
            let _ = self.domain.remove_all();
        }
    }

    #[test]
    fn who_waits_prepares_the_scan_himself_and_who_works_has_it_prepared() {
        let mut stage = Stage::new("intake");
        assert!(stage.take().is_none() && stage.intake.awaited().is_some());
        stage.send(0);
        assert_eq!(stage.take(), Some((0, 0, false)), "scans that are done are not prepared again");
        stage.send(1);
        assert_eq!(stage.take(), Some((1, 0, true)));
        stage.intake.lend();
        assert!(stage.intake.awaited().is_none());
        stage.send(2);
        let began = Instant::now();
        while !stage.intake.has_arrived() {
            assert!(began.elapsed() < Duration::from_secs(20), "the second thread does not take the scan in");
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(stage.take(), Some((2, 1, true)));
        assert!(!stage.intake.has_arrived());
    }

    #[test]
    fn the_second_thread_gives_back_what_it_did_not_need_and_ends_with_the_intake() {
        let mut stage = Stage::new("intakeb");
        for scan in 1..4 {
            stage.intake.lend();
            stage.intake.take_back().unwrap();
            assert!(stage.take().is_none());
            stage.send(scan);
            assert_eq!(stage.take(), Some((scan, 0, true)));
        }
        // Ends while the second thread waits; the port goes with it.
        stage.intake.lend();
        let shared = Arc::downgrade(&stage.intake.shared);
        drop(stage);
        assert!(shared.upgrade().is_none());
    }
}
