//! The loop: sensors come in, a control step is complete, the estimate goes out; and a prior for each scan.

use std::time::Duration;

use mirador_core::geometry::{pose_from_rows, rows_from_pose};
use mirador_core::localization::{Estimate, Localizer, ScanPoseUse};
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, CLOCK_RUNNING, Envelope, Header, POSE_FROM_LOCALIZATION, PoseEstimate, RobotPose, ScanId,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Subscriber, Wakeable, topics};
use mirador_service_common::ServiceError;

use crate::LocalizationConfig;
use crate::kept::{self, KEEP_NS};
use crate::messages::{covariance_from_rows, rows_from_covariance};
use crate::sensors::Sensors;

/// Estimates until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &LocalizationConfig) -> Result<(), ServiceError> {
    let localizer = Localizer::new(config.clone()).map_err(|e| ServiceError::Config(format!("localization.{e}")))?;
    let participant = setup.join()?;
    let mut service = Service::open(setup, localizer, &participant)?;
    service.health.running(&participant);
    while !setup.stop.is_set() {
        participant.wait(&service.awaited(), HEARTBEAT);
        service.hear(&participant)?;
        service.poses.serve_late_joiners();
        service.priors.serve_late_joiners();
        service.health.heartbeat(&participant);
    }
    Ok(())
}

struct Service<'a> {
    setup: &'a ServiceSetup,
    localizer: Localizer,
    sensors: Sensors,
    states: Subscriber<topics::RobotState>,
    clock: Subscriber<topics::Clock>,
    alignments: Subscriber<topics::Alignment>,
    corrections: Subscriber<topics::PoseCorrections>,
    poses: Publisher<topics::RobotPoses>,
    priors: Publisher<topics::Pose>,
    health: HealthReporter,
    /// Of the clock: the scan whose prior is due, when a control step that ends after it is complete.
    due: Option<Header>,
    /// The newest scan a prior was given for.
    newest_scan: Option<u32>,
    /// Scans below this are aligned, or could not be: they are done.
    aligned_scans: u32,
    /// The time of the last complete step.
    step_ns: Option<i64>,
    was_lost: bool,
    kept_ns: Option<i64>,
}

impl<'a> Service<'a> {
    fn open(
        setup: &'a ServiceSetup,
        mut localizer: Localizer,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        if setup.incarnation > 0 {
            kept::resume(&setup.state_file(), &mut localizer)?;
        }
        Ok(Self {
            setup,
            localizer,
            // Readers first: what is sent meanwhile waits in their buffers.
            sensors: Sensors::open(participant)?,
            states: participant.subscriber()?,
            clock: participant.subscriber()?,
            alignments: participant.subscriber()?,
            corrections: participant.subscriber()?,
            poses: participant.publisher()?,
            priors: participant.publisher()?,
            health: HealthReporter::open(participant, &setup.name)?,
            due: None,
            newest_scan: None,
            aligned_scans: 0,
            step_ns: None,
            was_lost: false,
            kept_ns: None,
        })
    }

    fn awaited(&self) -> [&dyn Wakeable; 4] {
        // Sensors are read when their step is complete; they need not wake.
        [&self.states, &self.clock, &self.alignments, &self.corrections]
    }

    /// Takes everything in that is there, in the order in which it counts.
    fn hear(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        self.hear_clock()?;
        self.hear_alignment()?;
        while let Some(message) = self.states.receive()? {
            // What was sent before it is there by now.
            let header = *message.header();
            drop(message);
            self.sensors.drain(&mut self.localizer)?;
            self.hear_clock()?;
            self.hear_alignment()?;
            self.complete(&header)?;
        }
        self.give_prior()?;
        if self.aligned_scans > self.health.finished_scans() {
            self.health.finished(participant, self.aligned_scans, Duration::ZERO);
        }
        Ok(())
    }

    fn hear_clock(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.clock.receive()? {
            let header = *message.header();
            let is_new = self.newest_scan.is_none_or(|newest| header.scan() > newest);
            if message.meta().state == CLOCK_RUNNING && is_new {
                self.due = Some(header);
            }
        }
        Ok(())
    }

    fn hear_alignment(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.alignments.receive()? {
            let meta = message.meta();
            let scan = meta.header.scan();
            self.aligned_scans = self.aligned_scans.max(scan.saturating_add(1));
            if meta.status == ALIGNMENT_REJECTED {
                tracing::info!(scan, "its alignment was rejected; the estimate stays as it is");
                continue;
            }
            let Some(pose) = pose_from_rows(&meta.map_from_scanner) else {
                tracing::warn!(scan, "its alignment is not a rigid pose; ignored");
                continue;
            };
            // The estimate is the place in the map, whatever that has drifted by since its first scan.
            match self.localizer.align(scan, &pose, &covariance_from_rows(&meta.pair_covariance)) {
                ScanPoseUse::Corrected => tracing::debug!(scan, "the estimate is corrected by its alignment"),
                ScanPoseUse::Moved => {
                    tracing::warn!(scan, "its alignment contradicts the estimate, which is moved there")
                }
                ScanPoseUse::Unknown => tracing::debug!(scan, "aligned, but no prior was given for it"),
                ScanPoseUse::Refused => tracing::warn!(scan, "its alignment is not finite; ignored"),
            }
        }
        while let Some(message) = self.corrections.receive()? {
            for correction in message.items() {
                if let Some(pose) = pose_from_rows(&correction.map_from_scanner) {
                    self.localizer.correct(ScanId::unpack(correction.id).scan, &pose);
                }
            }
        }
        Ok(())
    }

    /// A control step is complete: says where the robot is.
    fn complete(&mut self, header: &Header) -> Result<(), ServiceError> {
        if self.step_ns.is_some_and(|last| header.stamp_ns <= last) {
            tracing::warn!(stamp_ns = header.stamp_ns, "a control step that is not after the last one; ignored");
            return Ok(());
        }
        let estimate = self.localizer.advance(header.stamp_ns);
        self.step_ns = Some(header.stamp_ns);
        self.tell(&estimate);
        let scan = self.newest_scan.unwrap_or(u32::MAX);
        let id = ScanId { robot: 0, run: self.setup.run, scan }.pack();
        let message = Header { clock_id: header.clock_id, ..Header::new(id, header.stamp_ns) };
        let pose = RobotPose {
            map_from_robot: rows_from_pose(&estimate.map_from_robot),
            covariance: rows_from_covariance(&estimate.covariance),
            linear: estimate.linear,
            angular: estimate.angular,
            lost: u32::from(estimate.lost.is_some()),
            aligned_scan: estimate.aligned_scan.unwrap_or(u32::MAX),
        };
        if self.kept_ns.is_none_or(|kept| header.stamp_ns.saturating_sub(kept) >= KEEP_NS) {
            kept::keep(&self.setup.state_file(), &pose)?;
            self.kept_ns = Some(header.stamp_ns);
        }
        self.poses.send_one(Envelope { header: message }, pose)?;
        self.give_prior()
    }

    /// Says when it gets lost and when it is found again.
    fn tell(&mut self, estimate: &Estimate) {
        match estimate.lost {
            Some(reason) if !self.was_lost => {
                tracing::warn!(%reason, stamp_ns = estimate.stamp_ns, "localisation is lost");
                self.health.message(&format!("lost: {reason}"));
            }
            None if self.was_lost => {
                tracing::info!(stamp_ns = estimate.stamp_ns, "localisation knows again where the robot is");
                self.health.message("");
            }
            _ => {}
        }
        self.was_lost = estimate.lost.is_some();
    }

    /// The prior of the scan that is due, once everything up to its end is known.
    fn give_prior(&mut self) -> Result<(), ServiceError> {
        let step_ns = self.step_ns;
        let is_ready = |due: &mut Header| step_ns.is_some_and(|step| step >= due.stamp_ns);
        let Some(due) = self.due.take_if(is_ready) else { return Ok(()) };
        let scan = due.scan();
        let prior = self.localizer.prior(scan);
        self.newest_scan = Some(scan);
        let estimate = PoseEstimate {
            map_from_scanner: rows_from_pose(&prior.map_from_scanner),
            covariance: rows_from_covariance(&prior.covariance),
            source: POSE_FROM_LOCALIZATION,
            lost: u32::from(prior.lost.is_some()),
            reserved: 0,
        };
        let header = Header { clock_id: due.clock_id, ..Header::new(due.id, due.stamp_ns) };
        Ok(self.priors.send_one(Envelope { header }, estimate)?)
    }
}
