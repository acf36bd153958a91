//! From hypotheses to a pose that is trusted, or the reason why none is.

use serde::{Deserialize, Serialize};

use super::{CoarseAligner, CoarseAlignment, CoarseError, CoarseScan, Doubt, Evidence, SearchRange, Verdict};
use crate::geometry::Pose;
use crate::registration::{Alignment, Limits, PreparedScan, Registration};

/// Hypotheses that are refined and judged before giving up: the true pose is nearly always the first.
const TRIED: usize = 3;
/// How far refinement may go from a hypothesis; beyond that it has gone to another one.
const REFINEMENT: Limits =
    Limits { max_iterations: 60, pair_distance_m: 1.0, max_translation_m: 1.5, max_rotation: 0.2 };

/// A keyframe as a registration method and coarse alignment know it.
#[derive(Clone, Copy)]
pub struct Keyframe<'a> {
    /// As the registration method prepared it.
    pub prepared: &'a dyn PreparedScan,
    /// As [`CoarseAligner::prepare`] made it of the same points.
    pub coarse: &'a CoarseScan,
}

/// The answer to the question where the source's scanner stood, seen from the target's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Relocalisation {
    /// The pose, when it is trusted: it is the registration's, with covariance and constraint. Else the best that was
    /// found, for the record; `None` when nothing was.
    pub alignment: Option<Alignment>,
    /// Whether it is trusted, and if not, why.
    pub verdict: Verdict,
    /// By how much of its own score the pose beats the next best different one.
    pub margin: f64,
    /// Hypotheses that were refined and judged.
    pub tried: usize,
    /// How often the source's cubes were laid over the target's; 0 for a search by features.
    pub evaluations: usize,
}

impl Relocalisation {
    /// The pose `target_from_source`, if it is trusted.
    #[must_use]
    pub fn trusted(&self) -> Option<&Alignment> {
        self.alignment.as_ref().filter(|_| self.verdict.is_trusted())
    }
}

impl CoarseAligner {
    /// Searches about the initial pose, refines the best hypotheses with `registration` and returns the first that
    /// verification trusts; else the best one with the reason to doubt it.
    ///
    /// # Errors
    /// [`CoarseError`]: the range is no range or the pose not finite.
    pub fn relocalise(
        &mut self,
        registration: &mut dyn Registration,
        target: Keyframe<'_>,
        source: Keyframe<'_>,
        initial_target_from_source: &Pose,
        range: &SearchRange,
    ) -> Result<Relocalisation, CoarseError> {
        let found = self.align(target.coarse, source.coarse, initial_target_from_source, range)?;
        Ok(self.confirm(registration, target, source, &found))
    }

    /// Refines and judges hypotheses, however they were found.
    #[must_use]
    pub fn confirm(
        &self,
        registration: &mut dyn Registration,
        target: Keyframe<'_>,
        source: Keyframe<'_>,
        found: &CoarseAlignment,
    ) -> Relocalisation {
        let mut answer = Relocalisation {
            alignment: None,
            verdict: Verdict { evidence: Evidence::default(), doubt: Some(Doubt::NoHypothesis) },
            margin: 0.0,
            tried: 0,
            evaluations: found.evaluations,
        };
        for (k, hypothesis) in found.hypotheses.iter().enumerate().take(TRIED) {
            let start = &hypothesis.target_from_source;
            let refined = registration.align(target.prepared, source.prepared, start, &REFINEMENT);
            let (alignment, mut verdict) = match refined {
                Ok(alignment) => {
                    let verdict = self.verify(target.coarse, source.coarse, &alignment.target_from_source);
                    (Some(alignment), verdict)
                }
                Err(error) => {
                    let doubt = Some(Doubt::NotRefined { reason: error.to_string() });
                    (None, Verdict { evidence: hypothesis.evidence, doubt })
                }
            };
            let margin = found.margin_of(k, verdict.evidence.score());
            if verdict.is_trusted() {
                verdict.doubt = self.doubt_about(alignment.as_ref(), margin);
            }
            if verdict.is_trusted() || k == 0 {
                let trusted = verdict.is_trusted();
                answer = Relocalisation { alignment, verdict, margin, tried: k + 1, ..answer };
                if trusted {
                    return answer;
                }
            }
            answer.tried = k + 1;
        }
        answer
    }

    /// What the search and the refinement have against a pose that its evidence speaks for.
    fn doubt_about(&self, alignment: Option<&Alignment>, margin: f64) -> Option<Doubt> {
        let required = self.config().trust.least_margin;
        if margin < required {
            return Some(Doubt::Ambiguous { margin, required });
        }
        let reason = match alignment {
            Some(alignment) if alignment.limit_reached => "it ran away from the hypothesis".to_owned(),
            Some(alignment) if alignment.constraint.constrained_directions() < 6 => {
                "the geometry does not determine every direction".to_owned()
            }
            _ => return None,
        };
        Some(Doubt::NotRefined { reason })
    }
}
