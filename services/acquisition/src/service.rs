//! The loop: clock, prior, scan; then wait until everyone is done.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::{
    CLOCK_ENDED, CLOCK_FAULT, CLOCK_RUNNING, ClockMeta, Envelope, Header, SCAN_HAS_PRIOR, ScanId, ScanMeta,
    ScanRequestKind, ServiceHealth, WorkSpan,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Pause, Publisher, RollCall, Subscriber, clock, text, topics};
use mirador_service_common::{CheckpointError, ServiceError, checkpoint, log_place};

use crate::no_return::empty_no_returns;
use crate::source::{Filtered, ScanInfo, Source, SourceError, open_source};
use crate::{AcquisitionConfig, SourceKind, live};

/// How long the end of a run in real time waits for services that get no further.
const PATIENCE: Duration = Duration::from_secs(10);

/// Delivers the scans of the configured source until the last one is finished and the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &AcquisitionConfig) -> Result<(), ServiceError> {
    if config.source == SourceKind::Robot {
        return live::run(setup, config);
    }
    let mut source = open_source(config, setup.threads).map_err(unusable)?;
    let participant = setup.join()?;
    let mut acquisition = Acquisition::open(setup, config, participant)?;
    match acquisition.deliver_all(source.as_mut()) {
        Ok(()) => Ok(()),
        Err(error) => {
            // What was delivered stands; the supervisor ends the run and says why.
            acquisition.health.failed(&acquisition.participant, &error.to_string());
            acquisition.send_clock(CLOCK_FAULT, 0, source.scans())?;
            tracing::error!(%error, "no further scan can be delivered");
            acquisition.serve_until_stopped(source.as_mut())?;
            Err(error)
        }
    }
}

struct Acquisition<'a> {
    setup: &'a ServiceSetup,
    config: &'a AcquisitionConfig,
    participant: Participant,
    clock: Publisher<topics::Clock>,
    pose: Publisher<topics::Pose>,
    scan: Publisher<topics::Scan>,
    requests: Subscriber<topics::ScanRequests>,
    others: Subscriber<topics::ServiceHealth>,
    health: HealthReporter,
    /// Scans finished by each service that is waited for.
    finished: BTreeMap<String, u32>,
}

impl<'a> Acquisition<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &'a AcquisitionConfig,
        participant: Participant,
    ) -> Result<Self, ServiceError> {
        Ok(Self {
            setup,
            config,
            others: participant.subscriber()?,
            requests: participant.subscriber()?,
            clock: participant.publisher()?,
            pose: participant.publisher()?,
            scan: participant.publisher()?,
            health: HealthReporter::open(&participant, &setup.name)?,
            finished: config.lockstep_with.iter().map(|name| (name.clone(), 0)).collect(),
            participant,
        })
    }

    fn deliver_all(&mut self, source: &mut dyn Source) -> Result<(), ServiceError> {
        tracing::info!(source = source.describe(), "source open");
        let total = u32::try_from(source.scans()).unwrap_or(u32::MAX);
        let first = self.released_before()?.min(total.saturating_sub(1));
        self.health.running(&self.participant);
        self.wait_for_services(source)?;
        let begin = Instant::now();
        let mut first_stamp = None;
        for step in first..total {
            let Some(info) = source.info(step as usize) else { break };
            let first_stamp = *first_stamp.get_or_insert(info.stamp_ns);
            self.wait_until_due(source, begin, info.stamp_ns - first_stamp)?;
            if self.setup.stop.is_set() {
                return Ok(());
            }
            self.release(source, step, &info)?;
            self.wait_until_finished(source, step)?;
        }
        self.wait_for_the_last(source, total)?;
        if !self.setup.stop.is_set() {
            self.send_clock(CLOCK_ENDED, total.saturating_sub(1), source.scans())?;
        }
        self.serve_until_stopped(source)
    }

    /// How many scans an earlier incarnation had released without knowing them finished; the last is sent again.
    fn released_before(&self) -> Result<u32, ServiceError> {
        if self.setup.incarnation == 0 {
            return Ok(0);
        }
        let path = self.setup.state_file();
        let Some(content) = checkpoint::load(&path)? else { return Ok(0) };
        let text = String::from_utf8_lossy(&content);
        text.trim().parse().map_err(|_| {
            CheckpointError::Invalid { path, reason: format!("'{}' is not the number of a scan", text.trim()) }.into()
        })
    }

    fn release(&mut self, source: &mut dyn Source, step: u32, info: &ScanInfo) -> Result<(), ServiceError> {
        checkpoint::save(&self.setup.state_file(), step.to_string().as_bytes())?;
        self.send_clock(CLOCK_RUNNING, step, source.scans())?;
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        self.send_scan(source, step, info)?;
        self.health.worked(WorkSpan::until_now("scan", step, 0, Pause::default(), began_ns));
        self.health.finished(&self.participant, step + 1, begin.elapsed());
        Ok(())
    }

    fn id(&self, scan: u32) -> u64 {
        ScanId { robot: 0, run: self.setup.run, scan }.pack()
    }

    fn send_clock(&self, state: u32, step: u32, scans: usize) -> Result<(), ServiceError> {
        let mut loan = self.clock.loan(1)?;
        *loan.meta_mut() = ClockMeta {
            header: Header::new(self.id(step), 0),
            scans_expected: u32::try_from(scans).unwrap_or(u32::MAX),
            state,
            lockstep: u32::from(self.config.speed == 0.0),
            ..ClockMeta::default()
        };
        Ok(loan.send()?)
    }

    fn send_scan(&self, source: &mut dyn Source, step: u32, info: &ScanInfo) -> Result<(), ServiceError> {
        let began_ns = clock::monotonic_ns();
        let header = Header { began_ns, ..Header::new(self.id(step), info.stamp_ns) };
        let mut loan = self.scan.loan(info.cells)?;
        let points: &mut [mirador_core::scan::Point] = bytemuck::cast_slice_mut(loan.items_mut());
        let written = source.write(step as usize, points).map_err(unusable)?;
        let filtered = written.filtered.unwrap_or_else(|| {
            let (range_min_m, range_max_m) = (self.config.range_min_m, self.config.range_max_m);
            let emptied = empty_no_returns(points, range_min_m, range_max_m, self.config.drop_no_return_code);
            Filtered { range_min_m, range_max_m, emptied: emptied as u32 }
        });
        let returns = points.iter().filter(|p| p.is_return()).count();
        if let Some(prior) = info.prior {
            self.pose.send_one(Envelope { header }, prior)?;
        }
        *loan.meta_mut() = ScanMeta {
            header,
            origin: written.origin,
            rows: written.grid.map_or(0, |g| g.rows as u32),
            cols: written.grid.map_or(0, |g| g.cols as u32),
            returns: returns as u32,
            flags: if info.prior.is_some() { SCAN_HAS_PRIOR } else { 0 },
            duration_ns: written.duration_ns,
            source_index: step,
            range_min_m: filtered.range_min_m,
            range_max_m: filtered.range_max_m,
            out_of_range: filtered.emptied,
            ..ScanMeta::default()
        };
        log_place(step, || loan.location());
        Ok(loan.send()?)
    }

    /// Nothing is released to a graph that is not there, or does not hear everything.
    fn wait_for_services(&mut self, source: &mut dyn Source) -> Result<(), ServiceError> {
        let mut call = RollCall::of(self.finished.keys());
        while !self.setup.stop.is_set() && !call.is_complete() {
            self.pause(source, HEARTBEAT, |header, health| call.hear(header, health))?;
        }
        Ok(())
    }

    fn wait_until_due(&mut self, source: &mut dyn Source, begin: Instant, after_ns: i64) -> Result<(), ServiceError> {
        if self.config.speed == 0.0 {
            return Ok(());
        }
        let due = begin + Duration::from_secs_f64(after_ns.max(0) as f64 * 1e-9 / self.config.speed);
        while !self.setup.stop.is_set() && Instant::now() < due {
            let left = due.saturating_duration_since(Instant::now());
            self.pause(source, left.min(HEARTBEAT), |_, _| {})?;
        }
        Ok(())
    }

    fn wait_until_finished(&mut self, source: &mut dyn Source, step: u32) -> Result<(), ServiceError> {
        if self.config.speed != 0.0 {
            return Ok(());
        }
        self.wait_for_stragglers(source, step + 1)
    }

    /// Waits until every service has finished `count` scans.
    fn wait_for_stragglers(&mut self, source: &mut dyn Source, count: u32) -> Result<(), ServiceError> {
        while !self.setup.stop.is_set() && self.finished.values().any(|done| *done < count) {
            self.pause(source, HEARTBEAT, |_, _| {})?;
        }
        Ok(())
    }

    /// Waits until every service has finished the run. Scans that are released by their time may pass a service by, and
    /// it then never says so of them: without any progress for long, the run ends without.
    fn wait_for_the_last(&mut self, source: &mut dyn Source, total: u32) -> Result<(), ServiceError> {
        if self.config.speed == 0.0 {
            return self.wait_for_stragglers(source, total);
        }
        let (mut seen, mut since) = (self.finished.clone(), Instant::now());
        while !self.setup.stop.is_set() && self.finished.values().any(|done| *done < total) {
            self.pause(source, HEARTBEAT, |_, _| {})?;
            if seen != self.finished {
                (seen, since) = (self.finished.clone(), Instant::now());
            } else if since.elapsed() > PATIENCE {
                tracing::warn!(finished = ?self.finished, scans = total, "not every service has finished every scan");
                break;
            }
        }
        Ok(())
    }

    fn serve_until_stopped(&mut self, source: &mut dyn Source) -> Result<(), ServiceError> {
        while !self.setup.stop.is_set() {
            self.pause(source, HEARTBEAT, |_, _| {})?;
        }
        Ok(())
    }

    /// Waits for a message or the time, and does what is always to be done: acknowledgements, requests for old scans,
    /// history for late joiners, health.
    fn pause(
        &mut self,
        source: &mut dyn Source,
        time: Duration,
        mut heard: impl FnMut(&Header, &ServiceHealth),
    ) -> Result<(), ServiceError> {
        self.participant.wait(&[&self.others, &self.requests], time);
        while let Some(message) = self.others.receive()? {
            for health in message.items() {
                heard(message.header(), health);
                if let Some(done) = self.finished.get_mut(text::unpack(&health.service)) {
                    *done = health.finished_scans;
                }
            }
        }
        let mut resend = Vec::new();
        while let Some(message) = self.requests.receive()? {
            resend.extend(message.items().iter().filter(|r| r.kind == ScanRequestKind::RESEND).map(|r| r.scan));
        }
        for step in resend {
            match source.info(step as usize) {
                Some(info) => self.send_scan(source, step, &info)?,
                None => tracing::warn!(scan = step, "a scan was asked for that does not exist"),
            }
        }
        self.clock.serve_late_joiners();
        self.pose.serve_late_joiners();
        self.scan.serve_late_joiners();
        self.health.heartbeat(&self.participant);
        Ok(())
    }
}

/// A source that cannot deliver, as the error of the service.
fn unusable(error: SourceError) -> ServiceError {
    match error {
        SourceError::Config(error) => ServiceError::Config(error.to_string()),
        error => ServiceError::Work(error.to_string()),
    }
}
