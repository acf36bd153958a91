//! What a robot does that gets no further, or cannot turn where it stands: it backs up the way it came. From an edge it goes so far
//! that it can turn where it then stands, for the next path may begin with a turn, and a robot that turns swings its corners and
//! slides.

use nalgebra::Point3;

use super::config::NavigationConfig;
use super::drive::{DriveState, RobotNow};
use super::driver::{Driver, place, seconds, tilt};
use super::give_up::GiveUp;
use super::obstacles::Surroundings;
use crate::information_map::Obstruction;

/// From an edge it goes back until it leans by less than this, so far at least and at most [deg, m].
const LEVEL_DEG: f64 = 10.0;
const EDGE_BACK_M: [f64; 2] = [1.0, 2.5];
/// So near to where its path goes on it goes on [m].
const NEARLY_BACK_M: f64 = 0.4;
/// A robot that leans by so much more than when it began to back up, and by so much in all, is held or lifted from behind: by a
/// bank it backs up, a branch that its mast had slipped under [deg].
const LIFTED_MORE_DEG: f64 = 8.0;
const LIFTED_DEG: f64 = 10.0;
/// Turning back from an edge [rad/s].
const TURN_BACK_SPEED: f64 = 0.4;

/// How a robot that gets no further gets away, and what has come of it on this path.
#[derive(Debug, Clone, Default)]
pub(super) struct Retreat {
    pub attempts: u32,
    /// How far it is to back up, and still has to [m].
    whole_m: f64,
    left_m: f64,
    /// How far it leant when it began to [deg].
    began_deg: f64,
    /// It gets away from an edge; after that the target is given up.
    pub leaves_edge: bool,
    /// It gets away forwards: its tail hangs over an edge.
    goes_ahead: bool,
    /// Nothing holds it: it is on its way back to where its path begins.
    begins_path: bool,
    /// Its path began behind it.
    pub began_path: bool,
    /// Where something held it when it last backed up.
    pub held: Option<Obstruction>,
}

impl Driver {
    /// Begins a path that leads back before anything else: the robot cannot turn where it stands, and backs up the way it came.
    pub(super) fn begin_backwards(&mut self, now: &RobotNow) {
        let Some((place, metres)) = self.path.leads_back(&now.map_from_robot) else { return };
        if metres > EDGE_BACK_M[1] + NEARLY_BACK_M || !self.trail.passes(&place) {
            return;
        }
        (self.retreat.whole_m, self.retreat.left_m, self.retreat.begins_path) = (metres, metres, true);
        self.retreat.began_path = true;
        self.retreat.began_deg = tilt(&now.map_from_robot).to_degrees();
        self.enter(now, DriveState::Recovering);
    }

    /// Gets back from what holds the robot, or gives the target up.
    pub(super) fn recover(&mut self, now: &RobotNow, reason: GiveUp, config: &NavigationConfig) -> [f64; 2] {
        // At an edge it must not stay, however often it has backed up.
        let is_over = self.lean.is_over_an_edge();
        let is_last = self.retreat.attempts >= config.recovery.attempts;
        self.retreat.leaves_edge |= is_over || (is_last && reason == GiveUp::Edge);
        if is_last && !self.retreat.leaves_edge {
            return self.give_up(now, reason, config);
        }
        self.retreat.attempts += 1;
        self.retreat.held = self.obstruction_by(now, &reason, config).or(self.retreat.held);
        self.retreat.goes_ahead = self.lean.straight_away() == Some(1.0);
        let follows_trail =
            self.retreat.leaves_edge && !self.retreat.goes_ahead && self.trail.leads_back(&now.map_from_robot);
        self.retreat.whole_m = if follows_trail { EDGE_BACK_M[1] } else { config.recovery.back_up_m };
        self.retreat.left_m = self.retreat.whole_m;
        self.retreat.began_deg = tilt(&now.map_from_robot).to_degrees();
        self.enter(now, DriveState::Recovering);
        [0.0; 2]
    }

    /// One step back.
    pub(super) fn back_up(
        &mut self,
        now: &RobotNow,
        step: f64,
        around: &Surroundings,
        config: &NavigationConfig,
    ) -> [f64; 2] {
        let recovery = &config.recovery;
        if let Some(way) = self.lean.way_back(&now.map_from_robot) {
            self.since_ns = Some(now.stamp_ns);
            return [0.0, way * TURN_BACK_SPEED.min(config.follow.max_turn)];
        }
        self.retreat.left_m -= step * now.linear.abs();
        let waited = self.since_ns.map_or(0.0, |since| seconds(since, now.stamp_ns));
        let is_late = waited > 3.0 * self.retreat.whole_m / recovery.back_up_speed + 1.0;
        let tilt_deg = tilt(&now.map_from_robot).to_degrees();
        let is_level = self.retreat.leaves_edge && self.backed_m() > EDGE_BACK_M[0] && tilt_deg < LEVEL_DEG;
        let is_lifted = tilt_deg > LIFTED_DEG && tilt_deg > self.retreat.began_deg + LIFTED_MORE_DEG;
        if is_lifted && !self.retreat.goes_ahead && !self.retreat.leaves_edge {
            self.undo_backing(now, config);
            return [0.0; 2];
        }
        let is_blocked = self.escape_gap(now, around, config) < config.obstacles.stop_gap_m;
        if self.retreat.left_m <= 0.0 || is_level || is_late || is_blocked || is_lifted {
            self.end_of_the_way_back(now, config);
            return [0.0; 2];
        }
        if self.retreat.goes_ahead {
            return [recovery.back_up_speed, 0.0];
        }
        let linear = -recovery.back_up_speed;
        [linear, linear * self.trail.back(&now.map_from_robot)]
    }

    /// How far it has backed up.
    fn backed_m(&self) -> f64 {
        self.retreat.whole_m - self.retreat.left_m
    }

    /// Goes forwards again to where it began to back up, and backs up no more on this path.
    fn undo_backing(&mut self, now: &RobotNow, config: &NavigationConfig) {
        let backed_m = self.backed_m();
        (self.retreat.whole_m, self.retreat.left_m) = (backed_m, backed_m);
        self.retreat.attempts = self.retreat.attempts.max(config.recovery.attempts);
        (self.retreat.goes_ahead, self.retreat.begins_path) = (true, false);
        self.retreat.began_deg = tilt(&now.map_from_robot).to_degrees();
        self.enter(now, DriveState::Recovering);
    }

    fn end_of_the_way_back(&mut self, now: &RobotNow, config: &NavigationConfig) {
        if std::mem::take(&mut self.retreat.begins_path) {
            // One that is stopped earlier turns where it is, after all.
            if self.retreat.left_m < NEARLY_BACK_M {
                self.pursuit.begin_at(self.path.along_of(1));
            }
            self.enter(now, DriveState::Driving);
            return;
        }
        // What it has come back over is before it again.
        self.pursuit.go_back(config.recovery.back_up_m);
        self.falling = 0.0;
        if self.retreat.leaves_edge {
            // The path leads along the edge; the map learns where that is.
            self.obstruction = self.retreat.held;
            self.enter(now, DriveState::GaveUp(GiveUp::Edge));
        } else {
            self.enter(now, DriveState::Driving);
        }
    }

    /// Free way where it gets away to [m].
    fn escape_gap(&self, now: &RobotNow, around: &Surroundings, config: &NavigationConfig) -> f64 {
        if !self.retreat.goes_ahead {
            return around.gap_behind(now.stamp_ns, &config.obstacles);
        }
        let pose = &now.map_from_robot;
        let ahead = (pose * Point3::new(config.obstacles.slow_gap_m, 0.0, 0.0)).coords.xy();
        around.way(now.stamp_ns, pose, &[place(pose), ahead], &self.path, self.pursuit.along, &config.obstacles).gap
    }
}
