//! What every service needs besides its ports: its place in the graph, and a way to say how it is.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use crate::domain::Domain;
use crate::messages::{
    Envelope, Header, MAX_WORK_SPANS, SERVICE_FAILED, SERVICE_RUNNING, SERVICE_STARTING, ServiceHealth, WorkSpan,
};
use crate::port::{JoinError, Participant, PortError, PublishError, Publisher, StopSignal, Wake};
use crate::text;
use crate::topics::{self, Sizes};

/// How often a service says that it is alive, and serves late joiners, while it has nothing to do.
pub const HEARTBEAT: Duration = Duration::from_millis(50);

/// The place of one service in a graph.
#[derive(Debug, Clone)]
pub struct ServiceSetup {
    /// Name of the service.
    pub name: String,
    /// The graph's domain.
    pub domain: Domain,
    /// How often the service was started in this run, from 0.
    pub incarnation: u32,
    /// Sizes of the slots.
    pub sizes: Sizes,
    /// How it learns of messages.
    pub wake: Wake,
    /// The run directory: outputs, logs, and what is needed to go on after a restart.
    pub run_dir: PathBuf,
    /// Number of the run, below 2^24.
    pub run: u32,
    /// Worker threads.
    pub threads: usize,
    /// Ends the service.
    pub stop: StopSignal,
}

/// The place of a program in a graph is not known.
#[derive(Debug, thiserror::Error)]
#[error("{variable} {reason}: this program is started by mirador, as [programs.NAME] or by services.NAME.command")]
pub struct EnvironmentError {
    /// The environment variable.
    pub variable: &'static str,
    /// What is wrong with it.
    pub reason: String,
}

impl ServiceSetup {
    /// The place of a program that the supervisor has started, from its environment.
    ///
    /// # Errors
    /// [`EnvironmentError`] names the variable that is missing or wrong.
    pub fn from_environment(stop: StopSignal) -> Result<Self, EnvironmentError> {
        Self::from_variables(stop, &|name| std::env::var(name).ok())
    }

    fn from_variables(
        stop: StopSignal,
        get: &dyn Fn(&'static str) -> Option<String>,
    ) -> Result<Self, EnvironmentError> {
        let text = |variable| get(variable).ok_or_else(|| EnvironmentError { variable, reason: "is not set".into() });
        let number = |variable| {
            let text = text(variable)?;
            let wrong = |_| EnvironmentError { variable, reason: format!("is no number ({text})") };
            text.parse::<u32>().map_err(wrong)
        };
        let domain = Domain::new(&text("MIRADOR_DOMAIN")?)
            .map_err(|e| EnvironmentError { variable: "MIRADOR_DOMAIN", reason: format!("is wrong ({e})") })?;
        Ok(Self {
            name: text("MIRADOR_NAME")?,
            domain,
            incarnation: number("MIRADOR_INCARNATION")?,
            sizes: Sizes { scan_points: number("MIRADOR_MAX_POINTS")? as usize },
            wake: Wake::Event,
            run_dir: text("MIRADOR_RUN_DIR")?.into(),
            run: number("MIRADOR_RUN")?,
            threads: number("MIRADOR_THREADS")? as usize,
            stop,
        })
    }

    /// Joins the domain.
    ///
    /// # Errors
    /// See [`JoinError`].
    pub fn join(&self) -> Result<Participant, JoinError> {
        Participant::join(self.domain.clone(), &self.name, self.incarnation, self.sizes, self.wake, self.stop.clone())
    }

    /// The file in which the service keeps what it needs after a restart.
    #[must_use]
    pub fn state_file(&self) -> PathBuf {
        self.run_dir.join("state").join(format!("{}.state", self.name))
    }
}

/// Says how a service is: at the start, every [`HEARTBEAT`], and whenever it has finished a scan. Each report begins with
/// connecting the readers of the process (see [`RollCall`](crate::RollCall)).
pub struct HealthReporter {
    publisher: Publisher<topics::ServiceHealth>,
    service: [u8; 32],
    state: u32,
    finished_scans: u32,
    last_work: Duration,
    message: [u8; 200],
    /// Work that was not told of yet.
    spans: [WorkSpan; MAX_WORK_SPANS],
    span_count: u32,
    last_report: Instant,
}

impl HealthReporter {
    /// Opens the topic and reports "starting".
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn open(participant: &Participant, service: &str) -> Result<Self, PortError> {
        let publisher = participant.publisher::<topics::ServiceHealth>()?;
        let mut reporter = Self {
            publisher,
            service: text::pack(service),
            state: SERVICE_STARTING,
            finished_scans: 0,
            last_work: Duration::ZERO,
            message: [0; 200],
            spans: Default::default(),
            span_count: 0,
            last_report: Instant::now(),
        };
        reporter.report(participant);
        Ok(reporter)
    }

    /// Ports are open; work begins.
    pub fn running(&mut self, participant: &Participant) {
        self.state = SERVICE_RUNNING;
        self.report(participant);
    }

    /// Every scan of the run below `count` is done: the acknowledgement of lockstep. Tells of the work since the last one.
    pub fn finished(&mut self, participant: &Participant, count: u32, work: Duration) {
        self.finished_scans = count;
        self.last_work = work;
        self.report_with_work(participant, self.span_count);
        self.span_count = 0;
    }

    /// Notes a piece of work, to be told with the next finished scan. What is too much for one report is left out.
    pub fn worked(&mut self, span: WorkSpan) {
        if let Some(place) = self.spans.get_mut(self.span_count as usize) {
            *place = span;
            self.span_count += 1;
        }
    }

    /// Number of scans finished.
    #[must_use]
    pub fn finished_scans(&self) -> u32 {
        self.finished_scans
    }

    /// The service cannot go on.
    pub fn failed(&mut self, participant: &Participant, why: &str) {
        self.state = SERVICE_FAILED;
        self.message = text::pack(why);
        self.report(participant);
    }

    /// Says what the service is doing.
    pub fn message(&mut self, what: &str) {
        self.message = text::pack(what);
    }

    /// Reports when the last report is older than [`HEARTBEAT`]; call it whenever a wait ends.
    pub fn heartbeat(&mut self, participant: &Participant) {
        if self.last_report.elapsed() >= HEARTBEAT {
            self.report(participant);
        }
    }

    fn report(&mut self, participant: &Participant) {
        self.report_with_work(participant, 0);
    }

    fn report_with_work(&mut self, participant: &Participant, span_count: u32) {
        self.last_report = Instant::now();
        let header = Header::new(u64::from(self.finished_scans), 0);
        participant.connect();
        let counters = participant.counters();
        let usage = Usage::now();
        let health = ServiceHealth {
            service: self.service,
            pid: std::process::id(),
            state: self.state,
            finished_scans: self.finished_scans,
            span_count,
            resident_bytes: usage.resident_bytes,
            cpu_ns: usage.cpu_ns,
            copied_payload_bytes: counters.copied_payload_bytes.get(),
            lost_messages: counters.lost.get(),
            undelivered_messages: counters.undelivered.get(),
            sent_messages: counters.sent.get(),
            received_messages: counters.received.get(),
            last_work_ns: u64::try_from(self.last_work.as_nanos()).unwrap_or(u64::MAX),
            minor_faults: usage.minor_faults,
            major_faults: usage.major_faults,
            voluntary_switches: usage.voluntary_switches,
            involuntary_switches: usage.involuntary_switches,
            message: self.message,
            spans: self.spans,
        };
        match self.publisher.send_one(Envelope { header }, health) {
            Ok(()) => {}
            // Health is sent again in a moment, so one report that did not get out is only worth a line in the log.
            Err(PublishError::Loan(error)) => tracing::warn!(%error, "health not reported"),
            Err(PublishError::Send(error)) => tracing::warn!(%error, "health not reported"),
        }
    }
}

/// What the system says of this process.
#[derive(Debug, Default, Clone, Copy)]
struct Usage {
    resident_bytes: u64,
    cpu_ns: u64,
    minor_faults: u64,
    major_faults: u64,
    voluntary_switches: u64,
    involuntary_switches: u64,
}

impl Usage {
    fn now() -> Self {
        let mut usage = Self::default();
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        usage.cpu_ns = cpu.tv_sec.unsigned_abs() * 1_000_000_000 + cpu.tv_nsec.unsigned_abs();
        if let Ok(status) = std::fs::read_to_string("/proc/self/status") {
            for line in status.lines() {
                let number = || line.split_ascii_whitespace().nth(1).and_then(|n| n.parse::<u64>().ok()).unwrap_or(0);
                if line.starts_with("VmRSS:") {
                    usage.resident_bytes = number() * 1024;
                } else if line.starts_with("voluntary_ctxt_switches:") {
                    usage.voluntary_switches = number();
                } else if line.starts_with("nonvoluntary_ctxt_switches:") {
                    usage.involuntary_switches = number();
                }
            }
        }
        if let Ok(stat) = std::fs::read_to_string("/proc/self/stat") {
            // Fields 10 and 12 of proc(5); the name in field 2 may hold spaces, so count behind its closing bracket.
            let behind_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
            let field =
                |n: usize| behind_name.split_ascii_whitespace().nth(n).and_then(|n| n.parse().ok()).unwrap_or(0);
            (usage.minor_faults, usage.major_faults) = (field(7), field(9));
        }
        usage
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_learns_its_place_from_its_environment_or_what_is_missing() {
        let variable = |name: &'static str| {
            let value = match name {
                "MIRADOR_NAME" => "alignment",
                "MIRADOR_DOMAIN" => "yard",
                "MIRADOR_RUN_DIR" => "/tmp/run",
                _ => "7",
            };
            Some(value.to_owned())
        };
        let setup = ServiceSetup::from_variables(StopSignal::default(), &variable).unwrap();
        assert_eq!((setup.name.as_str(), setup.domain.name(), setup.incarnation), ("alignment", "yard", 7));
        assert_eq!((setup.sizes.scan_points, setup.threads), (7, 7));
        let without = |missing: &'static str| {
            let get = move |name| if name == missing { None } else { variable(name) };
            ServiceSetup::from_variables(StopSignal::default(), &get).map(|_| ()).unwrap_err().to_string()
        };
        assert!(without("MIRADOR_RUN").starts_with("MIRADOR_RUN is not set: this program is started by mirador"));
        let wrong = |name| if name == "MIRADOR_MAX_POINTS" { Some("many".into()) } else { variable(name) };
        let error = ServiceSetup::from_variables(StopSignal::default(), &wrong).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("MIRADOR_MAX_POINTS is no number (many)"), "{error}");
    }

    #[test]
    fn a_process_knows_its_memory_and_time() {
        let usage = Usage::now();
        assert!(usage.resident_bytes > 100_000 && usage.cpu_ns > 0 && usage.minor_faults > 10);
    }
}
