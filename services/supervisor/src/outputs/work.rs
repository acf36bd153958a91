//! What the services did for each scan: what they waited for, when they worked, and what that cost.

use std::collections::BTreeMap;

use mirador_ipc_schema::messages::{Delay, ServiceHealth, WorkSpan};
use mirador_ipc_schema::text;
use serde::Serialize;

use super::histogram::{Latencies, Quantiles};

/// A piece of work, and whose it was.
#[derive(Debug, Clone, PartialEq)]
pub struct ServiceWork {
    /// The service.
    pub service: String,
    /// Its process.
    pub pid: u32,
    /// What it did.
    pub span: WorkSpan,
}

impl ServiceWork {
    /// Name of the work.
    #[must_use]
    pub fn stage(&self) -> &str {
        text::unpack(&self.span.stage)
    }
}

/// What a process has used since its start, or between two moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Usage {
    /// CPU time [ns].
    pub cpu_ns: u64,
    /// Page faults that needed no disk.
    pub minor_faults: u64,
    /// Page faults that had to wait for a disk.
    pub major_faults: u64,
    /// Times it gave up the processor to wait.
    pub voluntary_switches: u64,
    /// Times the processor was taken from it.
    pub involuntary_switches: u64,
}

impl Usage {
    /// What a service reports of itself.
    #[must_use]
    pub fn of(health: &ServiceHealth) -> Self {
        Self {
            cpu_ns: health.cpu_ns,
            minor_faults: health.minor_faults,
            major_faults: health.major_faults,
            voluntary_switches: health.voluntary_switches,
            involuntary_switches: health.involuntary_switches,
        }
    }

    /// Both together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        self.each(other, u64::saturating_add)
    }

    /// What came after `earlier`.
    #[must_use]
    pub fn since(self, earlier: Self) -> Self {
        self.each(earlier, u64::saturating_sub)
    }

    fn each(self, other: Self, combine: fn(u64, u64) -> u64) -> Self {
        Self {
            cpu_ns: combine(self.cpu_ns, other.cpu_ns),
            minor_faults: combine(self.minor_faults, other.minor_faults),
            major_faults: combine(self.major_faults, other.major_faults),
            voluntary_switches: combine(self.voluntary_switches, other.voluntary_switches),
            involuntary_switches: combine(self.involuntary_switches, other.involuntary_switches),
        }
    }
}

/// What a service used for one scan: from the end of the one before to the end of this.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanUsage {
    /// The service.
    pub service: String,
    /// The scan.
    pub scan: u32,
    /// What it used.
    pub used: Usage,
}

/// The parts of the time from an input to the end of the work on it.
#[derive(Debug, Clone, Default)]
pub struct WorkTimes {
    /// The thread was busy with something else.
    pub waiting: Latencies,
    /// It slept, and had to be woken.
    pub wake_up: Latencies,
    /// Awake, it took the message and what belongs to it.
    pub taking: Latencies,
    /// The work itself.
    pub computing: Latencies,
}

/// Names of the parts, in the order of [`WorkTimes::parts`].
pub const PARTS: [&str; 4] = ["waiting", "wake_up", "taking", "computing"];

impl WorkTimes {
    /// Adds one piece of work. Work without an input has no delay.
    pub fn add(&mut self, span: &WorkSpan) {
        if span.input_ns > 0 {
            let Delay { waiting, wake_up, taking } = span.delay();
            self.waiting.add(waiting);
            self.wake_up.add(wake_up);
            self.taking.add(taking);
        }
        self.computing.add(span.computing());
    }

    /// The parts, in the order of [`PARTS`].
    #[must_use]
    pub fn parts(&self) -> [&Latencies; 4] {
        [&self.waiting, &self.wake_up, &self.taking, &self.computing]
    }
}

/// The parts of a piece of work in figures, as in `summary.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkQuantiles {
    /// The service that does it.
    pub service: String,
    /// The thread was busy with something else.
    pub waiting: Quantiles,
    /// It slept, and had to be woken.
    pub wake_up: Quantiles,
    /// Awake, it took the message and what belongs to it.
    pub taking: Quantiles,
    /// The work itself.
    pub computing: Quantiles,
}

/// Puts together what the health messages of a run tell.
#[derive(Debug, Clone, Default)]
pub struct WorkLog {
    /// Every piece of work, in the order in which it was told.
    pub spans: Vec<ServiceWork>,
    /// What each service used for each scan.
    pub usage: Vec<ScanUsage>,
    /// Process, finished scans and counters at the last report.
    last: BTreeMap<String, (u32, u32, Usage)>,
}

impl WorkLog {
    /// Takes in a report.
    pub fn take(&mut self, health: &ServiceHealth) {
        let (service, used) = (text::unpack(&health.service).to_owned(), Usage::of(health));
        let spans =
            health.work().iter().map(|span| ServiceWork { service: service.clone(), pid: health.pid, span: *span });
        self.spans.extend(spans);
        let now = (health.pid, health.finished_scans, used);
        if let Some((pid, finished, before)) = self.last.insert(service.clone(), now)
            && pid == health.pid
            && health.finished_scans == finished + 1
        {
            self.usage.push(ScanUsage { service, scan: finished, used: used.since(before) });
        }
    }

    /// The times of every kind of work, by service and stage in the order of their first end.
    #[must_use]
    pub fn times(&self) -> Vec<(&str, &str, WorkTimes)> {
        let mut order: Vec<(&str, &str, WorkTimes)> = Vec::new();
        for work in &self.spans {
            let place = order.iter().position(|(service, stage, _)| *service == work.service && *stage == work.stage());
            let place = place.unwrap_or_else(|| {
                order.push((&work.service, work.stage(), WorkTimes::default()));
                order.len() - 1
            });
            order[place].2.add(&work.span);
        }
        order
    }

    /// The figures of every kind of work, by the name of the work.
    #[must_use]
    pub fn quantiles(&self) -> BTreeMap<String, WorkQuantiles> {
        let figures = |(service, stage, times): (&str, &str, WorkTimes)| {
            let [waiting, wake_up, taking, computing] = times.parts().map(Latencies::quantiles);
            (stage.to_owned(), WorkQuantiles { service: service.to_owned(), waiting, wake_up, taking, computing })
        };
        self.times().into_iter().map(figures).collect()
    }
}

#[cfg(test)]
mod tests {
    use mirador_ipc_schema::messages::MAX_WORK_SPANS;

    use super::*;

    fn report(pid: u32, finished_scans: u32, cpu_ns: u64, work: &[WorkSpan]) -> ServiceHealth {
        let mut spans = [WorkSpan::default(); MAX_WORK_SPANS];
        spans[..work.len()].copy_from_slice(work);
        let (service, span_count) = (text::pack("analysis"), work.len() as u32);
        ServiceHealth { service, pid, finished_scans, cpu_ns, spans, span_count, ..ServiceHealth::default() }
    }

    fn span(stage: &str, input_ns: u64, began_ns: u64) -> WorkSpan {
        let (asleep_ns, woke_ns) = (input_ns.saturating_sub(10), began_ns - 5);
        let ended_ns = began_ns + 2_000_000;
        WorkSpan { stage: text::pack(stage), input_ns, asleep_ns, woke_ns, began_ns, ended_ns, ..WorkSpan::default() }
    }

    #[test]
    fn the_parts_of_every_kind_of_work_are_told_apart() {
        let mut log = WorkLog::default();
        log.take(&report(1, 1, 100, &[span("surface", 1000, 31_005), span("scores", 0, 50_000)]));
        log.take(&report(1, 2, 350, &[span("surface", 2000, 12_005)]));
        let figures = log.quantiles();
        let surface = &figures["surface"];
        assert_eq!((surface.wake_up.n, surface.wake_up.max), (2, Some(0.03)));
        assert_eq!((surface.taking.max, surface.waiting.max), (Some(5e-6), Some(0.0)));
        let scores = &figures["scores"];
        assert_eq!((scores.wake_up.n, scores.computing.n, scores.computing.max), (0, 1, Some(2.0)));
        assert_eq!(
            log.usage,
            [ScanUsage { service: "analysis".into(), scan: 1, used: Usage { cpu_ns: 250, ..Usage::default() } }]
        );
    }

    #[test]
    fn a_restart_and_several_scans_at_once_give_no_usage_of_a_scan() {
        let mut log = WorkLog::default();
        for (pid, finished, cpu) in [(1, 1, 100), (2, 2, 40), (2, 2, 50), (2, 4, 90), (2, 5, 100)] {
            log.take(&report(pid, finished, cpu, &[]));
        }
        let used: Vec<(u32, u64)> = log.usage.iter().map(|u| (u.scan, u.used.cpu_ns)).collect();
        assert_eq!(used, [(4, 10)]);
    }
}
