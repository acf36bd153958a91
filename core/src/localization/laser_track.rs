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
/// So many pieces in a row must show a lag.
const LAGS: u32 = 2;

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
}

impl LaserTrack {
    /// Whether the wheels go elsewhere than the robot.
    pub fn is_slipping(&self) -> bool {
        self.lags >= LAGS
    }

    /// The estimate has jumped: what is told next begins here.
    pub fn forget(&mut self) {
        self.beginning = None;
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
        if !may_tell {
            self.lags = 0;
        }
        // Sweeps that do not fit say nothing, neither for a slip nor against it.
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
fn tilt(map_from_robot: &Pose) -> f64 {
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
