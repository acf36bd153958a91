//! Whether a pose is trusted, and if not, why.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Evidence, TrustConfig};

/// A judged pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// What it was judged by.
    pub evidence: Evidence,
    /// The first reason not to trust it; `None` when it is trusted.
    pub doubt: Option<Doubt>,
}

/// Why a pose is not trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Error)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// Too few points lie on surfaces of the other scan.
    #[error("only {matched} points of a scan lie on surfaces of the other, {required} are needed")]
    TooFewMatches {
        /// In the worse direction.
        matched: u32,
        /// `trust.least_matched_points`.
        required: u32,
    },
    /// Points stand where the other scan's rays passed.
    #[error("{share:.3} of the comparable points stand in space that the other scan saw to be free, more than {most}")]
    Contradicted {
        /// In the worse direction.
        share: f64,
        /// `trust.most_contradicted`.
        most: f64,
    },
    /// Too small a share of the scans coincides.
    #[error("the scans overlap by {overlap:.3}, {required} is needed")]
    LittleOverlap {
        /// In the better direction.
        overlap: f64,
        /// `trust.least_overlap`.
        required: f64,
    },
    /// What coincides faces few directions, such as the ground alone.
    #[error("surfaces coincide with a score of {score:.3}, every direction counting alike; {required} is needed")]
    LittleStructure {
        /// [`Evidence::score`].
        score: f64,
        /// `trust.least_score`.
        required: f64,
    },
    /// Surfaces lie beside one another.
    #[error("matched points lie {residual_rms_m:.3} m from the surfaces, more than {most_m} m")]
    LargeResidual {
        /// Root mean square [m].
        residual_rms_m: f64,
        /// `trust.most_residual_m` [m].
        most_m: f64,
    },
    /// The pose may slide or turn without the surfaces parting.
    #[error("the matched surfaces leave the pose free in one direction: eigenvalue {least:.5}, {required} is needed")]
    Unconstrained {
        /// The least eigenvalue.
        least: f64,
        /// `trust.least_eigenvalue`.
        required: f64,
    },
    /// Another pose explains the scans nearly as well.
    #[error("another pose explains the scans nearly as well: ahead by {margin:.3}, {required} is needed")]
    Ambiguous {
        /// By how much of its own score the pose is better.
        margin: f64,
        /// `trust.least_margin`.
        required: f64,
    },
    /// No pose was found that could be judged.
    #[error("no pose was found under which the scans overlap")]
    NoHypothesis,
    /// The refinement failed or did not settle.
    #[error("the refinement failed: {reason}")]
    NotRefined {
        /// In its own words.
        reason: String,
    },
}

impl Verdict {
    /// Whether the pose is trusted.
    #[must_use]
    pub fn is_trusted(&self) -> bool {
        self.doubt.is_none()
    }

    /// Judges the evidence.
    #[must_use]
    pub fn of(evidence: Evidence, trust: &TrustConfig) -> Self {
        Self { doubt: doubt(&evidence, trust), evidence }
    }
}

/// The first reason to doubt.
fn doubt(evidence: &Evidence, trust: &TrustConfig) -> Option<Doubt> {
    let (forward, backward) = (&evidence.forward, &evidence.backward);
    let matched = forward.matched.min(backward.matched);
    if matched < trust.least_matched_points {
        return Some(Doubt::TooFewMatches { matched, required: trust.least_matched_points });
    }
    let share = forward.contradiction().max(backward.contradiction());
    if share > trust.most_contradicted {
        return Some(Doubt::Contradicted { share, most: trust.most_contradicted });
    }
    let overlap = forward.overlap().max(backward.overlap());
    if overlap < trust.least_overlap {
        return Some(Doubt::LittleOverlap { overlap, required: trust.least_overlap });
    }
    let score = evidence.score();
    if score < trust.least_score {
        return Some(Doubt::LittleStructure { score, required: trust.least_score });
    }
    if evidence.residual_rms_m > trust.most_residual_m {
        let residual_rms_m = evidence.residual_rms_m;
        return Some(Doubt::LargeResidual { residual_rms_m, most_m: trust.most_residual_m });
    }
    if evidence.least_eigenvalue < trust.least_eigenvalue {
        return Some(Doubt::Unconstrained { least: evidence.least_eigenvalue, required: trust.least_eigenvalue });
    }
    None
}
