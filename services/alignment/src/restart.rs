//! A new aligner, or one that goes on from the saved state.

use std::time::{Duration, Instant};

use mirador_core::registration::{RegistrationConfig, Registry};
use mirador_core::slam6d::global::GlobalAligner;
use mirador_ipc_schema::messages::{Envelope, Header, ScanId, ScanRequest, ScanRequestKind};
use mirador_ipc_schema::service::{HEARTBEAT, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Received, Subscriber, topics};
use mirador_service_common::{ServiceError, view};

use crate::AlignmentConfig;
use crate::state::Saved;

/// How long a restarted service waits for its target scan before it gives up.
const TARGET_TIMEOUT: Duration = Duration::from_secs(20);

/// A new aligner, or one that goes on from the saved state: then the target scan is asked for again and prepared anew,
/// which gives the same keyframe to the last bit. The keyframes of all other scans are in the journal.
pub(crate) fn make_aligner(
    setup: &ServiceSetup,
    config: &AlignmentConfig,
    registry: &Registry,
    participant: &Participant,
    scans: &Subscriber<topics::Scan>,
    saved: &mut Saved,
) -> Result<GlobalAligner, ServiceError> {
    let method = RegistrationConfig { threads: setup.threads, ..config.method.clone() };
    let method = registry.create(&config.registration, &method).map_err(|e| ServiceError::Config(e.to_string()))?;
    let mut global = config.global.clone();
    global.coarse.threads = setup.threads;
    let spacing_m = config.method.preparation.voxel_m;
    let mut aligner = match &saved.aligner.target {
        None => GlobalAligner::new(method, config.sequential, global, spacing_m)
            .map_err(|e| ServiceError::Config(e.to_string()))?,
        Some(target) => {
            let scan = fetch_again(setup, participant, scans, target.scan_id)?;
            let view = view::scan(scan.meta(), scan.items());
            let (state, journal) = (saved.aligner.clone(), std::mem::take(&mut saved.journal));
            GlobalAligner::restore(method, config.sequential, global, spacing_m, state, Some(view), journal)
                .map_err(|e| ServiceError::Work(e.to_string()))?
        }
    };
    aligner.keep_journal();
    Ok(aligner)
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
