//! The loop: a pose comes, a command goes out.

use std::collections::VecDeque;
use std::time::Duration;

use mirador_core::geometry::pose_from_rows;
use mirador_core::navigation::{DriveState, Mission, MissionState, MissionStep, RobotNow};
use mirador_ipc_schema::messages::{
    Envelope, Header, MotionCommand, NavigationStatus, Obstruction, RobotPose, ScanId, ScanRequest, ScanRequestKind,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Subscriber, Wakeable, text, topics};
use mirador_service_common::ServiceError;

use crate::NavigationConfig;
use crate::inbox::Inbox;

/// Priority of navigation's commands.
pub(crate) const NAVIGATION: u32 = 4;
/// Time between two statuses while nothing changes [ns].
const STATUS_NS: i64 = 1_000_000_000;

/// Drives until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &NavigationConfig) -> Result<(), ServiceError> {
    config.validate().map_err(|e| ServiceError::Config(format!("navigation.{e}")))?;
    let participant = setup.join()?;
    let mut service = Service::open(setup, config, &participant)?;
    service.health.running(&participant);
    while !setup.stop.is_set() {
        participant.wait(&service.awaited(), HEARTBEAT);
        service.answer(&participant)?;
        service.status.serve_late_joiners();
        service.obstructions.serve_late_joiners();
        service.health.heartbeat(&participant);
    }
    Ok(())
}

struct Service<'a> {
    setup: &'a ServiceSetup,
    config: NavigationConfig,
    mission: Mission,
    inbox: Inbox,
    poses: Subscriber<topics::RobotPoses>,
    commands: Publisher<topics::MotionCommand>,
    requests: Publisher<topics::ScanRequests>,
    status: Publisher<topics::NavigationStatus>,
    obstructions: Publisher<topics::Obstructions>,
    health: HealthReporter,
    /// Steps that are not answered yet, oldest first.
    pending: VecDeque<(Header, RobotPose)>,
    /// What was said last, and when.
    said: Option<(i64, u32, String)>,
    was_faulty: bool,
}

impl<'a> Service<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &NavigationConfig,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        Ok(Self {
            setup,
            config: config.clone(),
            mission: Mission::new(config.clone()),
            inbox: Inbox::open(participant)?,
            poses: participant.subscriber()?,
            commands: participant.publisher()?,
            requests: participant.publisher()?,
            status: participant.publisher()?,
            obstructions: participant.publisher()?,
            health: HealthReporter::open(participant, &setup.name)?,
            pending: VecDeque::new(),
            said: None,
            was_faulty: false,
        })
    }

    fn awaited(&self) -> [&dyn Wakeable; 4] {
        let [plans, paths, loops] = self.inbox.awaited();
        [&self.poses, plans, paths, loops]
    }

    /// Answers every step that can be answered.
    fn answer(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        while let Some(message) = self.poses.receive()? {
            let header = *message.header();
            self.pending.extend(message.items().iter().map(|pose| (header, *pose)));
        }
        self.inbox.drain(&mut self.mission)?;
        while let Some((header, pose)) = self.pending.front().copied() {
            let Some(map_from_robot) = pose_from_rows(&pose.map_from_robot) else {
                tracing::warn!(stamp_ns = header.stamp_ns, "a robot_pose is not a rigid pose; ignored");
                self.pending.pop_front();
                continue;
            };
            let (stamp_ns, linear, is_lost) = (header.stamp_ns, pose.linear, pose.lost == 1);
            let now = RobotNow { stamp_ns, map_from_robot, linear, is_lost };
            let step = self.mission.step(&now);
            self.tell(participant, &header)?;
            self.tell_obstruction(&header)?;
            let MissionStep::Answer { linear, angular, request } = step else { break };
            if let Some(scan) = request {
                self.ask(&header, scan)?;
            }
            self.command(&header, linear, angular)?;
            self.pending.pop_front();
            if self.mission.planned_scans() > self.health.finished_scans() {
                self.health.finished(participant, self.mission.planned_scans(), Duration::ZERO);
            }
        }
        Ok(())
    }

    fn command(&self, about: &Header, linear: f64, angular: f64) -> Result<(), ServiceError> {
        let command = MotionCommand {
            stamp_ns: about.stamp_ns,
            linear,
            angular,
            valid_ns: u64::from(self.config.command_valid_ms) * 1_000_000,
            source: NAVIGATION,
            reserved: 0,
        };
        let header = Header { clock_id: about.clock_id, ..Header::new(about.id, about.stamp_ns) };
        Ok(self.commands.send_one(Envelope { header }, command)?)
    }

    fn ask(&self, about: &Header, scan: u32) -> Result<(), ServiceError> {
        let id = ScanId { robot: 0, run: self.setup.run, scan }.pack();
        let header = Header { clock_id: about.clock_id, ..Header::new(id, about.stamp_ns) };
        let request = ScanRequest { kind: ScanRequestKind::TAKE, scan, reserved: 0 };
        Ok(self.requests.send_one(Envelope { header }, request)?)
    }

    /// Says where something held the robot: before it asks for the scan there, so that the plan of that scan knows.
    fn tell_obstruction(&mut self, about: &Header) -> Result<(), ServiceError> {
        let Some(found) = self.mission.take_obstruction() else { return Ok(()) };
        let scan = self.mission.planned_scans().saturating_sub(1);
        tracing::info!(x = found.centre[0], y = found.centre[1], scan, "something held the robot there");
        let obstruction = Obstruction { centre: found.centre, radius: found.radius_m, scan, reserved: 0 };
        let header = Header { clock_id: about.clock_id, ..Header::new(about.id, about.stamp_ns) };
        Ok(self.obstructions.send_one(Envelope { header }, obstruction)?)
    }

    /// Says what it does, when that changes and once a second of its time.
    fn tell(&mut self, participant: &Participant, about: &Header) -> Result<(), ServiceError> {
        let (state, reason) = self.situation();
        let is_news = self.said.as_ref().is_none_or(|(_, last, why)| *last != state || *why != reason);
        let is_due = self.said.as_ref().is_none_or(|(at, ..)| about.stamp_ns.saturating_sub(*at) >= STATUS_NS);
        if !is_news && !is_due {
            return Ok(());
        }
        if is_news {
            tracing::info!(state, reason, "navigation");
            self.health.message(&reason);
            if let MissionState::Ended { is_fault: true, reason } = self.mission.state() {
                self.health.failed(participant, reason);
            }
        }
        let driver = self.mission.driver();
        let status = NavigationStatus {
            state,
            waypoint: driver.map_or(0, |driver| u32::try_from(driver.waypoint()).unwrap_or(u32::MAX)),
            driven_m: driver.map_or(0.0, |driver| driver.driven()),
            left_m: driver.map_or(0.0, |driver| driver.left()),
            plan_id: self.inbox.plan_id,
            reason: text::pack(&reason),
        };
        self.said = Some((about.stamp_ns, state, reason));
        let header = Header { clock_id: about.clock_id, ..Header::new(about.id, about.stamp_ns) };
        Ok(self.status.send_one(Envelope { header }, status)?)
    }

    /// The state as in [`NavigationStatus`], and why.
    fn situation(&mut self) -> (u32, String) {
        let fault = self.mission.fault();
        if fault.is_some() != self.was_faulty {
            match &fault {
                Some(fault) => tracing::warn!(%fault, "a sensor is not well"),
                None => tracing::info!("all sensors are well again"),
            }
            self.was_faulty = fault.is_some();
        }
        match self.mission.state() {
            MissionState::Begin => (0, "waits for the robot".into()),
            MissionState::Settling { scan } | MissionState::Scanning { scan } => match self.mission.last_give_up() {
                Some(why) => (5, format!("{why}; takes scan {scan}")),
                None if *scan > 0 => (2, format!("arrived; takes scan {scan}")),
                None => (0, format!("takes scan {scan}")),
            },
            MissionState::Planning { scan } => (0, format!("waits for the plan of scan {scan}")),
            MissionState::Ended { reason, is_fault } => (if *is_fault { 5 } else { 0 }, reason.clone()),
            MissionState::Driving { .. } => {
                let why = fault.map_or_else(|| "localisation is lost".into(), sensor_text);
                match self.mission.driver().map(|driver| driver.state()) {
                    Some(DriveState::Blocked) => (3, "an obstacle in front".into()),
                    Some(DriveState::Waiting) => (3, why),
                    Some(DriveState::Recovering) => (4, "backs up".into()),
                    _ => (1, String::new()),
                }
            }
        }
    }
}

/// A fault without the figures that change from step to step.
fn sensor_text(fault: mirador_core::navigation::SensorFault) -> String {
    use mirador_core::navigation::SensorFault::{Babbles, Silent};
    match fault {
        Silent { sensor, .. } => format!("{sensor} is silent"),
        Babbles { sensor, .. } => format!("{sensor} babbles"),
    }
}
