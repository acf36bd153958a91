//! A new aligner, or one that goes on from the saved state.

use std::time::{Duration, Instant};

use mirador_core::registration::{Registration, RegistrationConfig, Registry};
use mirador_core::slam6d::continuous::ContinuousAligner;
use mirador_core::slam6d::global::{GlobalAligner, GlobalConfig};
use mirador_ipc_schema::messages::{Envelope, Header, ScanId, ScanRequest, ScanRequestKind};
use mirador_ipc_schema::service::{HEARTBEAT, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Received, Subscriber, topics};
use mirador_service_common::{ServiceError, view};

use crate::aligner::{Aligner, frame_time};
use crate::state::Saved;
use crate::{AlignmentConfig, AlignmentMode};

/// How long a restarted service waits for an old scan before it gives up.
const TARGET_TIMEOUT: Duration = Duration::from_secs(20);

/// A new aligner, or one that goes on from the saved state. Where every scan is aligned to the one before, that scan is
/// asked for again and prepared anew, which gives the same keyframe to the last bit; the keyframes of all other scans are
/// in the journal. In continuous mode the scans since the last snapshot of the odometry are asked for and gone through.
pub(crate) fn make_aligner(
    setup: &ServiceSetup,
    config: &AlignmentConfig,
    method: Box<dyn Registration>,
    participant: &Participant,
    scans: &Subscriber<topics::Scan>,
    saved: &mut Saved,
) -> Result<Aligner, ServiceError> {
    let mut global = config.global.clone();
    global.coarse.threads = setup.threads;
    let again = Again { setup, participant, scans };
    match config.mode {
        AlignmentMode::Scan => scan_aligner(&again, config, method, global, saved),
        AlignmentMode::Continuous => continuous_aligner(&again, config, method, global, saved),
    }
}

/// The registration method of this process, as often as it is asked for.
pub(crate) fn make_method(
    setup: &ServiceSetup,
    config: &AlignmentConfig,
    registry: &Registry,
) -> Result<Box<dyn Registration>, ServiceError> {
    let method = RegistrationConfig { threads: setup.threads, ..config.method.clone() };
    registry.create(config.own_method(), &method).map_err(|e| ServiceError::Config(e.to_string()))
}

fn scan_aligner(
    again: &Again<'_>,
    config: &AlignmentConfig,
    method: Box<dyn Registration>,
    global: GlobalConfig,
    saved: &mut Saved,
) -> Result<Aligner, ServiceError> {
    let spacing_m = config.method.preparation.voxel_m;
    let mut aligner = match &saved.aligner.scan.target {
        None => GlobalAligner::new(method, config.sequential, global, spacing_m)
            .map_err(|e| ServiceError::Config(e.to_string()))?,
        Some(target) => {
            let scan = again.fetch(target.scan_id)?;
            let view = view::scan(scan.meta(), scan.items());
            let (state, journal) = (saved.aligner.scan.clone(), std::mem::take(&mut saved.journal));
            GlobalAligner::restore(method, config.sequential, global, spacing_m, state, Some(view), journal)
                .map_err(|e| ServiceError::Work(e.to_string()))?
        }
    };
    aligner.keep_journal();
    Ok(Aligner::Scan(Box::new(aligner)))
}

fn continuous_aligner(
    again: &Again<'_>,
    config: &AlignmentConfig,
    method: Box<dyn Registration>,
    global: GlobalConfig,
    saved: &mut Saved,
) -> Result<Aligner, ServiceError> {
    let continuous = config.continuous(again.setup.threads);
    let (state, journal) = (std::mem::take(&mut saved.aligner.continuous), std::mem::take(&mut saved.journal));
    let snapshot = saved.snapshot.take();
    let mut aligner =
        ContinuousAligner::restore(method, config.sequential, global, continuous, state, snapshot.as_deref(), journal)
            .map_err(|e| ServiceError::Work(e.to_string()))?;
    for input in aligner.frames_since_snapshot().to_vec() {
        let scan = again.fetch(input.scan_id)?;
        aligner.repeat(&input, view::scan(scan.meta(), scan.items()), frame_time(scan.meta()));
    }
    aligner.keep_journal();
    Ok(Aligner::Continuous(Box::new(aligner)))
}

/// Old scans, from acquisition.
struct Again<'a> {
    setup: &'a ServiceSetup,
    participant: &'a Participant,
    scans: &'a Subscriber<topics::Scan>,
}

impl Again<'_> {
    fn fetch(&self, id: u64) -> Result<Received<topics::Scan>, ServiceError> {
        fetch_again(self.setup, self.participant, self.scans, id)
    }
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
    Err(ServiceError::Work(format!("scan {wanted}, which the alignment goes on from, was not sent again")))
}
