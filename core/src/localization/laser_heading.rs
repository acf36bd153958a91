//! How far the robot has turned over a piece of its way, by the level laser: walls tell it better than gyroscopes do, whose bias
//! wanders.
//!
//! The filter keeps the error of the heading at the piece's beginning beside that of the heading now (stochastic cloning:
//! S. Roumeliotis and J. Burdick, "Stochastic cloning: a generalized framework for processing relative state measurements",
//! ICRA 2002), so that a turn between the two is a measurement like any other.

use nalgebra::{UnitQuaternion, Vector3};

use super::config::LaserModel;
use super::laser_track::tilt;
use super::readings::SweepSample;
use super::sweep_matching::{ReferenceSweep, Turn};
use crate::geometry::{Pose, rotation_angle};

/// A piece ends when the robot has gone so far [m], or turned so far [rad], or after so long [s].
const PIECE_M: f64 = 1.5;
const PIECE_RAD: f64 = 0.6;
const PIECE_S: f64 = 10.0;
/// So much of it is a piece when the robot comes to a stand, too [m, rad].
const LEAST_M: f64 = 0.1;
const LEAST_RAD: f64 = 0.02;

/// Where a piece of the way began.
#[derive(Debug, Clone)]
struct Beginning {
    stamp_ns: i64,
    /// As it was taken for then; what has been learnt since about its heading is the filter's.
    map_from_robot: Pose,
    sweep: ReferenceSweep,
}

/// Compares sweeps at both ends of pieces of the way.
#[derive(Debug, Clone, Default)]
pub(super) struct LaserHeading {
    beginning: Option<Beginning>,
}

/// What a sweep is to the piece that the robot is on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PieceEnd {
    /// The piece goes on.
    Not,
    /// A piece ends here, and the sweeps do not tell how far the robot has turned.
    Untold,
    /// By so much more than the estimate has it.
    Told(Turn),
}

impl LaserHeading {
    /// The estimate has jumped: the next piece begins with the next sweep.
    pub fn forget(&mut self) {
        self.beginning = None;
    }

    /// Hears a sweep, taken where the estimate has the robot now. `heading_learnt` is what was learnt since the beginning about the
    /// heading there [rad].
    pub fn hear(
        &self,
        sweep: &SweepSample,
        map_from_robot: &Pose,
        heading_learnt: f64,
        stands: bool,
        config: &LaserModel,
    ) -> PieceEnd {
        let Some(beginning) = &self.beginning else { return PieceEnd::Untold };
        let mut then = beginning.map_from_robot;
        then.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_learnt) * then.rotation;
        let then_from_now = then.inverse() * map_from_robot;
        let (metres, radians) = (then_from_now.translation.vector.norm(), rotation_angle(&then_from_now));
        let seconds = sweep.stamp_ns.saturating_sub(beginning.stamp_ns) as f64 * 1e-9;
        let has_moved = metres > LEAST_M || radians > LEAST_RAD;
        let ends = metres > PIECE_M || radians > PIECE_RAD || (has_moved && (stands || seconds > PIECE_S));
        if !ends {
            return PieceEnd::Not;
        }
        let is_level = [map_from_robot, &then].iter().all(|pose| tilt(pose) < config.level_deg.to_radians());
        let turn = if is_level { beginning.sweep.turn(sweep, &then_from_now, config) } else { None };
        turn.map_or(PieceEnd::Untold, PieceEnd::Told)
    }

    /// Begins a piece here.
    pub fn begin(&mut self, sweep: &SweepSample, map_from_robot: &Pose) {
        let (stamp_ns, map_from_robot) = (sweep.stamp_ns, *map_from_robot);
        self.beginning = Some(Beginning { stamp_ns, map_from_robot, sweep: ReferenceSweep::new(sweep) });
    }
}
