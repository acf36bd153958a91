//! The loop: a scan comes, its pose goes out.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_core::registration::{RegistrationConfig, Registry};
use mirador_core::slam6d::{AlignerState, SequentialAligner};
use mirador_ipc_schema::messages::{
    AlignmentMeta, Envelope, Header, Hypothesis, SCAN_HAS_PRIOR, ScanId, ScanRequest, ScanRequestKind,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Received, Subscriber, clock, topics};
use mirador_service_common::{CheckpointError, ServiceError, checkpoint, log_place, nanoseconds, view};
use serde::{Deserialize, Serialize};

use crate::AlignmentConfig;
use crate::messages::{self, Facts};

/// How long a restarted service waits for its target scan before it goes on without.
const TARGET_TIMEOUT: Duration = Duration::from_secs(20);

/// What is written down after every scan.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Checkpoint {
    finished_scans: u32,
    aligner: AlignerState,
    /// The message about the last scan, see [`messages::to_bytes`]. Readers that were not there when it was sent get it
    /// from the topic's history, which dies with this process.
    last: Vec<u8>,
}

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
        participant.wait(&[&alignment.scans], HEARTBEAT);
        alignment.receive_priors()?;
        while let Some(scan) = alignment.scans.receive()? {
            // The prior was sent before the scan, so it is there.
            alignment.receive_priors()?;
            alignment.align(&participant, &scan)?;
        }
        alignment.poses.serve_late_joiners();
        alignment.health.heartbeat(&participant);
    }
    Ok(())
}

struct Alignment<'a> {
    setup: &'a ServiceSetup,
    scans: Subscriber<topics::Scan>,
    priors: Subscriber<topics::Pose>,
    poses: Publisher<topics::Alignment>,
    health: HealthReporter,
    aligner: SequentialAligner,
    /// Priors by the id of their scan.
    prior_of: BTreeMap<u64, Pose>,
    finished_scans: u32,
}

impl<'a> Alignment<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &AlignmentConfig,
        registry: &Registry,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        let scans = participant.subscriber()?;
        let priors = participant.subscriber()?;
        let mut health = HealthReporter::open(participant, &setup.name)?;
        let saved = saved_state(setup)?;
        health.message("waiting for the target scan");
        let aligner = make_aligner(setup, config, registry, participant, &scans, &saved)?;
        health.message("");
        let poses = participant.publisher()?;
        if let Some((meta, hypotheses)) = messages::from_bytes(&saved.last) {
            send(&poses, meta, &hypotheses)?;
        }
        Ok(Self {
            setup,
            scans,
            priors,
            poses,
            health,
            aligner,
            prior_of: BTreeMap::new(),
            finished_scans: saved.finished_scans,
        })
    }

    fn receive_priors(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.priors.receive()? {
            let pose = message.items().first().and_then(|p| pose_from_rows(&p.map_from_scanner));
            match pose {
                Some(pose) => {
                    self.prior_of.insert(message.header().id, pose);
                }
                None => tracing::warn!(scan = message.header().scan(), "the prior is not a rigid pose; it is not used"),
            }
        }
        Ok(())
    }

    fn align(&mut self, participant: &Participant, scan: &Received<topics::Scan>) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let began_ns = clock::monotonic_ns();
        let id = scan.header().id;
        let number = ScanId::unpack(id).scan;
        if number < self.finished_scans {
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
        let record = self.aligner.align_next(id, view::scan(scan.meta(), scan.items()), prior);
        let facts = Facts {
            header: Header::about(scan.header(), began_ns),
            keyframe_points: self.aligner.keyframe_points(),
            keyframe_bytes: self.aligner.bytes(),
            align_ns: nanoseconds(begin.elapsed()),
        };
        let meta = messages::meta(&record, &facts);
        let hypotheses: Vec<_> = record.hypotheses.iter().map(messages::hypothesis).collect();
        send(&self.poses, meta, &hypotheses)?;
        self.finished_scans = number + 1;
        save_state(self.setup, self.finished_scans, self.aligner.state(), &messages::to_bytes(&meta, &hypotheses))?;
        self.health.finished(participant, self.finished_scans, begin.elapsed());
        Ok(())
    }
}

fn send(poses: &Publisher<topics::Alignment>, meta: AlignmentMeta, items: &[Hypothesis]) -> Result<(), ServiceError> {
    let mut loan = poses.loan(items.len())?;
    *loan.meta_mut() = meta;
    loan.items_mut().copy_from_slice(items);
    Ok(loan.send()?)
}

fn saved_state(setup: &ServiceSetup) -> Result<Checkpoint, ServiceError> {
    if setup.incarnation == 0 {
        return Ok(Checkpoint::default());
    }
    let path = setup.state_file();
    let Some(content) = checkpoint::load(&path)? else { return Ok(Checkpoint::default()) };
    serde_json::from_slice(&content).map_err(|e| CheckpointError::Invalid { path, reason: e.to_string() }.into())
}

fn save_state(
    setup: &ServiceSetup,
    finished_scans: u32,
    aligner: &AlignerState,
    last: &[u8],
) -> Result<(), ServiceError> {
    #[derive(Serialize)]
    struct Borrowed<'a> {
        finished_scans: u32,
        aligner: &'a AlignerState,
        last: &'a [u8],
    }
    let content = serde_json::to_vec(&Borrowed { finished_scans, aligner, last })
        .map_err(|e| ServiceError::Work(format!("the state cannot be written: {e}")))?;
    Ok(checkpoint::save(&setup.state_file(), &content)?)
}

/// A new aligner, or one that goes on from the saved state: then the target scan is asked for again and prepared anew,
/// which gives the same keyframe to the last bit.
fn make_aligner(
    setup: &ServiceSetup,
    config: &AlignmentConfig,
    registry: &Registry,
    participant: &Participant,
    scans: &Subscriber<topics::Scan>,
    saved: &Checkpoint,
) -> Result<SequentialAligner, ServiceError> {
    let method = RegistrationConfig { threads: setup.threads, ..config.method.clone() };
    let create = || registry.create(&config.registration, &method).map_err(|e| ServiceError::Config(e.to_string()));
    let Some(target) = &saved.aligner.target else {
        return SequentialAligner::new(create()?, config.sequential).map_err(|e| ServiceError::Config(e.to_string()));
    };
    let scan = fetch_again(setup, participant, scans, target.scan_id)?;
    let view = view::scan(scan.meta(), scan.items());
    SequentialAligner::restore(create()?, config.sequential, saved.aligner.clone(), Some(view))
        .map_err(|e| ServiceError::Work(e.to_string()))
}

/// Asks acquisition for an old scan and waits for it. Newer scans that arrive meanwhile are asked for afterwards.
fn fetch_again(
    setup: &ServiceSetup,
    participant: &Participant,
    scans: &Subscriber<topics::Scan>,
    id: u64,
) -> Result<Received<topics::Scan>, ServiceError> {
    let requests: Publisher<topics::ScanRequests> = participant.publisher()?;
    let wanted = ScanId::unpack(id).scan;
    let ask = |scan: u32| {
        let request = ScanRequest { kind: ScanRequestKind::RESEND, scan, reserved: 0 };
        requests.send_one(Envelope { header: Header::new(id, 0) }, request)
    };
    let begin = Instant::now();
    let mut passed_over = Vec::new();
    let mut asked = None::<Instant>;
    while !setup.stop.is_set() && begin.elapsed() < TARGET_TIMEOUT {
        // Asked again now and then: the request is lost when acquisition is restarting, too.
        if asked.is_none_or(|t| t.elapsed() > Duration::from_secs(1)) {
            ask(wanted)?;
            asked = Some(Instant::now());
        }
        participant.wait(&[scans], HEARTBEAT);
        requests.serve_late_joiners();
        while let Some(scan) = scans.receive()? {
            if scan.header().id == id {
                for number in passed_over {
                    ask(number)?;
                }
                return Ok(scan);
            }
            passed_over.push(scan.header().scan());
        }
    }
    Err(ServiceError::Work(format!("scan {wanted}, the target of the alignment, was not sent again")))
}
