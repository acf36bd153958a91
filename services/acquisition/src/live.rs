//! The loop of a robot: sweeps and encoder become scans; clock, prior, scan; until the plan is to stop and everyone is
//! done.
//!
//! A scan ends when it is complete, or when the head has stopped. What is missing then stays empty cells; when it is too
//! much, or nothing came at all, the scan is taken again. A laser or an encoder that falls silent is named within a second
//! of the robot's time.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mirador_core::scan::{Assembled, HeadReading, Point, ScanAssembly, SweepBeam, SweepHead, TurningHead};
use mirador_core::simulation::Scanner;
use mirador_ipc_schema::messages::{
    CLOCK_ENDED, CLOCK_FAULT, CLOCK_RUNNING, ClockMeta, DECISION_STOP, Envelope, Header, PoseEstimate, RobotState,
    SCAN_HAS_PRIOR, ScanId, ScanMeta, ScanRequest, ScanRequestKind,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Subscriber, clock, text, topics};
use mirador_service_common::{ServiceError, log_place};

use crate::AcquisitionConfig;
use crate::no_return::empty_no_returns;
use crate::scan_store::ScanStore;

/// How long localisation has to say where the robot stands.
const PRIOR_PATIENCE: Duration = Duration::from_secs(2);
/// What has not spoken for so long of the robot's time is silent [ns].
const SILENCE_NS: i64 = 900_000_000;
/// A scan that has not ended so long after its time is over [ns].
const OVERDUE_NS: i64 = 5_000_000_000;
/// A request is heard within this time; a state that comes sooner says nothing of it [ns].
const HEARD_NS: i64 = 200_000_000;
/// How often a scan is taken again.
const RETAKES: u32 = 2;

/// Puts the scans of a robot together until the run is over and the process is stopped.
pub(crate) fn run(setup: &ServiceSetup, config: &AcquisitionConfig) -> Result<(), ServiceError> {
    let mut live = Live::open(setup, config)?;
    match live.take_all() {
        Ok(()) => Ok(()),
        Err(error) => {
            live.health.failed(&live.participant, &error.to_string());
            live.send_clock(CLOCK_FAULT, live.next.saturating_sub(1), live.now_ns)?;
            tracing::error!(%error, "no further scan can be taken");
            while !setup.stop.is_set() {
                live.participant.wait(&[&live.requests], HEARTBEAT);
                live.receive()?;
                live.keep_alive();
            }
            Err(error)
        }
    }
}

struct Live<'a> {
    setup: &'a ServiceSetup,
    config: &'a AcquisitionConfig,
    participant: Participant,
    clock: Publisher<topics::Clock>,
    pose: Publisher<topics::Pose>,
    scan: Publisher<topics::Scan>,
    asking: Publisher<topics::ScanRequests>,
    sweeps: Subscriber<topics::LaserSweep>,
    encoder: Subscriber<topics::Encoder>,
    states: Subscriber<topics::RobotState>,
    requests: Subscriber<topics::ScanRequests>,
    priors: Subscriber<topics::Pose>,
    plans: Subscriber<topics::ViewPlan>,
    others: Subscriber<topics::ServiceHealth>,
    health: HealthReporter,
    /// Scans finished by each service that is waited for.
    finished: BTreeMap<String, u32>,
    store: ScanStore,
    assembly: ScanAssembly,
    /// The scan that is to come.
    next: u32,
    /// The robot's time: the newest stamp [ns].
    now_ns: i64,
    state: Option<RobotState>,
    /// When the scan to come was asked for or begun [ns].
    awaited_ns: Option<i64>,
    last_sweep_ns: Option<i64>,
    last_reading_ns: Option<i64>,
    silent: Option<&'static str>,
    retakes: u32,
    /// Packets of no scan that is known.
    strays: u64,
    /// The newest scan whose plan is to stop.
    stops_after: Option<u32>,
}

impl<'a> Live<'a> {
    fn open(setup: &'a ServiceSetup, config: &'a AcquisitionConfig) -> Result<Self, ServiceError> {
        config.validate().map_err(|error| ServiceError::Config(error.to_string()))?;
        let scanner = Scanner::new(config.scanner.clone())
            .map_err(|error| ServiceError::Config(format!("acquisition.{error}")))?;
        let home = config.scanner.first_sweep_deg.to_radians();
        let participant = setup.join()?;
        let store = ScanStore::new(setup);
        let next = if setup.incarnation == 0 { 0 } else { store.count() };
        Ok(Self {
            setup,
            config,
            clock: participant.publisher()?,
            pose: participant.publisher()?,
            scan: participant.publisher()?,
            asking: participant.publisher()?,
            sweeps: participant.subscriber()?,
            encoder: participant.subscriber()?,
            states: participant.subscriber()?,
            requests: participant.subscriber()?,
            priors: participant.subscriber()?,
            plans: participant.subscriber()?,
            others: participant.subscriber()?,
            health: HealthReporter::open(&participant, &setup.name)?,
            finished: config.lockstep_with.iter().map(|name| (name.clone(), 0)).collect(),
            store,
            assembly: ScanAssembly::new(TurningHead::new(scanner.grid(), home)),
            next,
            now_ns: i64::MIN,
            state: None,
            awaited_ns: None,
            last_sweep_ns: None,
            last_reading_ns: None,
            silent: None,
            retakes: 0,
            strays: 0,
            stops_after: None,
            participant,
        })
    }

    fn take_all(&mut self) -> Result<(), ServiceError> {
        self.health.running(&self.participant);
        if let Some(newest) = self.next.checked_sub(1) {
            // It was sent by the one before, but may not have reached everybody.
            self.send_clock(CLOCK_RUNNING, newest, self.store.read(newest)?.map_or(0, |scan| end_ns(&scan.meta)))?;
            self.resend(newest)?;
            self.health.finished(&self.participant, self.next, Duration::ZERO);
        }
        let mut is_over = false;
        while !self.setup.stop.is_set() {
            self.wait();
            self.receive()?;
            self.watch();
            if self.has_ended() {
                self.end_scan()?;
            }
            if !is_over && self.is_over() {
                is_over = true;
                self.send_clock(CLOCK_ENDED, self.next.saturating_sub(1), self.now_ns)?;
            }
            self.keep_alive();
        }
        Ok(())
    }

    fn wait(&self) {
        let ports: [&dyn mirador_ipc_schema::Wakeable; 6] =
            [&self.sweeps, &self.encoder, &self.states, &self.requests, &self.plans, &self.others];
        self.participant.wait(&ports, HEARTBEAT);
    }

    /// Takes in all there is. States come first: what was said before a state is then there when its turn comes.
    fn receive(&mut self) -> Result<(), ServiceError> {
        let mut newest = None;
        while let Some(message) = self.states.receive()? {
            self.now_ns = self.now_ns.max(message.header().stamp_ns);
            newest = message.items().last().copied().or(newest);
        }
        self.receive_packets()?;
        if let Some(state) = newest {
            self.note_state(state)?;
        }
        let mut resend = Vec::new();
        while let Some(message) = self.requests.receive()? {
            for request in message.items() {
                match request.kind {
                    ScanRequestKind::RESEND => resend.push(request.scan),
                    ScanRequestKind::TAKE if request.scan == self.next => {
                        self.awaited_ns = self.awaited_ns.or(Some(self.now_ns));
                    }
                    _ => {}
                }
            }
        }
        for scan in resend {
            self.resend(scan)?;
        }
        while let Some(message) = self.plans.receive()? {
            if message.meta().decision == DECISION_STOP {
                self.stops_after = self.stops_after.max(Some(message.header().scan()));
            }
        }
        while let Some(message) = self.others.receive()? {
            for health in message.items() {
                if let Some(done) = self.finished.get_mut(text::unpack(&health.service)) {
                    *done = health.finished_scans;
                }
            }
        }
        Ok(())
    }

    fn receive_packets(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.encoder.receive()? {
            if !self.belongs(message.header(), message.items().len() as u64) {
                continue;
            }
            for item in message.items() {
                self.now_ns = self.now_ns.max(item.stamp_ns);
                self.last_reading_ns = self.last_reading_ns.max(Some(item.stamp_ns));
                let (stamp_ns, angle, reading) = (item.stamp_ns, item.angle, item.reading);
                self.assembly.add_reading(HeadReading { stamp_ns, angle, reading });
            }
        }
        while let Some(message) = self.sweeps.receive()? {
            if !self.belongs(message.header(), 1) {
                continue;
            }
            let meta = message.meta();
            let stamp_ns = meta.header.stamp_ns;
            self.now_ns = self.now_ns.max(stamp_ns);
            self.last_sweep_ns = self.last_sweep_ns.max(Some(stamp_ns));
            let (first_angle, angle_step) = (meta.first_angle, meta.angle_step);
            let (duration_ns, sweep) = (meta.duration_ns, meta.sweep);
            let sweep = SweepHead { stamp_ns, duration_ns, first_angle, angle_step, sweep };
            let beams = message.items().iter();
            let beams = beams.map(|b| SweepBeam { range: b.range, intensity: b.intensity, time: b.time });
            self.assembly.add_sweep(sweep, beams);
        }
        Ok(())
    }

    /// Whether packets are of the scan to come. A laser that never pauses goes on with the number of the last scan; all
    /// others are strays.
    fn belongs(&mut self, header: &Header, packets: u64) -> bool {
        let id = ScanId::unpack(header.id);
        let is_run = id.run == self.setup.run;
        if is_run && id.scan == self.next {
            self.awaited_ns = self.awaited_ns.or(Some(header.stamp_ns));
            return true;
        }
        if !(is_run && id.scan.checked_add(1) == Some(self.next)) {
            self.strays += packets;
            tracing::debug!(scan = id.scan, run = id.run, next = self.next, "a packet of no scan that is known");
        }
        false
    }

    /// Who comes into a graph in which the head turns already, or has turned, has missed a part of the scan.
    fn note_state(&mut self, state: RobotState) -> Result<(), ServiceError> {
        let is_first = self.state.replace(state).is_none();
        let turns = state.scanning == 1 && state.scans <= self.next;
        let has_turned = state.scanning == 0 && state.scans == self.next.saturating_add(1);
        if is_first && (turns || has_turned) && !self.assembly.is_complete() {
            tracing::warn!(scan = self.next, "the head turned before anybody listened");
            self.take_again()?;
        }
        Ok(())
    }

    /// Names who is silent while a scan is awaited, once, and says when he speaks again.
    fn watch(&mut self) {
        let Some(since_ns) = self.awaited_ns else { return };
        let is_silent = |last: Option<i64>| self.now_ns.saturating_sub(last.unwrap_or(since_ns)) > SILENCE_NS;
        let silent = match (is_silent(self.last_sweep_ns), is_silent(self.last_reading_ns)) {
            (true, true) => Some("laser and encoder are silent"),
            (true, false) => Some("the laser is silent"),
            (false, true) => Some("the encoder is silent"),
            (false, false) => None,
        };
        if silent != self.silent {
            match silent {
                Some(who) => tracing::warn!(scan = self.next, now_ns = self.now_ns, "{who}"),
                None => tracing::info!(scan = self.next, "laser and encoder speak again"),
            }
            self.health.message(silent.unwrap_or(""));
            self.silent = silent;
        }
    }

    /// Whether nothing more is to come of the scan.
    fn has_ended(&self) -> bool {
        let Some(since_ns) = self.awaited_ns else { return false };
        if self.assembly.is_complete() {
            return true;
        }
        let head = self.assembly.head();
        let takes_ns = (head.grid.0 as i64).saturating_mul(head.sweep_ns).saturating_add(OVERDUE_NS);
        let for_ns = self.now_ns.saturating_sub(since_ns);
        let stands = self.state.is_some_and(|state| state.scanning == 0 && state.scans > self.next);
        (stands && for_ns > HEARD_NS) || for_ns > takes_ns
    }

    /// Delivers the scan, or has it taken again.
    fn end_scan(&mut self) -> Result<(), ServiceError> {
        let survey = self.assembly.survey();
        let rows = self.assembly.head().grid.0;
        let missing = survey.map_or(rows, |survey| survey.counts.missing_sweeps as usize);
        let is_poor = missing as f64 > self.config.missing_max * rows as f64;
        if is_poor && self.retakes < RETAKES {
            tracing::warn!(scan = self.next, missing, rows, "too many sweeps are missing: the scan is taken again");
            return self.take_again();
        }
        match survey {
            Some(survey) => self.deliver(&survey),
            None => Err(ServiceError::Work(format!(
                "scan {}: {}; of {} sweeps and {} encoder readings not one sweep can be placed",
                self.next,
                self.silent.unwrap_or("laser and encoder speak"),
                self.assembly.sweeps(),
                self.assembly.readings(),
            ))),
        }
    }

    fn take_again(&mut self) -> Result<(), ServiceError> {
        self.retakes += 1;
        self.assembly.clear();
        (self.awaited_ns, self.last_sweep_ns, self.last_reading_ns) = (Some(self.now_ns), None, None);
        // The head stands until the request is heard; what it says of the scan as it was is of no use.
        if let Some(state) = &mut self.state {
            state.scanning = 1;
        }
        let request = ScanRequest { kind: ScanRequestKind::TAKE, scan: self.next, reserved: 0 };
        let meta = Envelope { header: Header::new(self.id(self.next), self.now_ns) };
        Ok(self.asking.send_one(meta, request)?)
    }

    fn deliver(&mut self, survey: &Assembled) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let (scan, end) = (self.next, survey.begin_ns.saturating_add_unsigned(survey.duration_ns));
        self.send_clock(CLOCK_RUNNING, scan, end)?;
        let prior = self.wait_for_prior(scan)?;
        if prior.is_none() {
            tracing::warn!(scan, "localisation has not said where the robot stands: the scan goes out without a prior");
        }
        let began_ns = clock::monotonic_ns();
        let grid = self.assembly.head().grid();
        let mut loan = self.scan.loan(grid.cells())?;
        let points: &mut [Point] = bytemuck::cast_slice_mut(loan.items_mut());
        let written = self.assembly.write(self.setup.threads, points);
        let counts = written.ok().flatten().map_or(survey.counts, |assembled| assembled.counts);
        let (range_min_m, range_max_m) = (self.config.range_min_m, self.config.range_max_m);
        let emptied = empty_no_returns(points, range_min_m, range_max_m, self.config.drop_no_return_code);
        let returns = points.iter().filter(|point| point.is_return()).count();
        let meta = ScanMeta {
            header: Header { began_ns, ..Header::new(self.id(scan), survey.begin_ns) },
            rows: grid.rows as u32,
            cols: grid.cols as u32,
            returns: returns as u32,
            flags: if prior.is_some() { SCAN_HAS_PRIOR } else { 0 },
            duration_ns: survey.duration_ns,
            source_index: scan,
            range_min_m,
            range_max_m,
            out_of_range: emptied as u32,
            ..ScanMeta::default()
        };
        *loan.meta_mut() = meta;
        self.store.hold(&meta, prior.as_ref(), loan.items());
        log_place(scan, || loan.location());
        loan.send()?;
        self.store.write(scan)?;
        if counts.is_clean() && self.strays == 0 {
            tracing::info!(scan, returns, "scan");
        } else {
            tracing::warn!(scan, returns, ?counts, strays = self.strays, "scan");
            self.health.message(&format!(
                "scan {scan}: sweeps missing {}, readings missing {}, repeated {}, late {}, unfit {}, strays {}",
                counts.missing_sweeps, counts.missing_readings, counts.repeated, counts.late, counts.unfit, self.strays
            ));
        }
        self.assembly.clear();
        (self.awaited_ns, self.last_sweep_ns, self.last_reading_ns) = (None, None, None);
        (self.retakes, self.strays, self.silent) = (0, 0, None);
        self.next += 1;
        self.health.finished(&self.participant, self.next, begin.elapsed());
        Ok(())
    }

    /// What localisation says of the pose of a scan; `None` when it says nothing in time or does not know.
    fn wait_for_prior(&mut self, scan: u32) -> Result<Option<PoseEstimate>, ServiceError> {
        let since = Instant::now();
        while !self.setup.stop.is_set() && since.elapsed() < PRIOR_PATIENCE {
            while let Some(message) = self.priors.receive()? {
                if message.header().id == self.id(scan) {
                    return Ok(message.items().first().copied());
                }
            }
            self.participant.wait(&[&self.priors], HEARTBEAT);
            self.keep_alive();
        }
        Ok(None)
    }

    /// Sends a scan of this run once more, its prior before it.
    fn resend(&mut self, scan: u32) -> Result<(), ServiceError> {
        let Some(stored) = self.store.read(scan)? else {
            tracing::warn!(scan, "a scan was asked for that does not exist");
            return Ok(());
        };
        if let Some(prior) = stored.prior {
            self.pose.send_one(Envelope { header: stored.meta.header }, prior)?;
        }
        let mut loan = self.scan.loan(stored.points.len())?;
        *loan.meta_mut() = stored.meta;
        loan.items_mut().copy_from_slice(&stored.points);
        Ok(loan.send()?)
    }

    /// Whether the last scan is taken and everyone is done with it.
    fn is_over(&self) -> bool {
        let last = self.next.checked_sub(1);
        let is_planned = last.is_some() && self.stops_after == last;
        let is_last = is_planned || (self.config.max_scans > 0 && self.next >= self.config.max_scans);
        is_last && self.finished.values().all(|done| *done >= self.next)
    }

    fn id(&self, scan: u32) -> u64 {
        ScanId { robot: 0, run: self.setup.run, scan }.pack()
    }

    fn send_clock(&self, state: u32, step: u32, stamp_ns: i64) -> Result<(), ServiceError> {
        let mut loan = self.clock.loan(1)?;
        *loan.meta_mut() = ClockMeta {
            header: Header::new(self.id(step), stamp_ns.max(0)),
            state,
            lockstep: u32::from(self.config.speed == 0.0),
            ..ClockMeta::default()
        };
        Ok(loan.send()?)
    }

    fn keep_alive(&mut self) {
        self.clock.serve_late_joiners();
        self.pose.serve_late_joiners();
        self.scan.serve_late_joiners();
        self.health.heartbeat(&self.participant);
    }
}

/// Time of the last beam of a scan [ns].
fn end_ns(meta: &ScanMeta) -> i64 {
    meta.header.stamp_ns.saturating_add_unsigned(meta.duration_ns)
}
