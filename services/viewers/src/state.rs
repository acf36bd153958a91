//! What there is to draw now.

use std::collections::BTreeMap;

use foxglove::Encode;
use foxglove::messages::log::Level;
use foxglove::messages::{FrameTransform, Log};
use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_ipc_schema::Header;
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, AlignmentMeta, CandidateView, DECISION_STOP, PoseCorrection, RobotPose, ScanId, ViewPlanMeta,
    Waypoint, Zone,
};
use mirador_ipc_schema::text;

use crate::channels::{
    CANDIDATES, CLOUD, DOTS_CANDIDATES, DOTS_MAP, DOTS_PATH, DOTS_POSES, DOTS_ZONES, GRID, LOG, MODEL, PATH, POSES, TF,
    ZONES,
};
use crate::map::Tiles;
use crate::model::Model;
use crate::points::{ScoredPoint, draw_pose, level_pose, poses_in_map, scored_cloud, stamps, timestamp};
use crate::{MAP, ROBOT, SCANNER, Sink, Stamps, dots, scene};

/// The robot is drawn again when it has moved so far [m] or turned so far [rad].
const ROBOT_MOVED: (f64, f64) = (0.05, 0.035);

/// Everything that viewers are shown, as it is now.
pub(crate) struct State {
    /// Poses of the aligned scans.
    trajectory: BTreeMap<u32, Pose>,
    trajectory_at: Header,
    scanner: Option<(Header, Pose)>,
    robot: Option<(Header, Pose)>,
    /// The newest scan that has pose and scores, with the points in its own frame.
    cloud: Option<(Header, Pose, Vec<ScoredPoint>)>,
    model: Model,
    zones: Option<(Header, Vec<Zone>)>,
    plan: Option<(ViewPlanMeta, Vec<CandidateView>)>,
    path: Option<(Header, Vec<Waypoint>)>,
    pub(crate) tiles: Tiles,
    /// Lines that were not drawn yet.
    log: Vec<(Stamps, Log)>,
    /// The line that was drawn last.
    said: Option<(Stamps, Log)>,
}

impl State {
    pub(crate) fn new() -> Self {
        Self {
            trajectory: BTreeMap::new(),
            trajectory_at: Header::default(),
            scanner: None,
            robot: None,
            cloud: None,
            model: Model::new(),
            zones: None,
            plan: None,
            path: None,
            tiles: Tiles::default(),
            log: Vec::new(),
            said: None,
        }
    }

    /// Enters the pose of an aligned scan; `None` for one that was not aligned.
    pub(crate) fn place_scan(&mut self, meta: &AlignmentMeta) -> Option<Pose> {
        if meta.status == ALIGNMENT_REJECTED {
            let line = format!("scan {} is not aligned: {}", meta.header.scan(), text::unpack(&meta.reason));
            self.say(&meta.header, Level::Warning, "alignment", line);
            return None;
        }
        let pose = pose_from_rows(&meta.map_from_scanner)?;
        self.trajectory.insert(meta.header.scan(), pose);
        self.trajectory_at = meta.header;
        self.scanner = Some((meta.header, pose));
        Some(pose)
    }

    /// Enters corrected poses; whether the newest scan has moved, too.
    pub(crate) fn correct(&mut self, header: &Header, corrections: &[PoseCorrection]) -> bool {
        let mut has_moved = false;
        for correction in corrections {
            let scan = ScanId::unpack(correction.id).scan;
            let Some(new) = pose_from_rows(&correction.map_from_scanner) else { continue };
            if let Some(old) = self.trajectory.get_mut(&scan) {
                *old = new;
            }
            if let Some((_, pose, _)) = self.cloud.as_mut().filter(|(header, ..)| header.scan() == scan) {
                has_moved |= *pose != new;
                *pose = new;
            }
            if let Some((_, pose)) = self.scanner.as_mut().filter(|(header, _)| header.scan() == scan) {
                *pose = new;
            }
        }
        self.trajectory_at = *header;
        has_moved
    }

    /// A scan that has pose and scores.
    pub(crate) fn show_scan(&mut self, header: &Header, pose: Pose, points: Vec<ScoredPoint>) {
        self.model.add(header.scan(), &points);
        self.cloud = Some((*header, pose, points));
    }

    /// Where the robot is; whether that is to be drawn.
    pub(crate) fn move_robot(&mut self, header: &Header, robot: &RobotPose) -> bool {
        let Some(pose) = pose_from_rows(&robot.map_from_robot) else { return false };
        let has_moved = self.robot.as_ref().is_none_or(|(_, before)| {
            let change = before.inv_mul(&pose);
            change.translation.vector.norm() > ROBOT_MOVED.0 || change.rotation.angle() > ROBOT_MOVED.1
        });
        if has_moved {
            self.robot = Some((*header, pose));
        }
        has_moved
    }

    pub(crate) fn set_zones(&mut self, header: &Header, zones: &[Zone]) {
        self.zones = Some((*header, zones.to_vec()));
    }

    pub(crate) fn set_plan(&mut self, plan: &ViewPlanMeta, candidates: &[CandidateView]) {
        let (scan, reason) = (plan.header.scan(), text::unpack(&plan.reason));
        let what = if plan.decision == DECISION_STOP { "stop".into() } else { format!("candidate {}", plan.chosen) };
        self.say(&plan.header, Level::Info, "planning", format!("scan {scan}: {what}: {reason}"));
        self.plan = Some((*plan, candidates.to_vec()));
    }

    pub(crate) fn set_path(&mut self, header: &Header, waypoints: &[Waypoint]) {
        self.path = Some((*header, waypoints.to_vec()));
    }

    pub(crate) fn say(&mut self, header: &Header, level: Level, name: &str, message: String) {
        let stamps = stamps(header);
        let timestamp = Some(timestamp(stamps));
        let log = Log { timestamp, level: level as i32, message, name: name.into(), ..Log::default() };
        self.log.push((stamps, log));
    }

    /// The lines that wait have been drawn.
    pub(crate) fn lines_drawn(&mut self) {
        if let Some(last) = self.log.drain(..).next_back() {
            self.said = Some(last);
        }
    }

    /// Draws the line that was drawn last.
    pub(crate) fn say_again<S: Sink>(&self, out: &mut S) -> Result<(), S::Error> {
        self.said.iter().try_for_each(|(stamps, log)| emit(out, LOG, *stamps, log).map(drop))
    }

    /// Draws a channel; gives the size of what was drawn [bytes], 0 where there is nothing to draw.
    pub(crate) fn draw<S: Sink>(&mut self, out: &mut S, channel: &'static str) -> Result<usize, S::Error> {
        match channel {
            TF => self.draw_frames(out),
            POSES | DOTS_POSES | CLOUD | MODEL => self.draw_scans(out, channel),
            CANDIDATES | DOTS_CANDIDATES => match &self.plan {
                Some((plan, candidates)) => {
                    let at = stamps(&plan.header);
                    match channel {
                        CANDIDATES => emit(out, channel, at, &scene::candidates(at, plan, candidates)),
                        _ => emit(out, channel, at, &dots::candidates(at, plan, candidates)),
                    }
                }
                None => Ok(0),
            },
            ZONES | DOTS_ZONES => match &self.zones {
                Some((header, zones)) => match (channel, stamps(header)) {
                    (ZONES, at) => emit(out, channel, at, &scene::zones(at, zones)),
                    (_, at) => emit(out, channel, at, &dots::zones(at, zones)),
                },
                None => Ok(0),
            },
            PATH | DOTS_PATH => match &self.path {
                Some((header, path)) => match (channel, stamps(header)) {
                    (PATH, at) => emit(out, channel, at, &poses_in_map(at, path_poses(path))),
                    (_, at) => emit(out, channel, at, &dots::path(at, path)),
                },
                None => Ok(0),
            },
            GRID => self.tiles.grid().map_or(Ok(0), |(at, grid)| emit(out, channel, at, &grid)),
            DOTS_MAP => self.tiles.dots().map_or(Ok(0), |(at, cloud)| emit(out, channel, at, &cloud)),
            LOG => self.log.iter().try_fold(0, |size, (at, log)| Ok(size + emit(out, channel, *at, log)?)),
            _ => Ok(0),
        }
    }

    fn draw_scans<S: Sink>(&mut self, out: &mut S, channel: &'static str) -> Result<usize, S::Error> {
        let at = stamps(&self.trajectory_at);
        match channel {
            _ if self.trajectory.is_empty() => Ok(0),
            POSES => emit(out, channel, at, &poses_in_map(at, self.trajectory.values().map(draw_pose).collect())),
            DOTS_POSES => emit(out, channel, at, &dots::poses(at, self.trajectory.values())),
            CLOUD => self.cloud.as_ref().map_or(Ok(0), |(header, pose, points)| {
                let at = stamps(header);
                emit(out, channel, at, &scored_cloud(at, draw_pose(pose), points.iter().copied()))
            }),
            _ => {
                let points = self.model.points(&self.trajectory);
                emit(out, channel, at, &scored_cloud(at, level_pose([0.0; 3], 0.0), points.into_iter()))
            }
        }
    }

    fn draw_frames<S: Sink>(&self, out: &mut S) -> Result<usize, S::Error> {
        let frames = [(SCANNER, &self.scanner), (ROBOT, &self.robot)];
        let there = frames.into_iter().filter_map(|(name, frame)| frame.as_ref().map(|frame| (name, frame)));
        there.into_iter().try_fold(0, |size, (name, (header, pose))| {
            let (at, drawn) = (stamps(header), draw_pose(pose));
            let transform = FrameTransform {
                timestamp: Some(timestamp(at)),
                parent_frame_id: MAP.into(),
                child_frame_id: name.into(),
                translation: drawn.position,
                rotation: drawn.orientation,
            };
            Ok(size + emit(out, TF, at, &transform)?)
        })
    }
}

/// Every pose of a path looks at the next.
fn path_poses(waypoints: &[Waypoint]) -> Vec<foxglove::messages::Pose> {
    let mut heading = 0.0;
    let pose = |(k, here): (usize, &Waypoint)| {
        if let Some(next) = waypoints.get(k + 1) {
            heading = (next.position[1] - here.position[1]).atan2(next.position[0] - here.position[0]);
        }
        level_pose(here.position, heading)
    };
    waypoints.iter().enumerate().map(pose).collect()
}

/// Hands a drawing over; gives its size [bytes].
fn emit<S: Sink, M: Encode>(out: &mut S, channel: &'static str, at: Stamps, message: &M) -> Result<usize, S::Error> {
    out.draw(channel, at, message)?;
    Ok(message.encoded_len().unwrap_or(0))
}
