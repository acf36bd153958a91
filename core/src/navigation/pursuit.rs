//! Regulated pure pursuit (S. Macenski et al., "Regulated pure pursuit for robot path tracking", Autonomous Robots 47,
//! 2023) for a robot that turns on the spot.
//!
//! The robot drives along the arc to a point of the path some way ahead (its equation 1), more slowly in tight curves
//! (its equation 5), on slopes and before the goal. Where the path bends sharply the arc would cut the corner, so the point
//! stays on the line of the piece before, and at the bend the robot turns on the spot.

use nalgebra::{Point3, Vector2, Vector3};

use super::config::FollowConfig;
use super::path::Path;
use crate::geometry::Pose;

/// A bend is reached within this distance along the path [m].
const AT_BEND_M: f64 = 0.05;
/// Turning speed for each radian of wrong heading [1/s], and the slowest one [rad/s].
const TURN_GAIN: f64 = 1.5;
const SLOWEST_TURN: f64 = 0.12;

/// How the path is to be driven now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Aim {
    /// Forward speed [m/s].
    pub linear: f64,
    /// Curvature of the arc, or nothing when turning on the spot [1/m].
    pub curvature: Option<f64>,
    /// Turning speed on the spot [rad/s].
    pub turn: f64,
    /// Whether the end is reached.
    pub arrived: bool,
}

/// Where along its path the robot is.
#[derive(Debug, Clone)]
pub(super) struct Pursuit {
    pub along: f64,
    pub off: f64,
    /// The last sharp bend that was passed: nothing before it counts any more.
    floor: f64,
    is_turning: bool,
}

impl Pursuit {
    pub fn new() -> Self {
        Self { along: 0.0, off: 0.0, floor: 0.0, is_turning: false }
    }

    /// The robot is so far along the path, and nothing before that counts.
    pub fn begin_at(&mut self, along: f64) {
        (self.along, self.floor) = (along + 1e-6, along + 1e-6);
    }

    /// The robot has gone back.
    pub fn go_back(&mut self, metres: f64) {
        self.along = (self.along - metres).max(0.0);
        self.floor = self.floor.min(self.along);
    }

    /// The next sharp bend, or the end.
    fn stop_ahead(&self, path: &Path, config: &FollowConfig) -> (usize, bool) {
        let sharp = config.turn_in_place_deg.to_radians();
        let last = path.waypoint_after(f64::INFINITY);
        let first = path.waypoint_after(self.along);
        let bend = (first..last).find(|waypoint| path.bend(*waypoint) > sharp);
        bend.map_or((last, true), |waypoint| (waypoint, false))
    }

    /// How to drive from a pose at a speed.
    pub fn aim(&mut self, path: &Path, map_from_robot: &Pose, speed: f64, config: &FollowConfig) -> Aim {
        let at = Vector2::new(map_from_robot.translation.x, map_from_robot.translation.y);
        let (mut stop, mut is_end) = self.stop_ahead(path, config);
        // Not beyond the bend, where the piece behind it may be nearer; nor far back.
        let from = (self.along - 0.3).max(self.floor);
        let nearest = path.project(&at, from, (self.along + 1.5).min(path.along_of(stop)));
        (self.along, self.off) = (nearest.along, nearest.off);
        if !is_end && path.along_of(stop) - self.along < AT_BEND_M {
            self.along = path.along_of(stop) + 1e-6;
            self.floor = self.along;
            (stop, is_end) = self.stop_ahead(path, config);
        }
        let left = path.along_of(stop) - self.along;
        let [near, far] = config.lookahead_m;
        let lookahead = (config.lookahead_s * speed).clamp(near, far);
        let target = path.place(self.along + lookahead, stop);
        let height = map_from_robot.translation.z;
        let own = map_from_robot.inverse_transform_point(&Point3::new(target.x, target.y, height));
        let off = own.y.atan2(own.x);
        let limit = if self.is_turning { config.turned_deg } else { config.turn_in_place_deg }.to_radians();
        let to_goal = (path.goal() - at).norm();
        let arrived = is_end && (left < 0.02 || to_goal < 0.4 * config.goal_tolerance_m);
        self.is_turning = !arrived && off.abs() > limit;
        if self.is_turning {
            let turn = (TURN_GAIN * off.abs()).clamp(SLOWEST_TURN, config.max_turn) * off.signum();
            return Aim { linear: 0.0, curvature: None, turn, arrived: false };
        }
        let curvature = 2.0 * own.y / (own.x.powi(2) + own.y.powi(2)).max(1e-6);
        let linear = regulated(curvature, left, map_from_robot, config);
        Aim { linear: if arrived { 0.0 } else { linear }, curvature: Some(curvature), turn: 0.0, arrived }
    }

    /// The pieces of the path ahead that the robot will sweep, from where it is [m, map frame].
    pub fn ahead(&self, path: &Path, at: &Vector2<f64>, reach: f64, out: &mut Vec<Vector2<f64>>) {
        out.clear();
        out.push(*at);
        let last = path.waypoint_after(f64::INFINITY);
        let until = self.along + reach;
        let begin = (self.along + 0.3).min(path.length());
        out.push(path.place(begin, last));
        let first = path.waypoint_after(begin);
        out.extend(
            (first..=last).take_while(|k| path.along_of(*k) < until).map(|k| path.place(path.along_of(k), last)),
        );
        if until < path.length() {
            out.push(path.place(until, last));
        }
    }
}

/// Forward speed by curvature, slope, and the way left to the next stop.
fn regulated(curvature: f64, left: f64, map_from_robot: &Pose, config: &FollowConfig) -> f64 {
    let by_curvature = (1.0 / (curvature.abs() * config.slow_radius_m).max(1e-9)).min(1.0);
    let tilt = (map_from_robot.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos();
    let by_slope = 1.0 / (1.0 + (tilt / config.slow_tilt_deg.to_radians()).powi(2));
    // Half of the braking that is allowed, so that there is some to spare.
    let by_stop = (config.acceleration * left.max(0.0)).sqrt();
    (config.max_speed * by_curvature * by_slope).min(by_stop).max(config.min_speed)
}
