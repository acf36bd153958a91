//! Whether the robot gets on, and the way it came.

use nalgebra::{Point3, Vector2};

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

/// Where the robot has been, newest last, and how it stands.
#[derive(Debug, Clone, Default)]
pub(super) struct Trail {
    places: Vec<Vector2<f64>>,
    stands: Option<Pose>,
}

impl Trail {
    /// Notes where it is.
    pub fn note(&mut self, at: &Vector2<f64>) {
        if self.places.last().is_none_or(|last| (last - at).norm() > TRAIL_STEP_M) {
            if self.places.len() == TRAIL {
                self.places.remove(0);
            }
            self.places.push(*at);
        }
    }

    /// How the robot stands now, whether or not it is on its way.
    pub fn stand(&mut self, map_from_robot: &Pose) {
        self.stands = Some(*map_from_robot);
    }

    /// The robot has stood still since, but is taken to stand here: alignment has found where. The trail moves along.
    pub fn carry_on(&mut self, map_from_robot: &Pose) {
        if let Some(before) = self.stands {
            self.move_by(&(map_from_robot * before.inverse()));
        }
    }

    /// The map has moved.
    pub fn move_by(&mut self, new_from_old: &Pose) {
        let height = self.stands.map_or(0.0, |pose| pose.translation.z);
        for place in &mut self.places {
            *place = (new_from_old * Point3::new(place.x, place.y, height)).coords.xy();
        }
        self.stands = self.stands.map(|pose| new_from_old * pose);
    }

    /// Whether it has been at a place, within half a metre.
    pub fn passes(&self, place: &Vector2<f64>) -> bool {
        self.places.iter().any(|been| (been - place).norm() < 0.5)
    }

    /// Whether it leads away behind the robot.
    pub fn leads_back(&self, map_from_robot: &Pose) -> bool {
        self.places.iter().rev().map(|place| own(place, map_from_robot)).any(|own| is_behind(&own))
    }

    /// Curvature of the arc back to the way it came: the newest place more than 0.3 m behind [1/m]. Straight back where it
    /// has come from nowhere; what it passes is forgotten.
    pub fn back(&mut self, map_from_robot: &Pose) -> f64 {
        while let Some(last) = self.places.last() {
            let own = own(last, map_from_robot);
            if is_behind(&own) {
                return (2.0 * own.y / own.norm_squared()).clamp(-1.0, 1.0);
            }
            self.places.pop();
        }
        0.0
    }
}

/// A place in the robot's frame.
fn own(place: &Vector2<f64>, map_from_robot: &Pose) -> Vector2<f64> {
    let height = map_from_robot.translation.z;
    map_from_robot.inverse_transform_point(&Point3::new(place.x, place.y, height)).coords.xy()
}

fn is_behind(own: &Vector2<f64>) -> bool {
    own.x < -0.25 && own.norm() > 0.3
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn along_x(metres: f64) -> Trail {
        let mut trail = Trail::default();
        (0..=(metres / 0.2) as u32).for_each(|k| trail.note(&Vector2::new(0.2 * f64::from(k), 0.0)));
        trail
    }

    #[test]
    fn the_way_back_is_that_which_the_robot_came() {
        let mut trail = along_x(4.0);
        let at = Pose::translation(4.0, 0.0, 1.0);
        assert!(trail.leads_back(&at) && trail.back(&at).abs() < 1e-9);
        // Beside the trail, on its left, backing up steers to the right: the arc's centre lies there.
        let beside = Pose::translation(3.0, 0.2, 1.0);
        assert!(trail.back(&beside) < -0.3);
        let mut other = along_x(4.0);
        let turned = Pose::new(Vector3::new(4.0, 0.0, 1.0), Vector3::new(0.0, 0.0, std::f64::consts::PI));
        assert!(!other.leads_back(&turned) && other.back(&turned) == 0.0 && other.places.is_empty());
    }

    #[test]
    fn the_trail_moves_with_the_map_and_with_where_the_robot_is_found() {
        let turn = Pose::new(Vector3::new(0.5, -0.3, 0.0), Vector3::new(0.0, 0.0, 0.02));
        let mut trail = along_x(4.0);
        trail.stand(&Pose::translation(4.0, 0.0, 0.0));
        let found = turn * Pose::translation(4.0, 0.0, 0.0);
        trail.carry_on(&found);
        assert!(trail.leads_back(&found) && trail.back(&found).abs() < 1e-9);
        trail.move_by(&turn);
        assert!(trail.back(&(turn * found)).abs() < 1e-9);
        assert!((trail.places[0] - Vector2::new(1.0 + 0.3 * 0.02, -0.6 + 0.5 * 0.02)).norm() < 0.01);
    }
}
