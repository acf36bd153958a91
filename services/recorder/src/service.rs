//! The recorder's loop: wait, write down everything that is there, acknowledge the scans that are safe.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::{
    Envelope, Header, Meta, ScanId, ScanRequest, ScanRequestKind, ServiceHealth, WorkSpan,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::topics::{self, Topic};
use mirador_ipc_schema::{
    JoinError, Participant, Pause, PortError, ReceiveFailure, Subscriber, Wakeable, clock, for_each_topic, text,
};
use mirador_service_common::Courtesy;
use mirador_viewers::View;

use crate::ledger::Ledger;
use crate::recover::recover;
use crate::{
    ConfigError, RUN_FILE, ReadError, RecorderConfig, RecoverError, RunReader, RunStatistics, RunWriter, WriteError,
};

/// After a stop the recorder takes what is still there for at most this long.
const LAST_ORDERS: Duration = Duration::from_secs(5);

/// When nobody has said anything for so long, no plan is being worked on.
const QUIET: Duration = Duration::from_secs(1);

/// A missing scan is asked for again after this long.
const ASK_AGAIN: Duration = Duration::from_secs(1);
/// A scan that is incomplete while later ones are complete is given up after this long.
const GIVE_UP: Duration = Duration::from_secs(10);

/// Why the recorder cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The domain cannot be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A topic cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A message cannot be received.
    #[error(transparent)]
    Receive(#[from] ReceiveFailure),
    /// The file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The recording of the incarnation before this one cannot be gone on with.
    #[error(transparent)]
    Recover(#[from] RecoverError),
}

/// Records a graph until it is asked to stop.
///
/// A fresh run overwrites `run.mcap`; a restarted recorder, or one that finds a recording that was cut off, goes on
/// with it. To go on with a recording that was ended in order, start with an incarnation above 0.
///
/// # Errors
/// See [`RecorderError`]. The health topic carries the same words.
pub fn run(setup: &ServiceSetup, config: &RecorderConfig) -> Result<(), RecorderError> {
    config.validate()?;
    let participant = setup.join()?;
    let mut health = HealthReporter::open(&participant, &setup.name)?;
    let result = record(&participant, setup, config, &mut health);
    if let Err(error) = &result {
        health.failed(&participant, &error.to_string());
    }
    result
}

fn record(
    participant: &Participant,
    setup: &ServiceSetup,
    config: &RecorderConfig,
    health: &mut HealthReporter,
) -> Result<(), RecorderError> {
    // Readers first: what is sent while an old recording is being recovered waits in their buffers.
    let taps = open_taps(participant, config)?;
    let ports: Vec<&dyn Wakeable> = taps.iter().map(|tap| tap.port()).collect();
    let worth_waking = taps.iter().filter(|tap| Courtesy::wakes(tap.topic()));
    let ports_beside_a_plan: Vec<&dyn Wakeable> = worth_waking.map(|tap| tap.port()).collect();
    let mut courtesy = Courtesy::default();
    let mut recorder = Recorder::open(setup, config, &mut || health.heartbeat(participant))?;
    health.running(participant);
    let requests = participant.publisher::<topics::ScanRequests>()?;
    let mut gaps = Gaps::new();
    let mut stopped: Option<Instant> = None;
    let mut pause = Pause::default();
    loop {
        let is_planned = recorder.is_planned();
        if stopped.is_none() {
            pause = participant.wait(if is_planned { &ports_beside_a_plan } else { &ports }, HEARTBEAT);
        }
        // Looked at once: who is to end has taken everything before he does.
        let is_stopping = participant.stop().is_set();
        let ready = taps.iter().filter(|tap| tap.port().is_ready()).map(|tap| tap.topic());
        let makes_way = is_planned && !is_stopping && !courtesy.is_over(ready);
        let (began, began_ns) = (Instant::now(), clock::monotonic_ns());
        let scan = recorder.ledger.finished();
        let mut received = 0;
        for tap in taps.iter().filter(|tap| !makes_way || !Courtesy::holds(tap.topic())) {
            received += tap.drain(&mut recorder)?;
        }
        if recorder.heard.elapsed() > QUIET {
            recorder.settle()?;
        }
        // Every message of a scan is a piece of work; those that made a scan safe are told of.
        if recorder.flush()? {
            health.worked(WorkSpan::until_now("record", scan, 0, pause, began_ns));
        }
        for scan in gaps.requests(&mut recorder.ledger) {
            let id = ScanId { robot: 0, run: setup.run, scan }.pack();
            let request = ScanRequest { kind: ScanRequestKind::RESEND, scan, reserved: 0 };
            if let Err(error) = requests.send_one(Envelope { header: Header::new(id, 0) }, request) {
                tracing::warn!(scan, %error, "a missing scan could not be asked for");
            }
        }
        let finished = recorder.ledger.finished();
        if finished > health.finished_scans() {
            health.finished(participant, finished, began.elapsed());
        }
        health.heartbeat(participant);
        if is_stopping {
            let since = *stopped.get_or_insert(began);
            if received == 0 || since.elapsed() > LAST_ORDERS {
                break;
            }
        }
    }
    let path = recorder.writer.path().to_owned();
    let statistics = recorder.finish()?;
    tracing::info!(path = %path.display(), messages = statistics.messages, bytes = statistics.bytes, "recording ended");
    Ok(())
}

/// Watches for scans that the recorder has missed.
struct Gaps {
    /// Number of finished scans, and since when.
    finished: (u32, Instant),
    asked: Option<Instant>,
}

impl Gaps {
    fn new() -> Self {
        Self { finished: (0, Instant::now()), asked: None }
    }

    /// The missing scans, once in a while. What does not come in spite of it is given up, so that a loss that cannot be
    /// mended is reported instead of holding up the graph for ever.
    fn requests(&mut self, ledger: &mut Ledger) -> Vec<u32> {
        let finished = ledger.finished();
        if finished != self.finished.0 || !ledger.is_overtaken() {
            self.finished = (finished, Instant::now());
            return Vec::new();
        }
        if self.finished.1.elapsed() > GIVE_UP {
            tracing::error!(scan = finished, "the recording of this scan is incomplete: its messages did not come");
            ledger.give_up();
            return Vec::new();
        }
        if self.asked.is_some_and(|at| at.elapsed() < ASK_AGAIN) {
            return Vec::new();
        }
        self.asked = Some(Instant::now());
        ledger.missing_scans()
    }
}

/// The recording in progress.
struct Recorder {
    writer: RunWriter,
    ledger: Ledger,
    view: Option<View>,
    /// State and count of finished scans of every service, as recorded last.
    services: BTreeMap<[u8; 32], (u32, u32)>,
    /// Plans are recorded.
    plans: bool,
    /// Something was written that a scan waits for.
    urgent: bool,
    /// When something of the run was said last.
    heard: Instant,
}

impl Recorder {
    fn open(setup: &ServiceSetup, config: &RecorderConfig, progress: &mut dyn FnMut()) -> Result<Self, RecorderError> {
        let path = setup.run_dir.join(RUN_FILE);
        let mut ledger = Ledger::new(config.acknowledged());
        let mut view = config.foxglove.then(|| View::new(config.view()));
        let writer = if path.exists() && (setup.incarnation > 0 || was_cut_off(&path)) {
            recover(&path, config, &mut ledger, view.as_mut(), progress)?
        } else {
            RunWriter::create(&path, config)?
        };
        let plans = config.records(topics::ViewPlan::RULES.name);
        Ok(Self { writer, ledger, view, services: BTreeMap::new(), plans, urgent: false, heard: Instant::now() })
    }

    /// Writes a message down, unless it is a repetition or says nothing new.
    fn take<T: Topic>(&mut self, meta: &T::Meta, items: &[T::Item]) -> Result<(), WriteError> {
        let topic = T::RULES.name;
        if !self.says_something_new(topic, bytemuck::cast_slice(items)) || !self.ledger.admit(topic, meta.header()) {
            return Ok(());
        }
        self.writer.record::<T>(meta, items)?;
        if topic != topics::ServiceHealth::RULES.name {
            self.heard = Instant::now();
        }
        self.urgent |= ["scan", "alignment", "loop_closing", "scored_scan", "view_plan"].contains(&topic);
        match &mut self.view {
            Some(view) => view.take::<T, _>(&mut self.writer, meta, items),
            None => Ok(()),
        }
    }

    /// Health comes many times a second; it is recorded when a service changed its state or finished a scan.
    fn says_something_new(&mut self, topic: &str, items: &[u8]) -> bool {
        if topic != topics::ServiceHealth::RULES.name {
            return true;
        }
        let Ok(health) = bytemuck::try_pod_read_unaligned::<ServiceHealth>(items) else { return true };
        let now = (health.state, health.finished_scans);
        self.services.insert(health.service, now) != Some(now)
    }

    /// Whether the graph has a service that plans, and plans are recorded.
    fn is_planned(&self) -> bool {
        self.plans && self.services.contains_key(&text::pack("planning"))
    }

    /// Draws what waits for a plan that does not come.
    fn settle(&mut self) -> Result<(), WriteError> {
        self.heard = Instant::now();
        self.view.as_mut().map_or(Ok(()), |view| view.settle(&mut self.writer))
    }

    /// Draws what was left out so far, and ends the file.
    fn finish(mut self) -> Result<RunStatistics, WriteError> {
        if let Some(view) = &mut self.view {
            view.finish(&mut self.writer)?;
        }
        self.writer.finish()
    }

    /// Makes safe what a scan waits for; whether there was anything.
    fn flush(&mut self) -> Result<bool, WriteError> {
        let urgent = std::mem::take(&mut self.urgent);
        if urgent {
            self.writer.flush()?;
        }
        Ok(urgent)
    }
}

/// Whether `path` is a recording of ours without an end, or one that ends before anything was recorded.
fn was_cut_off(path: &std::path::Path) -> bool {
    match RunReader::open(path) {
        Ok(reader) => !reader.is_complete(),
        Err(error) => matches!(error, ReadError::Empty { .. }),
    }
}

/// A topic being listened to.
trait Tap {
    fn topic(&self) -> &'static str;
    fn port(&self) -> &dyn Wakeable;
    /// Records every message that is there; returns how many there were.
    fn drain(&self, recorder: &mut Recorder) -> Result<usize, RecorderError>;
}

impl<T: Topic> Tap for Subscriber<T> {
    fn topic(&self) -> &'static str {
        T::RULES.name
    }

    fn port(&self) -> &dyn Wakeable {
        self
    }

    fn drain(&self, recorder: &mut Recorder) -> Result<usize, RecorderError> {
        let mut received = 0;
        while let Some(message) = self.receive()? {
            recorder.take::<T>(message.meta(), message.items())?;
            received += 1;
        }
        Ok(received)
    }
}

/// Listens to every topic that is to be recorded, in the order of the data flow.
fn open_taps(participant: &Participant, config: &RecorderConfig) -> Result<Vec<Box<dyn Tap>>, PortError> {
    let mut taps: Vec<Box<dyn Tap>> = Vec::new();
    macro_rules! tap {
        ($topic:ty) => {
            if config.records(<$topic as Topic>::RULES.name) {
                taps.push(Box::new(participant.subscriber::<$topic>()?));
            }
        };
    }
    for_each_topic!(tap);
    Ok(taps)
}

#[cfg(test)]
#[path = "service_tests.rs"]
mod tests;
