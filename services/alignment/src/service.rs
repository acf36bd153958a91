//! The loop: a scan comes, its pose goes out; when its plan is out, older scans are corrected.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use mirador_core::registration::Registry;
use mirador_core::slam6d::Prior;
use mirador_core::slam6d::global::{CorrectionRecord, Journalled};
use mirador_ipc_schema::messages::{
    AlignmentMeta, Envelope, Header, Hypothesis, LoopClosingMeta, PoseCorrection, SCAN_HAS_PRIOR, ScanId, ScanPair,
    WorkSpan,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Pause, Publisher, Subscriber, Topic, clock, topics};
use mirador_service_common::{ServiceError, log_place, nanoseconds};

use crate::aligner::Aligner;
use crate::external::{External, Link, Rules, Tally};
use crate::intake::{Intake, Ready};
use crate::messages::{self, Facts};
use crate::restart::{make_aligner, make_method};
use crate::state::{AlignerStates, LastMessages, Progress, Store, Waiting};
use crate::{AlignmentConfig, AlignmentMode};

/// Aligns every scan of the run until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &AlignmentConfig, registry: &Registry) -> Result<(), ServiceError> {
    config.validate().map_err(|e| ServiceError::Config(format!("alignment.{e}")))?;
    let participant = setup.join()?;
    let mut alignment = Alignment::open(setup, config, registry, &participant)?;
    alignment.health.running(&participant);
    if alignment.finished_scans > 0 {
        // What an earlier incarnation has finished is done: lockstep may wait for these very words.
        alignment.health.finished(&participant, alignment.finished_scans, Duration::ZERO);
    }
    while !setup.stop.is_set() {
        alignment.intake.take_back()?;
        alignment.pause = alignment.wait(&participant);
        while let Some(ready) = alignment.intake.take(&mut alignment.pause)? {
            // The prior was sent before the scan, so it is there.
            alignment.receive_priors()?;
            alignment.align(&participant, ready)?;
        }
        alignment.receive_priors()?;
        alignment.receive_plans()?;
        alignment.correct(&participant)?;
        alignment.outbox.serve_late_joiners();
        if let Some(external) = &alignment.external {
            external.status.serve_late_joiners();
        }
        alignment.health.heartbeat(&participant);
    }
    Ok(())
}

struct Outbox {
    poses: Publisher<topics::Alignment>,
    corrections: Publisher<topics::PoseCorrections>,
    loops: Publisher<topics::LoopClosing>,
}

impl Outbox {
    fn serve_late_joiners(&self) {
        self.poses.serve_late_joiners();
        self.corrections.serve_late_joiners();
        self.loops.serve_late_joiners();
    }

    /// Says again what an earlier incarnation said last.
    fn repeat(&self, last: &LastMessages) -> Result<(), ServiceError> {
        if let Some((meta, items)) = messages::from_bytes::<AlignmentMeta, Hypothesis>(&last.alignment) {
            send(&self.poses, meta, &items)?;
        }
        if let Some((meta, items)) = messages::from_bytes::<Envelope, PoseCorrection>(&last.corrections) {
            self.send_corrections(meta, &items)?;
        }
        if let Some((meta, items)) = messages::from_bytes::<LoopClosingMeta, ScanPair>(&last.loop_closing) {
            send(&self.loops, meta, &items)?;
        }
        Ok(())
    }

    /// In as many messages as they need.
    fn send_corrections(&self, meta: Envelope, items: &[PoseCorrection]) -> Result<(), ServiceError> {
        items.chunks(self.corrections.capacity().max(1)).try_for_each(|part| send(&self.corrections, meta, part))
    }
}

/// What the service knows of a foreign registration.
struct Foreign {
    tally: Tally,
    status: Publisher<topics::RegistrationStatus>,
}

impl Foreign {
    /// Tells how it is doing.
    fn tell(&self, header: Header) -> Result<(), ServiceError> {
        Ok(self.status.send_one(Envelope { header }, self.tally.status())?)
    }
}

struct Alignment<'a> {
    setup: &'a ServiceSetup,
    config: &'a AlignmentConfig,
    intake: Intake,
    priors: Subscriber<topics::Pose>,
    plans: Subscriber<topics::ViewPlan>,
    outbox: Outbox,
    health: HealthReporter,
    pause: Pause,
    aligner: Aligner,
    external: Option<Foreign>,
    store: Store,
    last: LastMessages,
    /// Priors by the id of their scan.
    prior_of: BTreeMap<u64, Prior>,
    /// Scans that were aligned and whose correction is due.
    waiting: VecDeque<Waiting>,
    /// Since when the first of them waits.
    waiting_since: Instant,
    /// Number of scans that were planned on, and when the last plan was sent.
    planned_scans: u32,
    planned_ns: u64,
    aligned_scans: u32,
    finished_scans: u32,
}

impl<'a> Alignment<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &'a AlignmentConfig,
        registry: &Registry,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        let scans: Subscriber<topics::Scan> = participant.subscriber()?;
        let priors = participant.subscriber()?;
        let plans = participant.subscriber()?;
        let mut health = HealthReporter::open(participant, &setup.name)?;
        let (store, mut saved) = Store::open(setup)?;
        let mut method = make_method(setup, config, registry)?;
        let mut external = None;
        if config.is_external() {
            let tally = Tally::new(method.name());
            let link = Link::open(participant, config.external.deadline_ms)?;
            health.message("waiting for the external registration");
            // Once: later its absence is no reason to wait.
            if !link.wait_for_somebody(config.external.patience(), || health.heartbeat(participant)) {
                tracing::warn!(waited_ms = config.external.start_timeout_ms, "no external registration has come");
            }
            method = Box::new(External::new(method, link, tally.clone(), Rules::of(config)));
            external = Some(Foreign { tally, status: participant.publisher()? });
        }
        health.message("going on from old scans");
        let aligner = make_aligner(setup, config, method, participant, &scans, &mut saved)?;
        health.message("");
        let outbox = Outbox {
            poses: participant.publisher()?,
            corrections: participant.publisher()?,
            loops: participant.publisher()?,
        };
        outbox.repeat(&saved.last)?;
        let preparing = match config.mode {
            AlignmentMode::Scan => Some(make_method(setup, config, registry)?),
            AlignmentMode::Continuous => None,
        };
        let intake = Intake::start(scans, preparing, saved.aligned_scans)?;
        Ok(Self {
            setup,
            config,
            intake,
            priors,
            plans,
            outbox,
            health,
            pause: Pause::default(),
            aligner,
            external,
            store,
            last: saved.last,
            prior_of: BTreeMap::new(),
            waiting: saved.waiting.into(),
            waiting_since: Instant::now(),
            planned_scans: 0,
            planned_ns: 0,
            aligned_scans: saved.aligned_scans,
            finished_scans: saved.finished_scans,
        })
    }

    fn wait(&self, participant: &Participant) -> Pause {
        let Some(scans) = self.intake.awaited().filter(|_| !self.is_correction_ready()) else { return self.pause };
        let timeout = if self.waiting.is_empty() { HEARTBEAT } else { self.patience_left().min(HEARTBEAT) };
        participant.wait(&[scans, &self.plans], timeout)
    }

    fn receive_priors(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.priors.receive()? {
            match message.items().first().and_then(messages::prior) {
                Some(prior) => {
                    self.prior_of.insert(message.header().id, prior);
                }
                None => tracing::warn!(scan = message.header().scan(), "the prior is not a rigid pose; it is not used"),
            }
        }
        Ok(())
    }

    fn receive_plans(&mut self) -> Result<(), ServiceError> {
        while let Some(plan) = self.plans.receive()? {
            self.planned_scans = self.planned_scans.max(plan.header().scan() + 1);
            self.planned_ns = plan.header().sent_ns;
        }
        Ok(())
    }

    fn align(&mut self, participant: &Participant, ready: Ready) -> Result<(), ServiceError> {
        let Ready { scan, prepared, began_ns, prepare_time, span } = ready;
        let id = scan.header().id;
        let number = ScanId::unpack(id).scan;
        if number < self.aligned_scans {
            // Sent again for somebody else, or by a restarted acquisition: it is done.
            self.health.finished(participant, self.finished_scans, Duration::ZERO);
            return Ok(());
        }
        log_place(number, || scan.location());
        let prior = self.prior_of.remove(&id);
        self.prior_of.retain(|other, _| *other > id);
        if prior.is_none() && scan.meta().flags & SCAN_HAS_PRIOR != 0 {
            tracing::warn!(scan = number, "the announced prior did not come; going on without");
        }
        self.health.worked(span);
        self.intake.lend();
        let (begin, align_ns) = (Instant::now(), clock::monotonic_ns());
        if let Some(external) = &self.external {
            external.tally.set_newest(*scan.header());
        }
        let mut aligned = self.aligner.align(&scan, prepared, prior);
        let align_time = begin.elapsed();
        self.outbox.poses.announce();
        if let Some(external) = &self.external {
            aligned.record.method = external.tally.last_method().to_owned();
            external.tell(Header::about(scan.header(), began_ns))?;
        }
        let facts = Facts {
            header: Header::about(scan.header(), began_ns),
            keyframe: self.aligner.keyframe(),
            prepare_ns: nanoseconds(prepare_time),
            align_ns: nanoseconds(align_time),
        };
        let meta = messages::meta(&aligned, &facts);
        let hypotheses = messages::hypotheses(&aligned.record.hypotheses, self.outbox.poses.capacity());
        send(&self.outbox.poses, meta, &hypotheses)?;
        self.health.worked(WorkSpan::until_now("align", number, span.ended_ns, self.pause, align_ns));
        self.pause = Pause::default();
        self.last.alignment = messages::to_bytes(&meta, &hypotheses);
        self.aligned_scans = number + 1;
        self.intake.set_done(self.aligned_scans);
        self.say_whether_lost();
        if self.waiting.is_empty() {
            self.waiting_since = Instant::now();
        }
        self.waiting.push_back(Waiting::new(scan.header()));
        self.save()
    }

    /// So that whoever watches the graph sees it, too.
    fn say_whether_lost(&mut self) {
        match self.aligner.lost_scans() {
            0 => self.health.message(&self.external.as_ref().map_or_else(String::new, |e| e.tally.words())),
            lost => self.health.message(&format!("lost for {lost} scans: looking for the place among the keyframes")),
        }
    }

    /// The plan of the newest scan is out, or nobody waits for one any more.
    fn is_correction_ready(&self) -> bool {
        !self.waiting.is_empty() && (self.planned_scans >= self.aligned_scans || self.patience_left().is_zero())
    }

    fn patience_left(&self) -> Duration {
        let patience = if self.config.correct_after_plan { self.config.plan_patience_ms } else { 0 };
        Duration::from_millis(patience.into()).saturating_sub(self.waiting_since.elapsed())
    }

    /// Corrects older scans, unless a new scan comes: then the rest is done after that.
    fn correct(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        if !self.is_correction_ready() {
            return Ok(());
        }
        self.intake.lend();
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        let (intake, stop) = (&self.intake, &self.setup.stop);
        let is_wanted = || intake.has_arrived() || stop.is_set();
        let record = self.aligner.correct(&is_wanted);
        if record.is_none() && self.aligner.is_correction_due() {
            return Ok(());
        }
        if let Some(reason) = record.as_ref().and_then(|r| r.unsolved.as_deref()) {
            tracing::warn!(reason, "older scans could not be corrected");
        }
        if let Some(record) = record.as_ref().filter(|r| self.waiting.iter().all(|w| w.id != r.scan_id)) {
            // There was no time for it before a restart; what comes of it is told all the same.
            let late = self.waiting.front().map(|first| Waiting { id: record.scan_id, ..*first });
            return late.map_or(Ok(()), |late| self.tell(&late, Some(record), began_ns, begin.elapsed()));
        }
        if let Some(first) = self.waiting.front() {
            let scan = ScanId::unpack(first.id).scan;
            self.health.worked(WorkSpan::until_now("correct", scan, self.planned_ns, self.pause, began_ns));
            self.pause = Pause::default();
        }
        // Scans without a record were not accepted, or there was no time for them.
        while let Some(waiting) = self.waiting.pop_front() {
            let own = record.as_ref().filter(|record| record.scan_id == waiting.id);
            self.tell(&waiting, own, began_ns, begin.elapsed())?;
            self.finished_scans = self.finished_scans.max(ScanId::unpack(waiting.id).scan + 1);
            if own.is_some() {
                break;
            }
        }
        self.waiting_since = Instant::now();
        self.save()?;
        self.health.finished(participant, self.finished_scans, begin.elapsed());
        Ok(())
    }

    /// Sends what was done about older scans after one.
    fn tell(
        &mut self,
        waiting: &Waiting,
        record: Option<&CorrectionRecord>,
        began_ns: u64,
        time: Duration,
    ) -> Result<(), ServiceError> {
        let header = waiting.header(began_ns);
        let corrections: Vec<_> =
            record.map_or_else(Vec::new, |r| r.corrections.iter().map(messages::correction).collect());
        self.outbox.send_corrections(Envelope { header }, &corrections)?;
        let mut pairs = record.map_or_else(Vec::new, messages::pairs);
        pairs.truncate(self.outbox.loops.capacity());
        let meta = messages::loop_closing(record, header, nanoseconds(time));
        send(&self.outbox.loops, meta, &pairs)?;
        if let Some(external) = &self.external {
            external.tell(header)?;
        }
        self.last.corrections = messages::to_bytes(&Envelope { header }, &corrections);
        self.last.loop_closing = messages::to_bytes(&meta, &pairs);
        Ok(())
    }

    fn save(&mut self) -> Result<(), ServiceError> {
        let entries: Vec<Journalled> = self.aligner.take_journal();
        let (mut aligner, mut snapshot) = (AlignerStates::default(), None);
        match &mut self.aligner {
            Aligner::Scan(scan) => aligner.scan = scan.state().clone(),
            Aligner::Continuous(continuous) => {
                snapshot = continuous.take_snapshot();
                aligner.continuous = continuous.state().clone();
            }
        }
        let progress = Progress {
            aligned_scans: self.aligned_scans,
            finished_scans: self.finished_scans,
            waiting: self.waiting.iter().copied().collect(),
            aligner,
            snapshot,
            last: &self.last,
        };
        Ok(self.store.save(&entries, progress)?)
    }
}

fn send<T: Topic>(publisher: &Publisher<T>, meta: T::Meta, items: &[T::Item]) -> Result<(), ServiceError> {
    let mut loan = publisher.loan(items.len())?;
    *loan.meta_mut() = meta;
    loan.items_mut().copy_from_slice(items);
    Ok(loan.send()?)
}
