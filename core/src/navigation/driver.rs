//! Drives one path, until the robot has arrived or the target is given up.

use nalgebra::{Vector2, Vector3};

use super::config::NavigationConfig;
use super::drive::{Drive, DriveState, RobotNow};
use super::give_up::GiveUp;
use super::lean::{LeanWatch, downhill};
use super::obstacles::{Surroundings, Way};
use super::path::Path;
use super::progress::{Progress, Trail};
use super::pursuit::{Aim, Pursuit};
use super::recover::Retreat;
use super::watch::SensorFault;
use crate::geometry::Pose;
use crate::information_map::Obstruction;

/// Longest control step that counts [s]: a longer pause was none of the robot's.
const LONGEST_STEP_S: f64 = 0.2;
/// Speed while an echo is short or the ground may fall away [m/s].
const CAREFUL_SPEED: f64 = 0.2;
/// How far from the obstacle, beyond the gap that is kept, the robot counts as stopped by it [m].
const STOPPED_M: f64 = 0.05;
/// Leaning so much more than when the ground began to look as if it fell away is proof that it does [deg].
const EDGE_TILT_DEG: f64 = 4.0;
/// A path may begin so far beside the robot, where it stands on what cannot be driven on; then it may be so much farther off it [m].
const MOST_OFF_AT_START_M: f64 = 1.5;
/// How long a lost localisation is waited for [s].
const LOST_S: f64 = 3.0;

/// Follows one path.
#[derive(Debug, Clone)]
pub struct Driver {
    pub(super) path: Path,
    pub(super) pursuit: Pursuit,
    state: DriveState,
    /// Since when the state holds, and the path is driven.
    pub(super) since_ns: Option<i64>,
    begun_ns: Option<i64>,
    last_ns: Option<i64>,
    speed: f64,
    at: Option<Vector2<f64>>,
    driven: f64,
    /// How far off its path the robot stood at its beginning [m].
    began_off: Option<f64>,
    progress: Progress,
    pub(super) trail: Trail,
    pub(super) retreat: Retreat,
    /// Way driven since the ground began to look as if it fell away [m], and how far the robot leant then [deg].
    pub(super) falling: f64,
    tilt_before_deg: f64,
    pub(super) lean: LeanWatch,
    healthy_since_ns: Option<i64>,
    ahead: Vec<Vector2<f64>>,
    /// What was asked of the drives last: forward and turning speed.
    asked: [f64; 2],
    pub(super) obstruction: Option<Obstruction>,
}

impl Driver {
    /// A driver at the beginning of a path.
    #[must_use]
    pub fn new(path: Path) -> Self {
        Self {
            path,
            pursuit: Pursuit::new(),
            state: DriveState::Driving,
            since_ns: None,
            begun_ns: None,
            last_ns: None,
            speed: 0.0,
            at: None,
            driven: 0.0,
            began_off: None,
            progress: Progress::default(),
            trail: Trail::default(),
            retreat: Retreat::default(),
            falling: 0.0,
            tilt_before_deg: 0.0,
            lean: LeanWatch::default(),
            healthy_since_ns: None,
            ahead: Vec::new(),
            asked: [0.0; 2],
            obstruction: None,
        }
    }

    /// The same for a robot that has been driven before: it knows the way that it has come.
    #[must_use]
    pub fn after(before: Option<&Self>, path: Path) -> Self {
        let trail = before.map(|driver| driver.trail.clone()).unwrap_or_default();
        Self { trail, ..Self::new(path) }
    }

    /// The map has moved under the path, and under the way that the robot has come.
    pub fn move_path(&mut self, new_from_old: &Pose) {
        self.path.move_by(new_from_old);
        self.trail.move_by(new_from_old);
    }

    /// The path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is being done.
    #[must_use]
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// Number of the waypoint that is driven to.
    #[must_use]
    pub fn waypoint(&self) -> usize {
        self.path.waypoint_after(self.pursuit.along)
    }

    /// Distance driven [m].
    #[must_use]
    pub fn driven(&self) -> f64 {
        self.driven
    }

    /// Distance left along the path [m].
    #[must_use]
    pub fn left(&self) -> f64 {
        (self.path.length() - self.pursuit.along).max(0.0)
    }

    /// Distance from the path [m].
    #[must_use]
    pub fn off(&self) -> f64 {
        self.pursuit.off
    }

    /// Where something held the robot, once the target is given up for it; once.
    pub fn take_obstruction(&mut self) -> Option<Obstruction> {
        self.obstruction.take()
    }

    /// One control step.
    pub fn step(
        &mut self,
        now: &RobotNow,
        around: &Surroundings,
        fault: Option<SensorFault>,
        config: &NavigationConfig,
    ) -> Drive {
        let step = self.pass_time(now);
        let done = matches!(self.state, DriveState::Arrived | DriveState::GaveUp(_));
        let wanted = if done { [0.0; 2] } else { self.decide(now, step, around, fault, config) };
        let [linear, angular] = wanted;
        self.speed = linear;
        Drive { linear, angular, state: self.state, fault }
    }

    fn pass_time(&mut self, now: &RobotNow) -> f64 {
        let step = self.last_ns.map_or(0.0, |last| seconds(last, now.stamp_ns)).clamp(0.0, LONGEST_STEP_S);
        if self.last_ns.is_none() {
            self.trail.carry_on(&now.map_from_robot);
            self.begin_backwards(now);
        }
        self.trail.stand(&now.map_from_robot);
        self.last_ns = Some(now.stamp_ns);
        self.begun_ns = self.begun_ns.or(Some(now.stamp_ns));
        let at = place(&now.map_from_robot);
        let moved = self.at.map_or(0.0, |before| (at - before).norm());
        self.at = Some(at);
        self.driven += moved;
        if self.falling > 0.0 {
            self.falling += moved;
        }
        step
    }

    fn decide(
        &mut self,
        now: &RobotNow,
        step: f64,
        around: &Surroundings,
        fault: Option<SensorFault>,
        config: &NavigationConfig,
    ) -> [f64; 2] {
        if let Some(reason) = self.hopeless(now, config) {
            return self.give_up(now, reason, config);
        }
        if self.must_wait(now, fault, config) {
            return [0.0; 2];
        }
        match self.state {
            DriveState::Recovering => self.back_up(now, step, around, config),
            _ => self.follow(now, step, around, config),
        }
    }

    /// What no waiting helps against.
    fn hopeless(&self, now: &RobotNow, config: &NavigationConfig) -> Option<GiveUp> {
        let driving = self.begun_ns.map_or(0.0, |begun| seconds(begun, now.stamp_ns));
        if driving > config.follow.patience_s_per_m * (self.path.length() + 5.0) {
            return Some(GiveUp::Timeout { seconds: driving });
        }
        let tilt_deg = tilt(&now.map_from_robot).to_degrees();
        let is_backing = self.state == DriveState::Recovering;
        if tilt_deg > config.follow.max_tilt_deg && !now.is_lost && !is_backing {
            // Going back is what may help; the second time it does not.
            if self.retreat.attempts >= config.recovery.attempts || self.driven < 0.1 {
                return Some(GiveUp::Tilted { tilt_deg });
            }
        }
        let off_m = self.pursuit.off;
        // It backs up the way it came, which may lie beside the path or before its beginning.
        let has_backed = self.retreat.attempts > 0 || self.retreat.began_path;
        let backed_m = if has_backed { config.recovery.back_up_m } else { 0.0 };
        let began_m = self.began_off.map_or(0.0, |off_m| off_m.min(MOST_OFF_AT_START_M));
        (off_m > config.follow.off_path_m + backed_m + began_m && !is_backing).then_some(GiveUp::OffPath { off_m })
    }

    /// Whether sensors or localisation must be waited for; gives up when it takes too long.
    fn must_wait(&mut self, now: &RobotNow, fault: Option<SensorFault>, config: &NavigationConfig) -> bool {
        if fault.is_none() && !now.is_lost {
            let since = *self.healthy_since_ns.get_or_insert(now.stamp_ns);
            let settled = self.state != DriveState::Waiting || seconds(since, now.stamp_ns) >= config.watch.settle_s;
            if settled && self.state == DriveState::Waiting {
                self.enter(now, if self.retreat.leaves_edge { DriveState::Recovering } else { DriveState::Driving });
            }
            return !settled;
        }
        self.healthy_since_ns = None;
        if self.state != DriveState::Waiting {
            self.enter(now, DriveState::Waiting);
        }
        let waited = self.since_ns.map_or(0.0, |since| seconds(since, now.stamp_ns));
        match fault {
            Some(fault) if waited > config.watch.patience_s => self.state = DriveState::GaveUp(GiveUp::Sensor(fault)),
            None if waited > LOST_S => self.state = DriveState::GaveUp(GiveUp::Lost),
            _ => {}
        }
        true
    }

    fn follow(&mut self, now: &RobotNow, step: f64, around: &Surroundings, config: &NavigationConfig) -> [f64; 2] {
        let at = place(&now.map_from_robot);
        let aim = self.pursuit.aim(&self.path, &now.map_from_robot, now.linear.abs(), &config.follow);
        self.began_off.get_or_insert(self.pursuit.off);
        if aim.arrived {
            self.enter(now, DriveState::Arrived);
            return [0.0; 2];
        }
        let tilt_deg = tilt(&now.map_from_robot).to_degrees();
        if tilt_deg > config.follow.max_tilt_deg {
            return self.recover(now, GiveUp::Tilted { tilt_deg }, config);
        }
        let turning = aim.curvature.is_none().then_some(aim.turn);
        let leans_on_the_way = turning.is_none() && self.lean.leans_on_the_way(self.driven, tilt_deg);
        if self.lean.leans(turning, &now.map_from_robot, tilt_deg) || leans_on_the_way {
            return self.recover(now, GiveUp::Edge, config);
        }
        self.trail.note(&at);
        let reach = config.obstacles.half_length_m + config.obstacles.slow_gap_m + 0.5;
        let mut ahead = std::mem::take(&mut self.ahead);
        self.pursuit.ahead(&self.path, &at, reach, &mut ahead);
        let pose = &now.map_from_robot;
        let way = around.way(now.stamp_ns, pose, &ahead, &self.path, self.pursuit.along, &config.obstacles);
        self.ahead = ahead;
        let stopped_by = self.stopped_by(&aim, &way, tilt_deg, config);
        if let Some(reason) = stopped_by {
            return self.wait_for_way(now, reason, config);
        }
        if self.state == DriveState::Blocked {
            self.enter(now, DriveState::Driving);
        }
        let command = self.command(&aim, &way, step, config);
        self.asked = command;
        if self.progress.is_stuck(now.stamp_ns, step, pose, command, &config.recovery) {
            return self.recover(now, GiveUp::Stuck, config);
        }
        command
    }

    /// What the robot must stop for, if it is to drive on.
    fn stopped_by(&mut self, aim: &Aim, way: &Way, tilt_deg: f64, config: &NavigationConfig) -> Option<GiveUp> {
        if !way.may_drop {
            self.falling = 0.0;
        } else if self.falling == 0.0 {
            (self.falling, self.tilt_before_deg) = (1e-6, tilt_deg);
        }
        // Turning on the spot it goes nowhere.
        aim.curvature?;
        // Whoever begins to lean over where the ground may fall away has a wheel at the edge.
        let leans_over = self.falling > 0.0 && tilt_deg > self.tilt_before_deg + EDGE_TILT_DEG;
        if self.falling > config.obstacles.drop_m || leans_over {
            return Some(GiveUp::Edge);
        }
        let gap_m = way.gap.max(0.0);
        (way.gap < config.obstacles.stop_gap_m + STOPPED_M).then_some(GiveUp::Blocked { gap_m })
    }

    /// Stands before an obstacle: near the target that is near enough, else it may go away, else back.
    fn wait_for_way(&mut self, now: &RobotNow, reason: GiveUp, config: &NavigationConfig) -> [f64; 2] {
        let to_goal = (self.path.goal() - place(&now.map_from_robot)).norm();
        if to_goal < config.follow.goal_tolerance_m + config.obstacles.stop_gap_m {
            self.enter(now, DriveState::Arrived);
            return [0.0; 2];
        }
        if self.state != DriveState::Blocked {
            self.enter(now, DriveState::Blocked);
        }
        self.progress.restart();
        let waited = self.since_ns.map_or(0.0, |since| seconds(since, now.stamp_ns));
        if waited > config.recovery.blocked_s {
            return self.recover(now, reason, config);
        }
        [0.0; 2]
    }

    /// Speeds by the aim, what is around, and what the drives can.
    fn command(&self, aim: &Aim, way: &Way, step: f64, config: &NavigationConfig) -> [f64; 2] {
        let follow = &config.follow;
        let Some(curvature) = aim.curvature else { return [0.0, aim.turn] };
        let obstacles = &config.obstacles;
        // The proximity heuristic (Macenski et al., equation 6), and braking before what is certainly there.
        let near = (way.gap.min(way.doubtful_gap) / obstacles.slow_gap_m).clamp(0.0, 1.0) * follow.max_speed;
        let braking = (follow.acceleration * (way.gap - obstacles.stop_gap_m).max(0.0)).sqrt();
        let careful = if way.is_short || self.falling > 0.0 { CAREFUL_SPEED } else { f64::INFINITY };
        let wanted = aim.linear.min(near.max(follow.min_speed)).min(braking.max(follow.min_speed)).min(careful);
        let linear = wanted.min(self.speed.max(0.0) + follow.acceleration * step.max(0.01));
        let angular = (linear * curvature).clamp(-follow.max_turn, follow.max_turn);
        [linear, angular]
    }

    pub(super) fn give_up(&mut self, now: &RobotNow, reason: GiveUp, config: &NavigationConfig) -> [f64; 2] {
        // What it backed up from is still there when it is given up for something else.
        self.obstruction = self.obstruction_by(now, &reason, config).or(self.retreat.held);
        self.enter(now, DriveState::GaveUp(reason));
        [0.0; 2]
    }

    pub(super) fn obstruction_by(
        &self,
        now: &RobotNow,
        reason: &GiveUp,
        config: &NavigationConfig,
    ) -> Option<Obstruction> {
        let contact = if self.lean.is_over_an_edge() {
            downhill(&now.map_from_robot, config.obstacles.half_length_m)
        } else {
            reason.contact(self.asked, &config.obstacles)?
        };
        let centre = (now.map_from_robot * contact).xy().coords.into();
        Some(Obstruction { centre, radius_m: config.recovery.obstruction_radius_m })
    }

    pub(super) fn enter(&mut self, now: &RobotNow, state: DriveState) {
        self.state = state;
        self.since_ns = Some(now.stamp_ns);
        self.progress.restart();
    }
}

pub(super) fn place(pose: &Pose) -> Vector2<f64> {
    Vector2::new(pose.translation.x, pose.translation.y)
}

pub(super) fn tilt(pose: &Pose) -> f64 {
    (pose.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos()
}

pub(super) fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}
