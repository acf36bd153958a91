//! Whether the wheels turn and the robot stands: the level laser sees it over one short piece of the way after the other.

use nalgebra::Vector3;

use super::config::LaserModel;
use super::readings::SweepSample;
use super::sweep_matching::{ReferenceSweep, Shift};
use crate::geometry::{Pose, rotation_angle};

/// A piece ends when the wheels have gone so far [m], or the robot has turned so far [rad], or after so long [s]; it lasts at
/// least so long, and a longer one was a gap [s].
const PIECE_M: f64 = 0.08;
const PIECE_RAD: f64 = 0.1;
const PIECE_S: f64 = 0.5;
const SHORTEST_S: f64 = 0.15;
const LONGEST_S: f64 = 1.0;
/// A lag shorter than this does not count [m].
const LEAST_LAG_M: f64 = 0.03;
/// So many pieces in a row must show a lag, and after so many that show nothing the wheels are believed again.
const LAGS: u32 = 2;
const UNTOLD: u32 = 4;

/// The wheels turn, but the robot does not go with them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slip {
    /// So far it is from where the estimate has it [m], map frame.
    pub shift: Vector3<f64>,
    /// So it moves [m/s], map frame.
    pub velocity: Vector3<f64>,
}

/// Where a piece of the way began.
#[derive(Debug, Clone)]
struct Beginning {
    stamp_ns: i64,
    map_from_robot: Pose,
    sweep: ReferenceSweep,
    /// What the wheels have gone since [m], forwards positive.
    wheels_m: f64,
}

/// Compares sweeps over pieces of the way.
#[derive(Debug, Clone, Default)]
pub(super) struct LaserTrack {
    beginning: Option<Beginning>,
    /// Pieces in a row over which the robot has lagged behind, and by how much over the first.
    lags: u32,
    first_shift: Vector3<f64>,
    /// Pieces in a row over which the sweeps did not fit.
    untold: u32,
}

impl LaserTrack {
    /// Whether the wheels go elsewhere than the robot.
    pub fn is_slipping(&self) -> bool {
        self.lags >= LAGS
    }

    /// The estimate has jumped: what is told next begins here.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// What the wheels have gone [m].
    pub fn wheels(&mut self, metres: f64) {
        if let Some(beginning) = &mut self.beginning {
            beginning.wheels_m += metres;
        }
    }

    /// Hears a sweep, taken where the estimate has the robot now.
    pub fn hear(&mut self, sweep: &SweepSample, map_from_robot: &Pose, config: &LaserModel) -> Option<Slip> {
        let Some(beginning) = &self.beginning else {
            self.begin(sweep, map_from_robot);
            return None;
        };
        let seconds = sweep.stamp_ns.saturating_sub(beginning.stamp_ns) as f64 * 1e-9;
        let then_from_now = beginning.map_from_robot.inverse() * map_from_robot;
        let is_long =
            beginning.wheels_m.abs() >= PIECE_M || rotation_angle(&then_from_now) >= PIECE_RAD || seconds >= PIECE_S;
        if seconds < SHORTEST_S || !is_long {
            return None;
        }
        let is_level = tilt(map_from_robot).max(tilt(&beginning.map_from_robot)) < config.level_deg.to_radians();
        let may_tell = is_level && seconds <= LONGEST_S;
        let shift = if may_tell { beginning.sweep.shift(sweep, &then_from_now, config) } else { None };
        let seen = shift.map(|shift| {
            let lags = lags(beginning, &then_from_now, &shift, config);
            let shift = Vector3::new(shift.metres.x, shift.metres.y, 0.0);
            let way = then_from_now.translation.vector + shift;
            let in_map = |v: Vector3<f64>| beginning.map_from_robot.rotation * v;
            let velocity = in_map(Vector3::new(way.x, way.y, 0.0)) / seconds;
            lags.then(|| Slip { shift: in_map(shift), velocity })
        });
        // Sweeps that do not fit say nothing, neither for a slip nor against it; not for ever.
        self.untold = if seen.is_some() { 0 } else { self.untold.saturating_add(1) };
        if !may_tell || self.untold >= UNTOLD {
            self.lags = 0;
        }
        let told = seen.and_then(|slip| self.believe(slip));
        let mut here = *map_from_robot;
        here.translation.vector += told.map_or_else(Vector3::zeros, |slip| slip.shift);
        self.begin(sweep, &here);
        told
    }

    /// One piece may err: what the first of several has shown counts with the second.
    fn believe(&mut self, slip: Option<Slip>) -> Option<Slip> {
        let Some(mut slip) = slip else {
            self.lags = 0;
            return None;
        };
        self.lags = self.lags.saturating_add(1);
        match self.lags {
            1 => {
                self.first_shift = slip.shift;
                return None;
            }
            LAGS => slip.shift += self.first_shift,
            _ => {}
        }
        Some(slip)
    }

    fn begin(&mut self, sweep: &SweepSample, map_from_robot: &Pose) {
        let (stamp_ns, map_from_robot) = (sweep.stamp_ns, *map_from_robot);
        let sweep = ReferenceSweep::new(sweep);
        self.beginning = Some(Beginning { stamp_ns, map_from_robot, sweep, wheels_m: 0.0 });
    }
}

/// Between the robot's z axis and up [rad].
pub(super) fn tilt(map_from_robot: &Pose) -> f64 {
    (map_from_robot.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos()
}

/// Whether the robot lags behind its wheels by more than their slip on good ground.
fn lags(beginning: &Beginning, then_from_now: &Pose, shift: &Shift, config: &LaserModel) -> bool {
    let claimed = beginning.wheels_m;
    let gone = (then_from_now.translation.vector.x + shift.metres.x) * claimed.signum();
    let doubt = 3.0 * shift.covariance[(0, 0)].max(0.0).sqrt();
    let behind = claimed.abs() - gone;
    behind > LEAST_LAG_M + doubt && behind > config.slip_share * claimed.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall across the way, seen from this far, or nothing at all.
    fn sweep(seconds: f64, wall: Option<f64>) -> SweepSample {
        let (first_angle, angle_step) = (-1.2, 0.01);
        let range =
            |beam: usize| wall.map_or(f32::NAN, |x| (x / (first_angle + angle_step * beam as f64).cos()) as f32);
        // Something to the left, too, that tells how far it is aside.
        let side = |beam: usize| (2.0 / (first_angle + angle_step * beam as f64).sin()) as f32;
        let seen = |beam: usize| if wall.is_some() && beam > 200 { range(beam).min(side(beam)) } else { range(beam) };
        let stamp_ns = (seconds * 1e9) as i64;
        SweepSample {
            stamp_ns,
            first_angle,
            angle_step,
            mount_xyz: [0.5, 0.0, 0.4],
            mount_yaw: 0.0,
            ranges: (0..240).map(seen).collect(),
        }
    }

    /// Hears a sweep every 0.4 s, over which the wheels have gone 0.12 m and the estimate with them.
    fn hear(track: &mut LaserTrack, k: u32, wall: Option<f64>) -> Option<Slip> {
        track.wheels(0.12);
        let at = Pose::translation(0.12 * f64::from(k), 0.0, 0.0);
        track.hear(&sweep(0.4 * f64::from(k), wall), &at, &LaserModel::default())
    }

    #[test]
    fn two_pieces_without_motion_are_a_slip_and_motion_ends_it() {
        let mut track = LaserTrack::default();
        assert_eq!((0..2).filter_map(|k| hear(&mut track, k, Some(3.0))).count(), 0, "one piece may err");
        let slip = hear(&mut track, 2, Some(3.0)).unwrap();
        assert!(track.is_slipping() && slip.velocity.norm() < 0.02, "{slip:?}");
        assert!((slip.shift.x + 0.24).abs() < 0.02, "both pieces are taken back: {slip:?}");
        // From where it was put back it goes on with its wheels.
        let at = Pose::translation(0.12, 0.0, 0.0);
        track.wheels(0.12);
        assert_eq!(track.hear(&sweep(1.2, Some(2.88)), &at, &LaserModel::default()), None);
        assert!(!track.is_slipping());
    }

    #[test]
    fn a_slip_is_forgotten_when_the_estimate_jumps_and_when_the_laser_has_seen_nothing_for_a_while() {
        let slipping = || {
            let mut track = LaserTrack::default();
            for k in 0..3 {
                hear(&mut track, k, Some(3.0));
            }
            assert!(track.is_slipping());
            track
        };
        let mut track = slipping();
        track.forget();
        assert!(!track.is_slipping());
        let mut track = slipping();
        assert_eq!(hear(&mut track, 3, None), None);
        assert!(track.is_slipping(), "one sweep of nothing says nothing");
        for k in 4..8 {
            hear(&mut track, k, None);
        }
        assert!(!track.is_slipping());
    }
}
