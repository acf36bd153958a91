//! What was heard of a graph, and what follows from it.

use std::collections::{BTreeMap, VecDeque};

use mirador_ipc_schema::messages::{
    AlignmentMeta, CLOCK_ENDED, CLOCK_FAULT, CLOCK_RUNNING, ClockMeta, DECISION_GO, RegistrationStatus, SERVICE_FAILED,
    SERVICE_RUNNING, SERVICE_STARTING, SERVICE_STOPPING, ServiceHealth, ViewPlanMeta,
};
use mirador_ipc_schema::{Header, Peer, text};

use super::view::{Decision, Run, Service, Snapshot, Stage};
use crate::graph::SERVICES;
use crate::outputs::{Latencies, Usage, WorkQuantiles, WorkTimes};
use crate::supervise::RegistrationTally;

/// Rates are taken over this time [ns].
const RATE_WINDOW_NS: u64 = 1_000_000_000;
/// A rate over less than this says nothing [ns].
const RATE_SHORTEST_NS: u64 = 200_000_000;
/// A service that was not heard for this long is silent [ns].
const SILENT_NS: u64 = 1_000_000_000;
/// A service that was not heard for this long is gone [ns].
const GONE_NS: u64 = 5_000_000_000;
/// The process that reports no health, and is not waited for.
const SUPERVISOR: &str = "supervisor";

/// What was heard of a graph.
#[derive(Debug, Default)]
pub(super) struct State {
    services: BTreeMap<String, Heard>,
    stages: BTreeMap<StageName, StageTimes>,
    work: BTreeMap<String, (String, WorkTimes)>,
    clock: Option<ClockMeta>,
    scans_planned: u32,
    decision: Option<Decision>,
    registration: RegistrationTally,
    notes: Vec<String>,
}

/// The stages, in the order they are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum StageName {
    Alignment,
    Analysis,
    Map,
    Planning,
    EndToEnd,
}

impl StageName {
    fn word(self) -> &'static str {
        match self {
            Self::Alignment => "alignment",
            Self::Analysis => "analysis",
            Self::Map => "map",
            Self::Planning => "planning",
            Self::EndToEnd => "end_to_end",
        }
    }
}

/// One service.
#[derive(Debug)]
struct Heard {
    last: ServiceHealth,
    sent_ns: u64,
    incarnation: u32,
    /// Every process that reported under this name.
    pids: Vec<u32>,
    /// The reports of about the last second of the present process, oldest first.
    window: VecDeque<Mark>,
}

/// The counters that rates are made of, at one moment.
#[derive(Debug, Clone, Copy)]
struct Mark {
    sent_ns: u64,
    usage: Usage,
    received: u64,
    sent: u64,
}

/// Latencies of one stage.
#[derive(Debug, Default)]
struct StageTimes {
    all: Latencies,
    /// The last one [ns].
    last: u64,
}

impl State {
    /// Takes in a report of health.
    pub(super) fn take_health(&mut self, header: &Header, health: &ServiceHealth) {
        let name = text::unpack(&health.service);
        let finished_before = self.services.get(name).map(|heard| heard.last.finished_scans);
        match self.services.get_mut(name) {
            Some(heard) => heard.take_in(header, health),
            None => {
                self.services.insert(name.to_owned(), Heard::new(header, health));
            }
        }
        self.take_work(name, health);
        // Analysis tells its time with the scan it has finished; a scan it took over after a restart cost it nothing.
        let finished_more = finished_before.is_some_and(|before| health.finished_scans > before);
        if name == "analysis" && finished_more && health.last_work_ns > 0 {
            self.add_latency(StageName::Analysis, health.last_work_ns);
        }
    }

    /// Takes in a step of the clock.
    pub(super) fn take_clock(&mut self, clock: &ClockMeta) {
        self.clock = Some(*clock);
    }

    /// Takes in an alignment.
    pub(super) fn take_alignment(&mut self, alignment: &AlignmentMeta) {
        self.add_latency(StageName::Alignment, alignment.prepare_ns.saturating_add(alignment.align_ns));
    }

    /// Takes in a view plan with this number of candidates.
    pub(super) fn take_plan(&mut self, plan: &ViewPlanMeta, candidates: usize) {
        let end_to_end = plan.header.sent_ns.saturating_sub(plan.scan_sent_ns);
        self.add_latency(StageName::Map, plan.map_ns);
        self.add_latency(StageName::Planning, plan.planning_ns);
        self.add_latency(StageName::EndToEnd, end_to_end);
        let scan = plan.header.scan();
        self.scans_planned = self.scans_planned.max(scan.saturating_add(1));
        self.decision = Some(Decision {
            scan,
            decision: if plan.decision == DECISION_GO { "go" } else { "stop" },
            reason_code: text::unpack(&plan.reason_code).to_owned(),
            reason: text::unpack(&plan.reason).to_owned(),
            strategy: text::unpack(&plan.strategy).to_owned(),
            candidates,
            path_length_m: plan.path_length_m,
            end_to_end_ms: milliseconds(end_to_end),
        });
    }

    /// Takes in how a foreign registration does.
    pub(super) fn take_registration(&mut self, header: &Header, status: &RegistrationStatus) {
        self.registration.take_in(header.incarnation, status);
    }

    /// Keeps a sentence about what cannot be shown.
    pub(super) fn add_note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Whether each of these processes has reported.
    pub(super) fn has_heard(&self, peers: &[Peer]) -> bool {
        let heard = |peer: &Peer| self.services.get(&peer.name).is_some_and(|h| h.last.pid == peer.pid);
        peers.iter().all(|peer| peer.name == SUPERVISOR || heard(peer))
    }

    /// What is shown at the time `now_ns` (CLOCK_MONOTONIC), with these living processes in the domain.
    pub(super) fn snapshot(&self, now_ns: u64, domain: &str, peers: &[Peer]) -> Snapshot {
        let mut services: Vec<Service> =
            self.services.iter().map(|(name, heard)| heard.service(name, now_ns)).collect();
        let unheard = |peer: &&Peer| peer.name != SUPERVISOR && !self.services.contains_key(&peer.name);
        services.extend(peers.iter().filter(unheard).map(unheard_service));
        let place = |name: &str| SERVICES.iter().position(|s| *s == name).unwrap_or(SERVICES.len());
        services.sort_by(|a, b| (place(&a.service), &a.service).cmp(&(place(&b.service), &b.service)));
        Snapshot {
            domain: domain.to_owned(),
            supervisor_pid: peers.iter().find(|p| p.name == SUPERVISOR).map(|p| p.pid),
            run: self.run(),
            services,
            stages: self.stages.iter().map(|(name, latencies)| latencies.stage(*name)).collect(),
            work: self.work(),
            provenance: "measured",
            decision: self.decision.clone(),
            registration: self.registration.totals(),
            notes: self.notes.clone(),
        }
    }

    fn run(&self) -> Run {
        let by_all = self.services.values().map(|heard| heard.last.finished_scans).min().unwrap_or(0);
        let plans = self.services.contains_key("planning") || self.scans_planned > 0;
        Run {
            state: match self.clock.map(|clock| clock.state) {
                Some(CLOCK_RUNNING) => "running",
                Some(CLOCK_ENDED) => "ended",
                Some(CLOCK_FAULT) => "fault",
                _ => "unknown",
            },
            lockstep: self.clock.map(|clock| clock.lockstep == 1),
            scans_done: if plans { self.scans_planned } else { by_all },
            scans_expected: self.clock.map(|clock| clock.scans_expected).filter(|n| *n > 0),
            scans_failed: self.clock.map_or(0, |clock| clock.scans_failed),
        }
    }

    fn add_latency(&mut self, stage: StageName, ns: u64) {
        let times = self.stages.entry(stage).or_default();
        times.all.add(ns);
        times.last = ns;
    }

    /// Takes in what a service tells of its work, for it tells it once.
    fn take_work(&mut self, service: &str, health: &ServiceHealth) {
        for span in health.work() {
            let (of, times) = self.work.entry(text::unpack(&span.stage).to_owned()).or_default();
            service.clone_into(of);
            times.add(span);
        }
    }

    fn work(&self) -> BTreeMap<String, WorkQuantiles> {
        let figures = |(stage, (service, times)): (&String, &(String, WorkTimes))| {
            let [waiting, wake_up, taking, computing] = times.parts().map(Latencies::quantiles);
            (stage.clone(), WorkQuantiles { service: service.clone(), waiting, wake_up, taking, computing })
        };
        self.work.iter().map(figures).collect()
    }
}

impl StageTimes {
    fn stage(&self, name: StageName) -> Stage {
        let quantile = |share| milliseconds(self.all.quantile(share).unwrap_or(0));
        Stage {
            stage: name.word(),
            last_ms: milliseconds(self.last),
            p50_ms: quantile(0.5),
            p90_ms: quantile(0.9),
            p99_ms: quantile(0.99),
            p99_9_ms: quantile(0.999),
            max_ms: quantile(1.0),
            scans: self.all.count(),
        }
    }
}

impl Heard {
    fn new(header: &Header, health: &ServiceHealth) -> Self {
        let mark = Mark::of(header, health);
        Self {
            last: *health,
            sent_ns: header.sent_ns,
            incarnation: header.incarnation,
            pids: vec![health.pid],
            window: VecDeque::from([mark]),
        }
    }

    fn take_in(&mut self, header: &Header, health: &ServiceHealth) {
        // What a process said before it died may be read after its successor was heard.
        if header.sent_ns < self.sent_ns {
            return;
        }
        if health.pid != self.last.pid || header.incarnation != self.incarnation {
            // The counters of a new process begin at zero.
            self.window.clear();
            if !self.pids.contains(&health.pid) {
                self.pids.push(health.pid);
            }
        }
        self.last = *health;
        self.sent_ns = header.sent_ns;
        self.incarnation = header.incarnation;
        self.window.push_back(Mark::of(header, health));
        // The oldest stays while it is the only one that is a whole window away.
        while self.window.get(1).is_some_and(|mark| header.sent_ns - mark.sent_ns >= RATE_WINDOW_NS) {
            self.window.pop_front();
        }
    }

    fn service(&self, name: &str, now_ns: u64) -> Service {
        let age = now_ns.saturating_sub(self.sent_ns);
        let rates = if age > SILENT_NS { None } else { self.rates() };
        let seen = u32::try_from(self.pids.len()).unwrap_or(u32::MAX).saturating_sub(1);
        Service {
            service: name.to_owned(),
            pid: self.last.pid,
            state: state_word(self.last.state, age),
            // The graph may have been looked at only after the first restarts, and foreign services may not count.
            restarts: self.incarnation.max(seen),
            finished_scans: self.last.finished_scans,
            cpu_percent: rates.map(|r| r.cpu_percent),
            resident_bytes: self.last.resident_bytes,
            faults_per_second: rates.map(|r| r.faults),
            switches_per_second: rates.map(|r| r.switches),
            usage: Usage::of(&self.last),
            messages_in_per_second: rates.map(|r| r.received),
            messages_out_per_second: rates.map(|r| r.sent),
            lost_messages: self.last.lost_messages,
            undelivered_messages: self.last.undelivered_messages,
            copied_payload_bytes: self.last.copied_payload_bytes,
            last_work_ms: milliseconds(self.last.last_work_ns),
            heard_ms_ago: Some(milliseconds(age)),
            message: text::unpack(&self.last.message).to_owned(),
        }
    }

    fn rates(&self) -> Option<Rates> {
        let (first, last) = (self.window.front()?, self.window.back()?);
        let ns = last.sent_ns.saturating_sub(first.sent_ns);
        if ns < RATE_SHORTEST_NS {
            return None;
        }
        let seconds = ns as f64 * 1e-9;
        let per_second = |first: u64, last: u64| last.saturating_sub(first) as f64 / seconds;
        let used = last.usage.since(first.usage);
        Some(Rates {
            cpu_percent: per_second(0, used.cpu_ns) * 1e-9 * 100.0,
            faults: per_second(0, used.minor_faults + used.major_faults),
            switches: per_second(0, used.voluntary_switches + used.involuntary_switches),
            received: per_second(first.received, last.received),
            sent: per_second(first.sent, last.sent),
        })
    }
}

impl Mark {
    fn of(header: &Header, health: &ServiceHealth) -> Self {
        Self {
            sent_ns: header.sent_ns,
            usage: Usage::of(health),
            received: health.received_messages,
            sent: health.sent_messages,
        }
    }
}

/// What a service does in a second.
#[derive(Debug, Clone, Copy)]
struct Rates {
    /// [percent of one core].
    cpu_percent: f64,
    /// Page faults [1/s].
    faults: f64,
    /// Context switches [1/s].
    switches: f64,
    /// Messages received [1/s].
    received: f64,
    /// Messages sent [1/s].
    sent: f64,
}

/// A process that runs but has not reported: it is starting, or a program that reports no health.
fn unheard_service(peer: &Peer) -> Service {
    Service {
        service: peer.name.clone(),
        pid: peer.pid,
        state: "unheard",
        restarts: 0,
        finished_scans: 0,
        cpu_percent: None,
        resident_bytes: 0,
        faults_per_second: None,
        switches_per_second: None,
        usage: Usage::default(),
        messages_in_per_second: None,
        messages_out_per_second: None,
        lost_messages: 0,
        undelivered_messages: 0,
        copied_payload_bytes: 0,
        last_work_ms: 0.0,
        heard_ms_ago: None,
        message: String::new(),
    }
}

fn state_word(state: u32, age_ns: u64) -> &'static str {
    match (state, age_ns) {
        (_, age) if age > GONE_NS => "gone",
        // Why it failed is worth more than that it has stopped talking.
        (SERVICE_FAILED, _) => "failed",
        (_, age) if age > SILENT_NS => "silent",
        (SERVICE_STARTING, _) => "starting",
        (SERVICE_RUNNING, _) => "running",
        (SERVICE_STOPPING, _) => "stopping",
        _ => "unknown",
    }
}

/// Whole microseconds are enough for anyone who looks.
fn milliseconds(ns: u64) -> f64 {
    (ns / 1_000) as f64 / 1e3
}

#[cfg(test)]
#[path = "state_tests.rs"]
mod tests;
