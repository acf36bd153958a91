//! Whether the robot gets on, and the way it came.

use nalgebra::{Point3, Vector2, Vector3};

use super::config::RecoveryConfig;
use crate::geometry::Pose;

/// What must be asked of the robot before it can be called stuck [m, rad].
const ASKED_M: f64 = 0.1;
const ASKED_RAD: f64 = 0.3;
/// A radian of turning counts as this many metres.
const TURN_M: f64 = 0.5;
/// Distance of two places of the trail [m], and how many are kept.
const TRAIL_STEP_M: f64 = 0.1;
const TRAIL: usize = 200;

/// Compares what is asked of the robot with how it moves, over one time after the other.
#[derive(Debug, Clone, Default)]
pub(super) struct Progress {
    since_ns: Option<i64>,
    from: Option<Pose>,
    asked_m: f64,
    asked_rad: f64,
}

impl Progress {
    /// Begins anew.
    pub fn restart(&mut self) {
        *self = Self::default();
    }

    /// Whether the robot is stuck, after `step` [s] with a command.
    pub fn is_stuck(
        &mut self,
        now_ns: i64,
        step: f64,
        pose: &Pose,
        command: [f64; 2],
        config: &RecoveryConfig,
    ) -> bool {
        let since = *self.since_ns.get_or_insert(now_ns);
        let from = *self.from.get_or_insert(*pose);
        self.asked_m += step * command[0].abs();
        self.asked_rad += step * command[1].abs();
        if (now_ns.saturating_sub(since) as f64) * 1e-9 < config.stuck_s {
            return false;
        }
        let (asked_m, asked_rad) = (self.asked_m, self.asked_rad);
        self.restart();
        if asked_m < ASKED_M && asked_rad < ASKED_RAD {
            return false;
        }
        let off = from.inverse() * pose;
        let moved = off.translation.vector.norm() + TURN_M * off.rotation.angle();
        moved < config.stuck_share * (asked_m + TURN_M * asked_rad)
    }
}

/// Where the robot has been, newest last.
#[derive(Debug, Clone, Default)]
pub(super) struct Trail(Vec<Vector2<f64>>);

impl Trail {
    /// Notes where it is.
    pub fn note(&mut self, at: &Vector2<f64>) {
        if self.0.last().is_none_or(|last| (last - at).norm() > TRAIL_STEP_M) {
            if self.0.len() == TRAIL {
                self.0.remove(0);
            }
            self.0.push(*at);
        }
    }

    /// Curvature of the arc back to the way it came: the newest place more than 0.3 m behind [1/m]. Straight back where it
    /// has come from nowhere; what it passes is forgotten.
    pub fn back(&mut self, map_from_robot: &Pose) -> f64 {
        let height = map_from_robot.translation.z;
        let behind = |place: &Vector2<f64>| {
            let own = map_from_robot.inverse_transform_point(&Point3::new(place.x, place.y, height));
            Vector3::new(own.x, own.y, own.x.hypot(own.y))
        };
        while let Some(last) = self.0.last() {
            let own = behind(last);
            if own.x < -0.25 && own.z > 0.3 {
                return (2.0 * own.y / own.z.powi(2)).clamp(-1.0, 1.0);
            }
            self.0.pop();
        }
        0.0
    }
}
