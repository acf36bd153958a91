//! Registration by a process of somebody else's: asked over shared memory, judged by ourselves, and replaced by a built-in
//! method whenever its answer is wrong, late or absent.
//!
//! The fallback method prepares the keyframes and judges every answer with 0 iterations: overlap, residual, cost and
//! which directions the geometry determines are ours. Pose, covariance, convergence and iterations are the answer's.

mod alone;
mod config;
mod fault;
mod link;
mod tally;
#[cfg(test)]
mod tests;

use mirador_core::geometry::{Covariance, Pose, pose_from_rows, rotation_angle};
use mirador_core::registration::{
    AlignError, Alignment, Constraint, Limits, PairIds, PrepareError, PreparedScan, Registration,
};
use mirador_core::scan::ScanView;
use mirador_core::slam6d::AcceptanceConfig;
use mirador_ipc_schema::messages::RegistrationResult;
use nalgebra::{Matrix6, Vector6};

pub use alone::ForeignRegistration;
pub use config::ExternalConfig;
pub use fault::FAULT_WORDS;
pub(crate) use link::Link;
pub(crate) use tally::Tally;

use crate::AlignmentConfig;
use fault::Fault;
use link::Question;

/// The name that asks for it: `registration = "external"`.
pub const NAME: &str = "external";

/// A cost above this multiple of another is worse than that: two methods do not agree to the last centimetre where the
/// best pose is,
const WORSE_BY: f64 = 4.0;
/// and this much more than that [m^2].
const WORSE_BY_AT_LEAST: f64 = 1e-4;
/// Steps of the built-in method from the pose of an answer: enough to see whether they lead somewhere else.
const STEPS_TO_SEE: u32 = 3;
/// Added to the variances: no registration knows a pose to less than a micrometre.
const LEAST_VARIANCE: f64 = 1e-12;

/// The method that asks another process.
pub(crate) struct External {
    fallback: Box<dyn Registration>,
    link: Link,
    tally: Tally,
    rules: Rules,
    pair: PairIds,
}

/// What an answer is judged by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules {
    /// Whether an alignment is believed.
    pub acceptance: AcceptanceConfig,
    /// The farthest partner of a point once the alignment has settled [m].
    pub final_pair_distance_m: f64,
}

impl Rules {
    /// Those of the service's settings.
    pub fn of(config: &AlignmentConfig) -> Self {
        Self { acceptance: config.sequential.acceptance, final_pair_distance_m: config.method.final_pair_distance_m }
    }
}

impl External {
    pub fn new(fallback: Box<dyn Registration>, link: Link, tally: Tally, rules: Rules) -> Self {
        Self { fallback, link, tally, rules, pair: PairIds::default() }
    }

    /// The alignment by an answer, or what is wrong with that.
    fn by_answer(&mut self, question: &Question<'_>) -> Result<Alignment, Fault> {
        let (fallback, mut at_start) = (&mut self.fallback, None);
        let judge = Limits { max_iterations: 0, ..*question.limits };
        let (target, source) = (question.target, question.source);
        // While the other process works.
        let meanwhile = || at_start = Some(fallback.align(target, source, question.start, &judge));
        let (answer, time) = self.link.ask(question, meanwhile)?;
        let pose = check(&answer, question)?;
        let refused = |e: AlignError| Fault::NotSent { reason: e.to_string() };
        let start_cost = at_start.transpose().map_err(refused)?.map_or(f64::INFINITY, |alignment| alignment.cost);
        let judged = self.fallback.align(target, source, &pose, &judge).map_err(refused)?;
        let cost = judged.cost;
        if cost > WORSE_BY * start_cost + WORSE_BY_AT_LEAST {
            return Err(Fault::WorseThanStart { cost, start_cost });
        }
        let pair_distance_m = self.rules.final_pair_distance_m.min(question.limits.pair_distance_m);
        let near = Limits { max_iterations: STEPS_TO_SEE, pair_distance_m, ..*question.limits };
        let better = self.fallback.align(target, source, &pose, &near).map_err(refused)?;
        if answer.converged == 1 && cost > WORSE_BY * better.cost + WORSE_BY_AT_LEAST {
            let (after, fallback) = (better.cost, self.fallback.name().to_owned());
            return Err(Fault::Unsettled { cost, after, steps: STEPS_TO_SEE, fallback });
        }
        let stated = Covariance::from_row_slice(&answer.covariance);
        let alignment = Alignment {
            covariance: with_open_directions(&stated, &judged.constraint, question.limits.pair_distance_m),
            iterations: answer.iterations,
            converged: answer.converged == 1,
            ..judged
        };
        let alignment = self.second_opinion(question, alignment)?;
        self.tally.answered(time);
        Ok(alignment)
    }

    /// An answer that will not be believed may be right: perhaps the scans do not fit. But when the built-in method finds
    /// what is believed, it was wrong.
    fn second_opinion(&mut self, question: &Question<'_>, answer: Alignment) -> Result<Alignment, Fault> {
        let judge =
            |alignment: &Alignment| self.rules.acceptance.judge(alignment, question.start, question.limits, true);
        let Err(why) = judge(&answer) else { return Ok(answer) };
        let own = self.fallback.align(question.target, question.source, question.start, question.limits);
        match own {
            Ok(own) if judge(&own).is_ok() => {
                Err(Fault::Missed { why: why.to_string(), fallback: self.fallback.name().to_owned() })
            }
            _ => Ok(answer),
        }
    }
}

impl Registration for External {
    fn name(&self) -> &str {
        NAME
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        self.fallback.prepare(scan)
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let start = initial_target_from_source;
        let makes_sense = limits.validate().is_ok() && start.to_homogeneous().iter().all(|v| v.is_finite());
        if limits.max_iterations == 0 || !makes_sense {
            return self.fallback.align(target, source, start, limits);
        }
        let header = self.tally.header_of(self.pair.source);
        let question = Question { target, source, start, limits, header, target_id: self.pair.target };
        let result = self.by_answer(&question);
        self.link.remember(result.as_ref().err());
        result.or_else(|fault| {
            let fallback = self.fallback.name();
            tracing::warn!(scan = header.scan(), fallback, "external registration: {fault}");
            self.tally.fell_back(&fault);
            self.fallback.align(target, source, start, limits)
        })
    }

    fn name_pair(&mut self, pair: PairIds) {
        self.pair = pair;
    }
}

/// The pose of an answer whose values hold together.
fn check(answer: &RegistrationResult, question: &Question<'_>) -> Result<Pose, Fault> {
    let not_finite = |what| Err(Fault::NotFinite { what });
    if answer.target_from_source.iter().any(|v| !v.is_finite()) {
        return not_finite("pose");
    }
    if answer.covariance.iter().any(|v| !v.is_finite()) {
        return not_finite("covariance");
    }
    if !(answer.overlap.is_finite() && answer.residual_m.is_finite()) {
        return not_finite("overlap or residual");
    }
    let pose = pose_from_rows(&answer.target_from_source).ok_or(Fault::NotRigid)?;
    if !is_covariance(&Covariance::from_row_slice(&answer.covariance)) {
        return Err(Fault::Covariance);
    }
    let moved = question.start.inverse() * pose;
    let (metres, radians) = (moved.translation.vector.norm(), rotation_angle(&moved));
    let (max_metres, max_radians) = (question.limits.max_translation_m, question.limits.max_rotation);
    if metres > max_metres || radians > max_radians {
        return Err(Fault::Outside { metres, radians, max_metres, max_radians });
    }
    Ok(pose)
}

/// Whether a matrix is symmetric, as far as rounding allows, and positive definite.
fn is_covariance(matrix: &Matrix6<f64>) -> bool {
    let scale = matrix.diagonal().map(|v| v.max(0.0).sqrt());
    let is_symmetric = (0..36).all(|i| {
        let (r, c) = (i / 6, i % 6);
        (matrix[(r, c)] - matrix[(c, r)]).abs() <= 1e-6 * scale[r] * scale[c]
    });
    is_symmetric && scale.iter().all(|s| *s < 1e6) && symmetric(matrix).cholesky().is_some()
}

fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// The covariance as it was stated, with at least the square of `unknown_m` along what the geometry leaves open.
fn with_open_directions(stated: &Covariance, constraint: &Constraint, unknown_m: f64) -> Covariance {
    let mut covariance = symmetric(stated) + Matrix6::identity() * LEAST_VARIANCE;
    let length_m = constraint.length_m;
    let scale = Vector6::new(1.0, 1.0, 1.0, length_m, length_m, length_m);
    for k in (0..6).filter(|k| !constraint.is_constrained(*k)) {
        let direction = constraint.directions.column(k).component_div(&scale);
        covariance += direction * direction.transpose() * (unknown_m * unknown_m);
    }
    covariance
}
