//! The loop shared by the iterative methods: pair, step, stay within the limits, keep the best of all iterates.

use nalgebra::UnitQuaternion;

use super::correspondences::{Matcher, PairSum};
use super::information::{ErrorModel, PlaneSystem};
use super::prepared::PreparedCloud;
use super::{AlignError, Alignment, Constraint, Limits, PreparedScan, RegistrationConfig};
use crate::geometry::{self, Pose, Twist};

/// Fewer pairs than this give no step.
const LEAST_PAIRS: u32 = 10;
/// The pair distance is halved when a step moves the points by less than this share of it.
const SETTLED_SHARE: f64 = 0.1;

/// What every method reports of one pass.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Evidence {
    /// Pairs within the pair distance of the pass.
    pub pairs: u32,
    /// Pairs within the overlap distance.
    pub overlapping: u32,
    /// Source points whose residual enters `cost_sum`; all others cost `unpaired_cost`.
    pub judged: u32,
    /// Sum of the truncated squared residuals [m^2].
    pub cost_sum: f64,
    /// Sum of the squared residuals of the pairs [m^2].
    pub residual_sq: f64,
    /// The distances to the tangent planes.
    pub plane: PlaneSystem,
}

impl Evidence {
    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.pairs += other.pairs;
        self.overlapping += other.overlapping;
        self.judged += other.judged;
        self.cost_sum += other.cost_sum;
        self.residual_sq += other.residual_sq;
        self.plane.merge(&other.plane);
    }
}

/// One way to get from pairs to a better pose.
pub(super) trait Minimiser {
    /// What it sums over the pairs.
    type Sum: PairSum;

    /// The settings of a pass at the pair distance `gate_m`; costs are judged at `final_gate_m` whatever the pass.
    fn settings(&self, config: &RegistrationConfig, gate_m: f64, final_gate_m: f64)
    -> <Self::Sum as PairSum>::Settings;

    /// The common part of the sum.
    fn evidence(sum: &Self::Sum) -> &Evidence;

    /// The motion to apply on the right, within the constrained directions; `None` when the pairs define none.
    fn step(&self, sum: &Self::Sum, constraint: &Constraint) -> Option<Twist>;

    /// What a source point without a partner costs [m^2].
    fn unpaired_cost(&self, config: &RegistrationConfig, final_gate_m: f64) -> f64;

    /// How the pairs' distances to the tangent planes err; `share` points have one error in common, and of all points
    /// the part `overlap` has a partner.
    fn errors(&self, sum: &Self::Sum, share: f64, overlap: f64) -> ErrorModel;
}

/// Two scans, a start and everything that bounds the way from there.
pub(super) struct Problem<'a> {
    pub target: &'a PreparedCloud,
    pub source: &'a PreparedCloud,
    pub start: &'a Pose,
    pub limits: &'a Limits,
    pub config: &'a RegistrationConfig,
}

impl<'a> Problem<'a> {
    /// Checks the question.
    pub fn new(
        method: &str,
        target: &'a dyn PreparedScan,
        source: &'a dyn PreparedScan,
        start: &'a Pose,
        limits: &'a Limits,
        config: &'a RegistrationConfig,
    ) -> Result<Self, AlignError> {
        limits.validate()?;
        if !geometry::rows_from_pose(start).iter().all(|v| v.is_finite()) {
            return Err(AlignError::StartNotFinite);
        }
        let own = |scan: &'a dyn PreparedScan, role| {
            scan.as_any()
                .downcast_ref::<PreparedCloud>()
                .ok_or_else(|| AlignError::ForeignScan { method: method.to_owned(), role })
        };
        Ok(Self { target: own(target, "target")?, source: own(source, "source")?, start, limits, config })
    }

    /// Iterates to the best pose.
    pub fn solve<M: Minimiser>(&self, method: &M, matcher: &mut Matcher<M::Sum>) -> Alignment {
        let threshold = self.config.constrained_eigenvalue;
        let mut walk = Walk::new(self);
        matcher.start(self.source);
        loop {
            let sum = self.pass(method, matcher, &walk.pose, walk.gate);
            walk.judge(self.cost(method, M::evidence(&sum)));
            if walk.settled || walk.iterations >= self.limits.max_iterations {
                break;
            }
            let constraint = M::evidence(&sum).plane.constraint(threshold);
            let enough = M::evidence(&sum).pairs >= LEAST_PAIRS;
            let Some(step) = enough.then(|| method.step(&sum, &constraint)).flatten() else { break };
            walk.advance(self, &step, constraint.length_m);
        }
        let sum = self.pass(method, matcher, &walk.best.pose, walk.final_gate);
        self.report(method, &walk, &sum)
    }

    /// One pass over the source's points.
    fn pass<M: Minimiser>(&self, method: &M, matcher: &mut Matcher<M::Sum>, pose: &Pose, gate: f64) -> M::Sum {
        let settings = method.settings(self.config, gate, self.final_gate());
        let within = gate.max(self.config.overlap_distance_m);
        matcher.sum(self.target, self.source, pose, within, self.config.threads, &settings)
    }

    fn final_gate(&self) -> f64 {
        self.config.final_pair_distance_m.min(self.limits.pair_distance_m)
    }

    /// The mean cost of a source point.
    fn cost<M: Minimiser>(&self, method: &M, evidence: &Evidence) -> f64 {
        let count = self.source.points().len() as f64;
        let unpaired = count - f64::from(evidence.judged);
        (evidence.cost_sum + unpaired * method.unpaired_cost(self.config, self.final_gate())) / count
    }

    /// The answer, from a pass over the best pose at the final pair distance.
    fn report<M: Minimiser>(&self, method: &M, walk: &Walk, sum: &M::Sum) -> Alignment {
        let evidence = M::evidence(sum);
        let config = self.config;
        let constraint = evidence.plane.constraint(config.constrained_eigenvalue);
        let overlap = f64::from(evidence.overlapping) / self.source.points().len() as f64;
        let errors = method.errors(sum, config.points_per_independent_error, overlap);
        Alignment {
            target_from_source: walk.best.pose,
            covariance: evidence.plane.covariance(&constraint, &errors, self.limits.pair_distance_m),
            overlap,
            overlap_distance_m: config.overlap_distance_m,
            residual_rms_m: (evidence.residual_sq / f64::from(evidence.pairs.max(1))).sqrt(),
            cost: walk.best.cost,
            iterations: walk.iterations,
            converged: walk.settled && !walk.limited && !walk.best.limited,
            limit_reached: walk.best.limited,
            constraint,
        }
    }
}

/// The best iterate so far.
struct Best {
    pose: Pose,
    cost: f64,
    limited: bool,
}

/// Where the iteration stands.
struct Walk {
    pose: Pose,
    limited: bool,
    gate: f64,
    final_gate: f64,
    iterations: u32,
    /// The last step was below the tolerances, at the final pair distance.
    settled: bool,
    best: Best,
}

impl Walk {
    fn new(problem: &Problem<'_>) -> Self {
        Self {
            pose: *problem.start,
            limited: false,
            gate: problem.limits.pair_distance_m,
            final_gate: problem.final_gate(),
            iterations: 0,
            settled: false,
            best: Best { pose: *problem.start, cost: f64::INFINITY, limited: false },
        }
    }

    /// Keeps the present pose when it is the best so far.
    fn judge(&mut self, cost: f64) {
        if cost < self.best.cost {
            self.best = Best { pose: self.pose, cost, limited: self.limited };
        }
    }

    /// Takes a step, stays within the limits, and narrows the pair distance once the steps are small against it.
    fn advance(&mut self, problem: &Problem<'_>, step: &Twist, length_m: f64) {
        let mut next = self.pose * geometry::exp(step);
        next.rotation.renormalize();
        let limited;
        (next, limited) = within_limits(&next, problem.start, problem.limits);
        let moved = self.pose.inverse() * next;
        let (shift, turn) = (moved.translation.vector.norm(), geometry::rotation_angle(&moved));
        (self.pose, self.limited) = (next, limited);
        self.iterations += 1;
        let config = problem.config;
        if self.gate <= self.final_gate {
            self.settled = shift < config.translation_tolerance_m && turn < config.rotation_tolerance;
        } else if shift + turn * length_m < SETTLED_SHARE * self.gate {
            self.gate = (0.5 * self.gate).max(self.final_gate);
        }
    }
}

/// The pose moved back onto the border of the limits around `start`, and whether it was on it or beyond.
fn within_limits(pose: &Pose, start: &Pose, limits: &Limits) -> (Pose, bool) {
    let mut moved = start.inverse() * pose;
    let shift = moved.translation.vector.norm();
    let turn = geometry::rotation_angle(&moved);
    // A pose once moved to the border may lie a rounding error inside it.
    const BORDER: f64 = 1.0 - 1e-9;
    if shift <= BORDER * limits.max_translation_m && turn <= BORDER * limits.max_rotation {
        return (*pose, false);
    }
    if shift > limits.max_translation_m {
        moved.translation.vector *= limits.max_translation_m / shift;
    }
    if turn > limits.max_rotation {
        let axis = moved.rotation.scaled_axis();
        moved.rotation = UnitQuaternion::from_scaled_axis(axis * (limits.max_rotation / turn));
    }
    (start * moved, true)
}
