//! What navigation hears, given to the mission.

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_core::navigation::{Decision, Echo, LaserView, Mission, RobotWord};
use mirador_ipc_schema::messages::{DECISION_GO, ScanId};
use mirador_ipc_schema::{Participant, Subscriber, Wakeable, text, topics};
use mirador_service_common::ServiceError;

pub(crate) struct Inbox {
    laser: Subscriber<topics::PlanarScan>,
    rangers: Subscriber<topics::Rangers>,
    battery: Subscriber<topics::Battery>,
    states: Subscriber<topics::RobotState>,
    plans: Subscriber<topics::ViewPlan>,
    paths: Subscriber<topics::Path>,
    loops: Subscriber<topics::LoopClosing>,
    corrections: Subscriber<topics::PoseCorrections>,
    /// The newest plan's scan, and `map_from_scanner` it was planned at.
    planned_at: Option<(u64, Pose)>,
    ranges: Vec<f32>,
    /// The header id of the newest plan.
    pub plan_id: u64,
}

impl Inbox {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            laser: participant.subscriber()?,
            rangers: participant.subscriber()?,
            battery: participant.subscriber()?,
            states: participant.subscriber()?,
            plans: participant.subscriber()?,
            paths: participant.subscriber()?,
            loops: participant.subscriber()?,
            corrections: participant.subscriber()?,
            planned_at: None,
            ranges: Vec::new(),
            plan_id: 0,
        })
    }

    /// What may end the wait for a plan.
    pub fn awaited(&self) -> [&dyn Wakeable; 3] {
        [&self.plans, &self.paths, &self.loops]
    }

    /// Takes everything in that is there.
    pub fn drain(&mut self, mission: &mut Mission) -> Result<(), ServiceError> {
        while let Some(message) = self.laser.receive()? {
            let meta = message.meta();
            self.ranges.clear();
            self.ranges.extend(message.items().iter().map(|beam| beam.range));
            mission.laser(&LaserView {
                stamp_ns: meta.header.stamp_ns,
                first_angle: meta.first_angle,
                angle_step: meta.angle_step,
                mount_xyz: meta.mount_xyz,
                mount_yaw: meta.mount_yaw,
                ranges: &self.ranges,
            });
        }
        while let Some(message) = self.rangers.receive()? {
            for m in message.items() {
                mission.echo(Echo {
                    stamp_ns: m.stamp_ns,
                    sensor: m.sensor,
                    mount_xyz: m.mount_xyz,
                    yaw_pitch: m.mount_yaw_pitch,
                    aperture: m.aperture,
                    range: f64::from(m.range),
                });
            }
        }
        while let Some(message) = self.battery.receive()? {
            message.items().iter().for_each(|m| mission.battery(m.low == 1));
        }
        while let Some(message) = self.states.receive()? {
            for m in message.items() {
                mission.robot(RobotWord {
                    scanning: m.scanning == 1,
                    scans: m.scans,
                    emergency_stop: m.emergency_stop == 1,
                    tipped: m.tipped == 1,
                });
            }
        }
        self.drain_plans(mission)
    }

    fn drain_plans(&mut self, mission: &mut Mission) -> Result<(), ServiceError> {
        // What comes of a scan was sent in the order plan, path, corrections, loop closing: taken in backwards, nothing is
        // missed of what goes with the last.
        let mut corrected = Vec::new();
        while let Some(message) = self.loops.receive()? {
            corrected.push(message.header().scan());
        }
        let mut moved = Vec::new();
        while let Some(message) = self.corrections.receive()? {
            moved.extend(message.items().iter().map(|c| (c.id, pose_from_rows(&c.map_from_scanner))));
        }
        while let Some(message) = self.paths.receive()? {
            let waypoints = message.items().iter().map(|waypoint| waypoint.position).collect();
            mission.path(message.header().scan(), waypoints);
        }
        while let Some(message) = self.plans.receive()? {
            let meta = message.meta();
            let decision = if meta.decision == DECISION_GO { Decision::Go } else { Decision::Stop };
            self.plan_id = meta.header.id;
            let reason = format!("{}: {}", text::unpack(&meta.reason_code), text::unpack(&meta.reason));
            mission.plan(meta.header.scan(), decision, &reason);
            self.planned_at = pose_from_rows(&meta.map_from_scanner).map(|pose| (meta.header.id, pose));
        }
        for (id, pose) in moved {
            if let (Some((planned, before)), Some(after)) = (self.planned_at, pose)
                && planned == id
            {
                mission.moved(ScanId::unpack(id).scan, &(after * before.inverse()));
                self.planned_at = Some((id, after));
            }
        }
        corrected.into_iter().for_each(|scan| mission.corrected(scan));
        Ok(())
    }
}
