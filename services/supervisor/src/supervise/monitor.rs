//! What the supervisor hears from the graph: health, clock, decisions.

use std::any::Any;
use std::collections::BTreeMap;

use anyhow::Result;
use mirador_ipc_schema::messages::{CLOCK_ENDED, CLOCK_FAULT, SERVICE_FAILED, ServiceHealth};
use mirador_ipc_schema::{Participant, Subscriber, Wakeable, text, topics};
use serde::Serialize;

/// The counters of a service, summed over its incarnations.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ServiceTotals {
    /// Scans finished.
    pub finished_scans: u32,
    /// Greatest resident memory seen [bytes].
    pub resident_bytes: u64,
    /// CPU time [ns].
    pub cpu_ns: u64,
    /// Payload bytes copied through the ports.
    pub copied_payload_bytes: u64,
    /// Messages found missing.
    pub lost_messages: u64,
    /// Messages not delivered within the back-pressure limit.
    pub undelivered_messages: u64,
    /// Times it was started again.
    pub restarts: u32,
    #[serde(skip)]
    pid: u32,
    #[serde(skip)]
    before: Earlier,
}

/// What earlier incarnations had counted.
#[derive(Debug, Clone, Copy, Default)]
struct Earlier {
    cpu_ns: u64,
    copied: u64,
    lost: u64,
    undelivered: u64,
}

impl ServiceTotals {
    fn take_in(&mut self, health: &ServiceHealth) {
        if self.pid != health.pid {
            self.before = Earlier {
                cpu_ns: self.cpu_ns,
                copied: self.copied_payload_bytes,
                lost: self.lost_messages,
                undelivered: self.undelivered_messages,
            };
            self.pid = health.pid;
        }
        self.finished_scans = self.finished_scans.max(health.finished_scans);
        self.resident_bytes = self.resident_bytes.max(health.resident_bytes);
        self.cpu_ns = self.before.cpu_ns + health.cpu_ns;
        self.copied_payload_bytes = self.before.copied + health.copied_payload_bytes;
        self.lost_messages = self.before.lost + health.lost_messages;
        self.undelivered_messages = self.before.undelivered + health.undelivered_messages;
    }
}

/// The counters of the whole graph.
pub type Totals = BTreeMap<String, ServiceTotals>;

/// The supervisor's place in the graph.
pub struct Monitor {
    health: Subscriber<topics::ServiceHealth>,
    clock: Subscriber<topics::Clock>,
    plans: Subscriber<topics::ViewPlan>,
    /// Counters of every service.
    pub totals: Totals,
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
    /// Keeps every topic alive, so that its rules hold although its users come and go.
    _topics: Vec<Box<dyn Any>>,
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
            totals: Totals::new(),
            scans_expected: 0,
            scans_planned: 0,
            ended: false,
            fault: None,
            decision: String::new(),
            _topics: held,
        })
    }

    /// What wakes the supervisor.
    pub fn wakeables(&self) -> [&dyn Wakeable; 3] {
        [&self.health, &self.clock, &self.plans]
    }

    /// Takes in what is there.
    pub fn listen(&mut self) -> Result<()> {
        while let Some(message) = self.health.receive()? {
            for health in message.items() {
                let name = text::unpack(&health.service);
                self.totals.entry(name.to_owned()).or_default().take_in(health);
                if health.state == SERVICE_FAILED && name == "acquisition" {
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
        }
        Ok(())
    }
}
