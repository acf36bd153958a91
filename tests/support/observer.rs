//! Watching a graph from within: a participant of its domain that listens to what the services say of themselves.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::ServiceHealth;
use mirador_ipc_schema::{Domain, Participant, Sizes, StopSignal, Subscriber, Wake, text, topics};

/// The longest an expected event may keep a test waiting.
const PATIENCE: Duration = Duration::from_secs(60);

/// A silent participant of a graph. Drop it before asserting that nothing is left of the domain.
pub struct Observer {
    health: Subscriber<topics::ServiceHealth>,
    participant: Participant,
    /// The last word of every service.
    seen: BTreeMap<String, ServiceHealth>,
}

impl Observer {
    /// Joins a graph once its supervisor is there: a domain is swept before its first topic is made, and an observer
    /// must not be in the way of that.
    pub fn join(domain: &Domain) -> Self {
        super::eventually("the supervisor is in the domain", || {
            super::living(domain).iter().any(|(name, _)| name == "supervisor")
        });
        let sizes = Sizes { scan_points: 1 };
        let participant =
            Participant::join(domain.clone(), "observer", 0, sizes, Wake::Event, StopSignal::default()).unwrap();
        let health = participant.subscriber().unwrap();
        Self { health, participant, seen: BTreeMap::new() }
    }

    /// Listens until `condition` holds for what was heard so far.
    pub fn until(&mut self, what: &str, mut condition: impl FnMut(&BTreeMap<String, ServiceHealth>) -> bool) {
        let begin = Instant::now();
        loop {
            while let Some(message) = self.health.receive().unwrap() {
                for health in message.items() {
                    self.seen.insert(text::unpack(&health.service).to_owned(), *health);
                    if condition(&self.seen) {
                        return;
                    }
                }
            }
            assert!(begin.elapsed() < PATIENCE, "never heard: {what}");
            self.participant.wait(&[&self.health], Duration::from_millis(20));
        }
    }

    /// Listens until a service has finished so many scans.
    pub fn until_finished(&mut self, service: &str, scans: u32) {
        self.until(&format!("{service} has finished {scans} scans"), |seen| {
            seen.get(service).is_some_and(|h| h.finished_scans >= scans)
        });
    }

    /// Process id of the service's present incarnation, as far as it was heard.
    pub fn pid(&self, service: &str) -> u32 {
        self.seen.get(service).map(|h| h.pid).unwrap()
    }

    /// The last word of every service.
    pub fn seen(&self) -> &BTreeMap<String, ServiceHealth> {
        &self.seen
    }
}

/// Kills a process at once, without the detour through another program.
pub fn kill_9(pid: u32) {
    let pid = i32::try_from(pid).ok().and_then(rustix::process::Pid::from_raw).unwrap();
    // It may have ended in this moment; then the test that expects a restart says so.
    let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL);
}

/// Whether a process is there and not only waiting to be reaped.
pub fn is_running(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with(['Z', 'X']))
}
