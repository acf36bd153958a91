//! Why a target is given up, and what the map learns from it.

use nalgebra::Point3;

use super::config::ObstacleConfig;
use super::path::PathError;
use super::watch::SensorFault;

/// How far before the robot's front the ground that falls away is taken to begin [m]: about where its rangers look.
const EDGE_M: f64 = 0.3;

/// Why a target is given up.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum GiveUp {
    /// The path is none.
    #[error("{0}")]
    NoPath(PathError),
    /// Something stands in the way and does not go away.
    #[error("blocked: an obstacle {gap_m:.2} m in front")]
    Blocked {
        /// Free way in front of the robot [m].
        gap_m: f64,
    },
    /// The ground falls away in front.
    #[error("blocked: the ground falls away in front")]
    Edge,
    /// The wheels turn, but the robot does not get on.
    #[error("stuck: the wheels turn, but the robot does not get on")]
    Stuck,
    /// It is too far from its path.
    #[error("off the path by {off_m:.2} m")]
    OffPath {
        /// Distance from the path [m].
        off_m: f64,
    },
    /// It leans so far that it may tip over.
    #[error("in danger of tipping: it leans by {tilt_deg:.0} deg")]
    Tilted {
        /// Between its z axis and up [deg].
        tilt_deg: f64,
    },
    /// Localisation does not know where the robot is.
    #[error("localisation is lost")]
    Lost,
    /// It takes far too long.
    #[error("not there after {seconds:.0} s")]
    Timeout {
        /// Time on this path [s].
        seconds: f64,
    },
    /// A sensor stays away.
    #[error("{0}")]
    Sensor(SensorFault),
}

impl GiveUp {
    /// Where, in the robot's frame, something held a robot of which these speeds were asked; `None` when it was not the place
    /// that was to blame.
    pub(super) fn contact(&self, [linear, angular]: [f64; 2], body: &ObstacleConfig) -> Option<Point3<f64>> {
        let front = |beyond: f64, side: f64| Some(Point3::new(body.half_length_m + beyond, side, 0.0));
        match self {
            Self::Blocked { gap_m } => front(*gap_m, 0.0),
            Self::Edge => front(EDGE_M, 0.0),
            // Turning on the spot it hits with a front corner.
            Self::Stuck if linear == 0.0 => front(0.0, body.half_width_m.copysign(angular)),
            Self::Stuck | Self::Tilted { .. } => front(0.0, 0.0),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_held_the_robot_lies_where_it_touched_or_saw_it() {
        let body = ObstacleConfig::default();
        let at = |why: GiveUp, asked| why.contact(asked, &body).map(|p| [p.x, p.y]);
        assert_eq!(at(GiveUp::Blocked { gap_m: 0.2 }, [0.3, 0.0]), Some([body.half_length_m + 0.2, 0.0]));
        assert_eq!(at(GiveUp::Stuck, [0.3, 0.2]), Some([body.half_length_m, 0.0]));
        assert_eq!(at(GiveUp::Stuck, [0.0, -0.4]), Some([body.half_length_m, -body.half_width_m]));
        assert!(at(GiveUp::Edge, [0.1, 0.0]).unwrap()[0] > body.half_length_m);
        assert_eq!(at(GiveUp::Lost, [0.3, 0.0]), None);
        assert_eq!(at(GiveUp::OffPath { off_m: 0.7 }, [0.3, 0.0]), None);
    }
}
