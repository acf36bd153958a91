//! What the supervisor hears from the graph: health, clock, decisions.

use std::any::Any;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use mirador_ipc_schema::messages::{CLOCK_ENDED, CLOCK_FAULT, Envelope, Header, SERVICE_FAILED, ServiceHealth};
use mirador_ipc_schema::{Participant, Publisher, Subscriber, Wakeable, text, topics};

use super::registration::RegistrationTally;
use crate::outputs::{ServiceTotals, Usage};

/// The counters of one service, summed over its incarnations.
#[derive(Debug, Default)]
struct Tally {
    totals: ServiceTotals,
    pid: u32,
    /// What earlier incarnations had counted.
    before: ServiceTotals,
}

impl Tally {
    fn take_in(&mut self, health: &ServiceHealth) {
        if self.pid != health.pid {
            self.before = self.totals.clone();
            self.pid = health.pid;
        }
        let (totals, before) = (&mut self.totals, &self.before);
        totals.resident_bytes = totals.resident_bytes.max(health.resident_bytes);
        totals.usage = before.usage.plus(Usage::of(health));
        totals.copied_payload_bytes = before.copied_payload_bytes + health.copied_payload_bytes;
        totals.lost_messages = before.lost_messages + health.lost_messages;
        totals.undelivered_messages = before.undelivered_messages + health.undelivered_messages;
        totals.sent_messages = before.sent_messages + health.sent_messages;
        totals.received_messages = before.received_messages + health.received_messages;
    }
}

/// The supervisor's place in the graph.
pub struct Monitor {
    health: Subscriber<topics::ServiceHealth>,
    clock: Subscriber<topics::Clock>,
    plans: Subscriber<topics::ViewPlan>,
    navigation: Subscriber<topics::NavigationStatus>,
    robot: Subscriber<topics::RobotState>,
    registrations: Subscriber<topics::RegistrationStatus>,
    /// For those who cannot speak any more.
    obituaries: Publisher<topics::ServiceHealth>,
    /// What is said of programs that have ended and stay so.
    lost: BTreeMap<String, ServiceHealth>,
    /// When a process was last heard.
    heard: BTreeMap<String, Instant>,
    /// Counters of every service.
    tallies: BTreeMap<String, Tally>,
    /// Scans the source will deliver; 0 while unknown.
    pub scans_expected: u32,
    /// Scans planned on.
    pub scans_planned: u32,
    /// Whether the last scan is finished.
    pub ended: bool,
    /// Why the source cannot go on.
    pub fault: Option<String>,
    /// The latest decision in a few words.
    pub decision: String,
    /// What the robot does and how far it has driven, in a few words; empty where none drives.
    pub driving: String,
    driven_m: Driven,
    /// How a foreign registration does.
    pub registration: RegistrationTally,
    /// Keeps every topic alive, so that its rules hold although its users come and go.
    _topics: Vec<Box<dyn Any>>,
}

/// What the run cannot go on without once it says that it has failed.
const INDISPENSABLE: [&str; 4] = ["simulator", "acquisition", "localization", "navigation"];

/// The distance driven over all paths.
#[derive(Debug, Default)]
struct Driven {
    plan: u64,
    on_path: f64,
    before: f64,
}

impl Driven {
    fn take_in(&mut self, plan: u64, on_path: f64) -> f64 {
        if plan != self.plan {
            self.before += self.on_path;
            self.plan = plan;
        }
        self.on_path = on_path;
        self.before + self.on_path
    }
}

/// A state of navigation in a word.
fn navigation_word(state: u32) -> &'static str {
    match state {
        0 => "standing",
        1 => "driving",
        2 => "arrived",
        3 => "blocked",
        4 => "recovering",
        5 => "gave up",
        _ => "in a state unknown to this version",
    }
}

impl Monitor {
    /// Opens the topics, all of them, before any service starts.
    pub fn open(participant: &Participant) -> Result<Self> {
        let mut held = Vec::new();
        macro_rules! hold {
            ($topic:ty) => {
                held.push(participant.hold_topic::<$topic>()?)
            };
        }
        mirador_ipc_schema::for_each_topic!(hold);
        Ok(Self {
            health: participant.subscriber()?,
            clock: participant.subscriber()?,
            plans: participant.subscriber()?,
            navigation: participant.subscriber()?,
            robot: participant.subscriber()?,
            registrations: participant.subscriber()?,
            obituaries: participant.publisher()?,
            lost: BTreeMap::new(),
            heard: BTreeMap::new(),
            registration: RegistrationTally::default(),
            tallies: BTreeMap::new(),
            scans_expected: 0,
            scans_planned: 0,
            ended: false,
            fault: None,
            decision: String::new(),
            driving: String::new(),
            driven_m: Driven::default(),
            _topics: held,
        })
    }

    /// What wakes the supervisor.
    pub fn wakeables(&self) -> [&dyn Wakeable; 4] {
        [&self.health, &self.clock, &self.plans, &self.navigation]
    }

    /// Takes in what is there.
    pub fn listen(&mut self) -> Result<()> {
        while let Some(message) = self.health.receive()? {
            for health in message.items() {
                let name = text::unpack(&health.service);
                self.heard.insert(name.to_owned(), Instant::now());
                self.tallies.entry(name.to_owned()).or_default().take_in(health);
                if health.state == SERVICE_FAILED && INDISPENSABLE.contains(&name) {
                    self.fault = Some(text::unpack(&health.message).to_owned());
                }
            }
        }
        while let Some(message) = self.clock.receive()? {
            let clock = message.meta();
            self.scans_expected = clock.scans_expected;
            self.ended |= clock.state == CLOCK_ENDED;
            if clock.state == CLOCK_FAULT && self.fault.is_none() {
                self.fault = Some("the source cannot go on".into());
            }
        }
        while let Some(message) = self.plans.receive()? {
            let plan = message.meta();
            self.scans_planned = self.scans_planned.max(plan.header.scan() + 1);
            let milliseconds = message.header().sent_ns.saturating_sub(plan.scan_sent_ns) as f64 * 1e-6;
            self.decision = format!("{}, {milliseconds:.0} ms", text::unpack(&plan.reason_code));
            if self.scans_expected == 0 {
                let (known, quality) = (plan.cells_known, 100.0 * plan.mean_quality);
                self.decision = format!("{}, {known} cells known, quality {quality:.0} %", self.decision);
            }
        }
        while let Some(message) = self.registrations.receive()? {
            for status in message.items() {
                self.registration.take_in(message.header().incarnation, status);
            }
        }
        while let Some(message) = self.robot.receive()? {
            if message.items().iter().any(|robot| robot.tipped != 0) {
                self.fault.get_or_insert_with(|| "the robot has tipped over".into());
            }
        }
        while let Some(message) = self.navigation.receive()? {
            for status in message.items() {
                let driven = self.driven_m.take_in(status.plan_id, status.driven_m);
                self.driving = format!(", {driven:.0} m, {}", navigation_word(status.state));
            }
        }
        Ok(())
    }

    /// How long nothing was heard of a process that was heard of before.
    pub fn silent_for(&self, name: &str) -> Option<Duration> {
        self.heard.get(name).map(Instant::elapsed)
    }

    /// A process is another from now on, and was not heard of.
    pub fn forget(&mut self, name: &str) {
        self.heard.remove(name);
    }

    /// Says of a program that has ended, and stays so, why it has.
    pub fn mourn(&mut self, name: &str, cause: &str) {
        let health = ServiceHealth {
            service: text::pack(name),
            state: SERVICE_FAILED,
            message: text::pack(cause),
            ..ServiceHealth::default()
        };
        self.lost.insert(name.to_owned(), health);
        self.repeat_losses();
    }

    /// Says again of whom it was said, for those who came later.
    pub fn repeat_losses(&self) {
        self.obituaries.serve_late_joiners();
        for health in self.lost.values() {
            if let Err(error) = self.obituaries.send_one(Envelope { header: Header::new(0, 0) }, *health) {
                tracing::debug!(%error, "the end of a program was not told");
            }
        }
    }

    /// The counters of a service, with its name and restarts filled in.
    pub fn totals_of(&self, service: &str, restarts: u32) -> ServiceTotals {
        let totals = self.tallies.get(service).map(|t| t.totals.clone()).unwrap_or_default();
        ServiceTotals { name: service.to_owned(), restarts, ..totals }
    }
}
