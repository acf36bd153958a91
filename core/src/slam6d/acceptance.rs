//! Whether an alignment is believed.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::geometry::{Pose, rotation_angle};
use crate::registration::coarse::Evidence;
use crate::registration::{Alignment, ConfigError, Limits};

/// What an alignment must show to be accepted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcceptanceConfig {
    /// The least share of the scan's points that must have a partner. The source counts on 0.1 between adjacent
    /// outdoor scans, but the ground alone gives more to scans that have nothing else in common. A scan flagged in vain
    /// still has its guess; a false alignment spoils the map.
    pub min_overlap: f64,
    /// Below this overlap the pose must also be consistent with what each scanner has seen of the other's surfaces, see
    /// `min_consistency`; 0 never asks. On the handheld scans every false alignment from starts 3 to 18 m wrong
    /// overlapped by less.
    pub verify_below_overlap: f64,
    /// The least consistency of a pose that overlaps little: of the points that the other scanner would have seen, the
    /// share that lie on surfaces it saw, less the share that stand where its rays have passed. On the handheld scans
    /// (84 true pairs up to 18 m apart, 28 false ones) true poses showed 0.61 and more, false ones 0.54 and less.
    pub min_consistency: f64,
    /// The greatest residual of the paired points, root mean square [m].
    pub max_residual_m: f64,
    /// With a prior: the least number of directions the geometry must constrain; the prior holds the others. A bare
    /// floor constrains three. Without a prior all six are needed, since nothing measured holds the others.
    pub min_constrained_directions: u32,
}

impl Default for AcceptanceConfig {
    fn default() -> Self {
        Self {
            min_overlap: 0.1,
            verify_below_overlap: 0.5,
            min_consistency: 0.55,
            max_residual_m: 0.25,
            min_constrained_directions: 3,
        }
    }
}

impl AcceptanceConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("acceptance.min_overlap", self.min_overlap, 0.0, 1.0)?;
        ConfigError::check("acceptance.verify_below_overlap", self.verify_below_overlap, 0.0, 1.0)?;
        ConfigError::check("acceptance.min_consistency", self.min_consistency, -1.0, 1.0)?;
        ConfigError::check("acceptance.max_residual_m", self.max_residual_m, 1e-3, 100.0)?;
        let directions = f64::from(self.min_constrained_directions);
        ConfigError::check("acceptance.min_constrained_directions", directions, 0.0, 6.0)
    }

    /// Judges the alignment that began at `start`.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn judge(
        &self,
        alignment: &Alignment,
        start: &Pose,
        limits: &Limits,
        has_prior: bool,
    ) -> Result<(), Rejection> {
        if alignment.limit_reached {
            let moved = start.inverse() * alignment.target_from_source;
            return Err(Rejection::TooFar {
                translation_m: moved.translation.vector.norm(),
                max_translation_m: limits.max_translation_m,
                rotation: rotation_angle(&moved),
                max_rotation: limits.max_rotation,
            });
        }
        if alignment.overlap < self.min_overlap {
            return Err(Rejection::NoOverlap { overlap: alignment.overlap, required: self.min_overlap });
        }
        if alignment.residual_rms_m > self.max_residual_m {
            return Err(Rejection::PoorFit { residual_m: alignment.residual_rms_m, allowed_m: self.max_residual_m });
        }
        let required = if has_prior { self.min_constrained_directions } else { 6 };
        let constrained = alignment.constraint.constrained_directions();
        if constrained < required {
            return Err(Rejection::Degenerate { constrained, required });
        }
        if alignment.converged { Ok(()) } else { Err(Rejection::NotConverged { iterations: alignment.iterations }) }
    }

    /// Whether an alignment that [`Self::judge`] accepts needs a second look.
    pub(super) fn is_doubtful(&self, alignment: &Alignment) -> bool {
        alignment.overlap < self.verify_below_overlap
    }

    /// Judges what each scan has seen of the other.
    ///
    /// # Errors
    /// [`Rejection::Inconsistent`].
    pub fn weigh(&self, evidence: &Evidence) -> Result<(), Rejection> {
        let (forward, backward) = (&evidence.forward, &evidence.backward);
        let explained = forward.explained().min(backward.explained());
        let contradicted = forward.contradiction().max(backward.contradiction());
        if explained - contradicted >= self.min_consistency {
            return Ok(());
        }
        Err(Rejection::Inconsistent { explained, contradicted, required: self.min_consistency })
    }
}

/// Why an alignment, or a whole scan, is not believed.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    /// Too few of the scan's points have a partner.
    #[error("overlap {overlap:.3} is below {required:.3}")]
    NoOverlap {
        /// The share found.
        overlap: f64,
        /// The share asked for.
        required: f64,
    },
    /// It overlaps little, and the scanners would have seen something else from there.
    #[error(
        "{explained:.3} of the points that the other scanner would have seen lie on its surfaces and {contradicted:.3} stand \
         where its rays have passed; the difference is below {required:.3}"
    )]
    Inconsistent {
        /// The share on surfaces, in the worse direction.
        explained: f64,
        /// The share in free space, in the worse direction.
        contradicted: f64,
        /// The difference asked for.
        required: f64,
    },
    /// The result lies on the border of the limits around the start.
    #[error(
        "the result wants to be farther from the start than allowed: {translation_m:.2} m of {max_translation_m:.2} m, \
         {rotation:.3} rad of {max_rotation:.3} rad"
    )]
    TooFar {
        /// Distance from the start [m].
        translation_m: f64,
        /// Distance allowed, d_max [m].
        max_translation_m: f64,
        /// Angle from the start [rad].
        rotation: f64,
        /// Angle allowed [rad].
        max_rotation: f64,
    },
    /// It overlaps little, and lies where the scan was surely not taken.
    #[error(
        "{sigmas:.1} standard deviations from where the prior has it, {allowed:.1} are allowed; overlap {overlap:.3} is too little to overrule it"
    )]
    ContradictsPrior {
        /// Distance between the pose found and the expected one, in standard deviations of both.
        sigmas: f64,
        /// Distance allowed.
        allowed: f64,
        /// The share of points with a partner.
        overlap: f64,
    },
    /// Registration has slid far along a direction that the scans hardly hold, in many steps.
    #[error("registration slid by {slid_m:.2} m along a direction that the scans hardly hold")]
    Slid {
        /// How far from where the prior has it, or from a confirmed place where it did not stay [m]; for rotations at the
        /// distance of the points.
        slid_m: f64,
    },
    /// Registration has taken many steps along a direction that the scans hardly hold, and ended near the prior all the same.
    #[error("registration took {iterations} steps along a direction that the scans hardly hold")]
    Unsure {
        /// Steps taken.
        iterations: u32,
    },
    /// The scan cannot be prepared: too little is left of it.
    #[error("the scan has {points} points after thinning; {required} are needed")]
    TooFewPoints {
        /// Points left.
        points: usize,
        /// Points needed.
        required: usize,
    },
    /// The paired points lie too far apart.
    #[error("residual {residual_m:.3} m is above {allowed_m:.3} m")]
    PoorFit {
        /// Root mean square found [m].
        residual_m: f64,
        /// Root mean square allowed [m].
        allowed_m: f64,
    },
    /// The steps had not become small when their number was used up.
    #[error("not converged after {iterations} iterations")]
    NotConverged {
        /// Steps taken.
        iterations: u32,
    },
    /// The geometry leaves too many directions of motion open.
    #[error("the geometry constrains {constrained} of 6 directions; {required} are needed")]
    Degenerate {
        /// Directions found constrained.
        constrained: u32,
        /// Directions needed.
        required: u32,
    },
    /// The frame fits the odometry's local map at none of the poses tried.
    #[error("lost: the scan fits the local map by {score:.3}; {required:.3} is needed ({searched} poses searched)")]
    Lost {
        /// Share of the points that fit, at best.
        score: f64,
        /// Share needed.
        required: f64,
        /// Poses the search has tried.
        searched: u32,
    },
    /// A lost frame does not see what a keyframe saw.
    #[error("not seen from the keyframe {distance_m:.1} m away: {reason}")]
    NotRelocalised {
        /// From the last known pose to the keyframe [m].
        distance_m: f64,
        /// What speaks against it.
        reason: String,
    },
    /// The method itself failed.
    #[error("{reason}")]
    Failed {
        /// Its own words.
        reason: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Covariance;
    use crate::registration::Constraint;

    fn good() -> Alignment {
        Alignment {
            target_from_source: Pose::identity(),
            covariance: Covariance::identity(),
            overlap: 0.8,
            overlap_distance_m: 0.3,
            residual_rms_m: 0.05,
            cost: 0.001,
            iterations: 9,
            converged: true,
            limit_reached: false,
            constraint: Constraint { eigenvalues: [0.0, 0.1, 0.1, 0.2, 0.3, 0.4], ..Constraint::none(0.01) },
        }
    }

    fn judge(alignment: &Alignment, has_prior: bool) -> Result<(), Rejection> {
        AcceptanceConfig::default().judge(alignment, &Pose::identity(), &Limits::default(), has_prior)
    }

    #[test]
    fn each_fault_is_named() {
        assert_eq!(judge(&good(), true), Ok(()));
        let faulty = [
            Alignment { overlap: 0.05, ..good() },
            Alignment { residual_rms_m: 0.5, ..good() },
            Alignment { converged: false, ..good() },
            Alignment { limit_reached: true, ..good() },
            Alignment { constraint: Constraint::none(0.01), ..good() },
        ];
        let [overlap, residual, steps, limit, open] = faulty.map(|alignment| judge(&alignment, true).unwrap_err());
        assert!(matches!(overlap, Rejection::NoOverlap { .. }) && overlap.to_string().contains("0.100"), "{overlap}");
        assert!(matches!(residual, Rejection::PoorFit { .. }), "{residual}");
        assert_eq!(steps, Rejection::NotConverged { iterations: 9 });
        assert!(matches!(limit, Rejection::TooFar { .. }), "{limit}");
        assert_eq!(open, Rejection::Degenerate { constrained: 0, required: 3 });
    }

    #[test]
    fn an_open_direction_needs_a_prior_to_hold_it() {
        assert_eq!(judge(&good(), false), Err(Rejection::Degenerate { constrained: 5, required: 6 }));
    }

    #[test]
    fn an_overlap_beyond_one_is_refused_by_name() {
        let config = AcceptanceConfig { min_overlap: 1.5, ..AcceptanceConfig::default() };
        assert_eq!(config.validate().unwrap_err().field, "acceptance.min_overlap");
    }
}
