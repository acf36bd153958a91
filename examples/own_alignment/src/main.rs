//! An alignment service that takes the place of mirador's own: a template. `own.rs` is where your alignment goes; this
//! file is its life in the graph.
//!
//! What the others expect of whoever is `alignment`: the pose of every scan on `alignment`, in the order of the scans, and
//! the number of scans finished in `service_health`, for which lockstep waits. Corrections of older scans may follow on
//! `pose_corrections`; who sends none has nothing else to do.

mod own;

use std::collections::BTreeMap;
use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

use mirador_core::geometry::{Pose, pose_from_rows, rows_from_pose};
use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, Header, ScanId,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Publisher, Received, StopSignal, Subscriber, clock, text, topics};
use mirador_service_common::view;

use own::{Found, Own};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The last line of standard error is what the supervisor gives as the reason.
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let setup = ServiceSetup::from_environment(StopSignal::from_terminal()?)?;
    let participant = setup.join()?;
    let scans: Subscriber<topics::Scan> = participant.subscriber()?;
    let priors: Subscriber<topics::Pose> = participant.subscriber()?;
    let poses: Publisher<topics::Alignment> = participant.publisher()?;
    let mut health = HealthReporter::open(&participant, &setup.name)?;
    let mut own = Own::new(setup.threads)?;
    let (mut prior_of, mut done) = (BTreeMap::new(), 0);
    health.running(&participant);
    while !setup.stop.is_set() {
        participant.wait(&[&scans, &priors], HEARTBEAT);
        // A scan's prior is sent before the scan.
        while let Some(scan) = scans.receive()? {
            receive_priors(&priors, &mut prior_of)?;
            let begin = Instant::now();
            let number = scan.header().scan();
            // One that is sent again, for somebody else, is done.
            if number >= done {
                let began_ns = clock::monotonic_ns();
                let found = own.align(
                    scan.header().id,
                    view::scan(scan.meta(), scan.items()),
                    prior_of.remove(&scan.header().id),
                );
                send(&poses, &scan, &found, began_ns, begin)?;
                done = number + 1;
            }
            health.finished(&participant, done, begin.elapsed());
        }
        poses.serve_late_joiners();
        health.heartbeat(&participant);
    }
    Ok(())
}

fn receive_priors(priors: &Subscriber<topics::Pose>, prior_of: &mut BTreeMap<u64, Pose>) -> Result<(), Box<dyn Error>> {
    while let Some(message) = priors.receive()? {
        if let Some(pose) = message.items().first().and_then(|p| pose_from_rows(&p.map_from_scanner)) {
            prior_of.insert(message.header().id, pose);
        }
    }
    Ok(())
}

/// Publishes a pose with the evidence for it.
fn send(
    poses: &Publisher<topics::Alignment>,
    scan: &Received<topics::Scan>,
    found: &Found,
    began_ns: u64,
    begin: Instant,
) -> Result<(), Box<dyn Error>> {
    let is_first = found.target_id.is_none();
    let (status, reason) = match &found.rejected {
        Some(reason) => (ALIGNMENT_REJECTED, reason.as_str()),
        None if is_first => (ALIGNMENT_FIRST, ""),
        None => (ALIGNMENT_ACCEPTED, ""),
    };
    let mut loan = poses.loan(0)?;
    *loan.meta_mut() = AlignmentMeta {
        header: Header::about(scan.header(), began_ns),
        map_from_scanner: rows_from_pose(&found.map_from_scanner),
        covariance: std::array::from_fn(|i| found.covariance[(i / 6, i % 6)]),
        pair_covariance: std::array::from_fn(|i| found.pair_covariance[(i / 6, i % 6)]),
        prior: found.prior.as_ref().map_or([0.0; 16], rows_from_pose),
        has_prior: u32::from(found.prior.is_some()),
        overlap: found.overlap,
        residual_m: found.residual_m,
        align_ns: u64::try_from(begin.elapsed().as_nanos())?,
        status,
        target_scan: found.target_id.map_or(u32::MAX, |id| ScanId::unpack(id).scan),
        iterations: found.iterations,
        constrained: 0b11_1111,
        is_keyframe: u32::from(found.rejected.is_none()),
        method: text::pack("own"),
        reason: text::pack(reason),
        ..AlignmentMeta::default()
    };
    Ok(loan.send()?)
}
