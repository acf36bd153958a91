//! The loop shared by all methods: pair, step, stay within the limits, keep the best of all iterates; first with few
//! points and a wide pair distance, then with all.

use super::evidence::{Evidence, Gates};
use super::information::ErrorModel;
use super::keyframe::PreparedCloud;
use super::pairs::{Detail, PairSum, Scans};
use super::walk::{Best, Walk};
use super::{AlignError, Alignment, Constraint, Limits, PreparedScan, RegistrationConfig, RobustKernel};
use crate::geometry::{self, Pose, Twist};

/// Fewer pairs than this give no step.
const LEAST_PAIRS: u32 = 10;
/// Sparse points are four voxels apart: partners nearer than this many voxels are rare by chance alone.
const SPARSE_GATE_VOXELS: f64 = 4.0;
/// The sparse points have done their part when a step moves the points by less than this many voxels.
const SPARSE_TOLERANCE_VOXELS: f64 = 0.02;
/// With fewer sparse points than this, in a room for example, all points go all the way.
const LEAST_SPARSE_POINTS: usize = 500;
/// The robust scale of the last steps, in medians of the residuals: 1.35 standard deviations of normal errors. It is never
/// below this share of the configuration's, however exact the scans.
const SCALE_MEDIANS: f64 = 2.0;
const LEAST_SCALE_SHARE: f64 = 0.05;
/// A scale that falls by less than this is the same.
const SAME_SCALE: f64 = 0.95;
/// Before those, steps that move the points by less than this end the way [m].
const UNPOLISHED_M: f64 = 2e-3;
/// They end with steps that move the points by less than this share of the scale.
const POLISHED_SHARE: f64 = 0.02;
/// Farther than this share of the robust scale the last steps have gone somewhere else.
const FAR_FOR_POLISHING: f64 = 0.1;
/// Most steps with a scale of the scans' own.
const MOST_POLISHING: u32 = 20;
/// A cost below this share of the start's, over the sparse points, is below the start's over all points, too.
const CLEARLY_BETTER: f64 = 0.7;

/// One way to get from pairs to a better pose.
pub(super) trait Minimiser {
    /// What it sums over the pairs.
    type Sum: PairSum;
    /// What brings a distant start near, over the sparse points.
    type Approach: Minimiser;
    /// The method's name.
    const NAME: &'static str;
    /// The share of the tolerances below which a step is small: less than 1 where small steps go on for long.
    const TOLERANCE_SHARE: f64 = 1.0;
    /// Whether the weight of a pair depends on a robust scale.
    const IS_ROBUST: bool = true;

    /// The settings of a pass.
    fn settings(config: &RegistrationConfig, gates: &Gates) -> <Self::Sum as PairSum>::Settings;

    /// The common part of the sum.
    fn evidence(sum: &Self::Sum) -> &Evidence;

    /// Turns the sums from the target's axes to the source's.
    fn finish(sum: &mut Self::Sum, target_from_source: &Pose);

    /// The motion to apply on the right, within the constrained directions, with the damping of Levenberg and
    /// Marquardt; `None` when the pairs define none.
    fn step(sum: &Self::Sum, target_from_source: &Pose, constraint: &Constraint, damping: f64) -> Option<Twist>;

    /// What a source point without a partner costs [m^2].
    fn unpaired_cost(config: &RegistrationConfig, final_gate_m: f64) -> f64;

    /// How the pairs' distances to the tangent planes err; `share` points have one error in common, and of all points
    /// the part `overlap` has a partner.
    fn errors(sum: &Self::Sum, share: f64, overlap: f64) -> ErrorModel;
}

/// Two scans, a start and everything that bounds the way from there.
pub(super) struct Problem<'a> {
    scans: Scans<'a>,
    pub(super) start: &'a Pose,
    pub(super) limits: &'a Limits,
    pub(super) config: &'a RegistrationConfig,
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
        let scans = Scans { target: own(target, "target")?, source: own(source, "source")? };
        Ok(Self { scans, start, limits, config })
    }

    /// Iterates to the best pose.
    pub fn solve<M: Minimiser>(&self, rooms: &mut Rooms<M>) -> Alignment {
        let mut walk = Walk::new(*self.start, self.final_gate());
        let from_afar = self.limits.pair_distance_m > self.final_gate() && self.limits.max_iterations > 0;
        let mut start_cost = None;
        if from_afar {
            let approach = self.approach::<M::Approach>(&mut rooms.approach);
            let full = Walk::new(*self.start, self.final_gate());
            if approach.best.cost > CLEARLY_BETTER * approach.first_cost {
                let sum = self.pass::<M>(Detail::Full, &full, &mut rooms.own);
                start_cost = Some(self.cost::<M>(Detail::Full, &sum, self.final_gate()));
            }
            walk = approach.continued(self.final_gate());
        }
        if self.polishes::<M>() {
            walk.tolerance_m = UNPOLISHED_M;
        }
        let mut sum = self.descend::<M>(Detail::Full, &mut walk, &mut rooms.own);
        if start_cost.is_some_and(|cost| cost < walk.best.cost) {
            walk.best = Best { pose: *self.start, cost: start_cost.unwrap_or_default(), limited: false };
        }
        if walk.best.pose != walk.pose {
            sum = self.pass::<M>(Detail::Full, &Walk::new(walk.best.pose, self.final_gate()), &mut rooms.own);
        }
        // Which directions the scans hold is told by all pairs that may be right, before the scale leaves only the best.
        let constraint = M::evidence(&sum).plane.constraint(self.config.constrained_eigenvalue);
        if self.polishes::<M>() && !walk.best.limited {
            let coarse = walk.best;
            self.polish::<M>(&mut walk, &constraint, &mut sum, &mut rooms.own);
            // It is for the last millimetres: what went farther by the finer scale must not be worse than the start by the one told.
            let moved = coarse.pose.inverse() * walk.best.pose;
            let moved_m = moved.translation.vector.norm() + geometry::rotation_angle(&moved) * constraint.length_m;
            let is_far = moved_m > FAR_FOR_POLISHING * self.config.robust_scale_m;
            if is_far && start_cost.is_some_and(|cost| cost < walk.best.cost) {
                (walk.best, walk.pose, walk.limited) = (coarse, coarse.pose, coarse.limited);
                sum = self.pass::<M>(Detail::Full, &Walk::new(coarse.pose, self.final_gate()), &mut rooms.own);
            }
        }
        self.report::<M>(&walk, &sum, constraint)
    }

    /// Comes near with the sparse points and a shrinking pair distance.
    fn approach<A: Minimiser>(&self, sums: &mut Vec<A::Sum>) -> Walk {
        let voxel_m = self.config.preparation.voxel_m;
        let final_gate = (SPARSE_GATE_VOXELS * voxel_m).max(self.final_gate()).min(self.limits.pair_distance_m);
        let mut walk = Walk::new(*self.start, final_gate);
        walk.gate = self.limits.pair_distance_m;
        walk.tolerance_m = SPARSE_TOLERANCE_VOXELS * voxel_m;
        // Half of the steps are left for the last few millimetres.
        walk.most_iterations = self.limits.max_iterations.div_ceil(2);
        let sparse = self.scans.count(Detail::Sparse).min(self.scans.target.sparse().1.len());
        let detail = if sparse < LEAST_SPARSE_POINTS { Detail::Full } else { Detail::Sparse };
        self.descend::<A>(detail, &mut walk, sums);
        walk
    }

    /// Steps until they are small, and returns the sum at the last pose.
    fn descend<M: Minimiser>(&self, detail: Detail, walk: &mut Walk, sums: &mut Vec<M::Sum>) -> M::Sum {
        loop {
            let sum = self.pass::<M>(detail, walk, sums);
            let improved = walk.judge(self.cost::<M>(detail, &sum, walk.final_gate));
            if walk.iterations >= walk.most_iterations.min(self.limits.max_iterations) {
                return sum;
            }
            let constraint = M::evidence(&sum).plane.constraint(self.config.constrained_eigenvalue);
            let damping = walk.damping(self.config.optimiser, improved);
            if self.config.trimmed_overlap < 1.0 {
                walk.trimmed_sq = M::evidence(&sum).quantile_sq(self.config.trimmed_overlap, walk.gate);
            }
            let enough = M::evidence(&sum).pairs >= LEAST_PAIRS;
            let step = enough.then(|| M::step(&sum, &walk.pose, &constraint, damping)).flatten();
            let Some(step) = step else { return sum };
            if walk.is_small(&(step / M::TOLERANCE_SHARE), constraint.length_m, self.config)
                || walk.is_stalled(improved, &step, constraint.length_m)
            {
                // Not taken: the pose it would lead to is as good, and this one has been judged.
                walk.settled = true;
                return sum;
            }
            if !walk.advance(self, &step, constraint.length_m) {
                return sum;
            }
        }
    }

    /// The last steps, from the best pose, with a robust scale that follows how far the pairs err: what brings a distant start
    /// near gives pairs that are wrong by a decimetre a say in the last millimetres (the scale from the median of the
    /// residuals: Huber 1981, section 7.7). Ends where the steps are small; costs stay those of the configuration's scale.
    fn polish<M: Minimiser>(&self, walk: &mut Walk, constraint: &Constraint, sum: &mut M::Sum, sums: &mut Vec<M::Sum>) {
        let mut fine = walk.continued(self.final_gate());
        fine.trimmed_sq = walk.trimmed_sq;
        if !self.narrow_scale(&mut fine, M::evidence(sum)) {
            return;
        }
        *sum = self.pass::<M>(Detail::Full, &fine, sums);
        for _ in 0..MOST_POLISHING.min(self.limits.max_iterations.saturating_sub(fine.iterations)) {
            let evidence = M::evidence(sum);
            let step = M::step(sum, &fine.pose, constraint, 0.0).filter(|_| evidence.pairs >= LEAST_PAIRS);
            let is_narrower = self.narrow_scale(&mut fine, evidence);
            let Some(step) = step else { break };
            if !is_narrower && fine.is_small(&step, constraint.length_m, self.config) {
                break;
            }
            if !fine.advance(self, &step, constraint.length_m) {
                break;
            }
            *sum = self.pass::<M>(Detail::Full, &fine, sums);
        }
        let cost = self.cost::<M>(Detail::Full, sum, self.final_gate());
        (walk.pose, walk.iterations, walk.limited) = (fine.pose, fine.iterations, fine.limited);
        walk.best = Best { pose: fine.pose, cost, limited: fine.limited };
    }

    /// Lets the robust scale fall to what the residuals tell; whether it has.
    fn narrow_scale(&self, fine: &mut Walk, evidence: &Evidence) -> bool {
        let median_m = f64::from(evidence.quantile_sq(0.5, fine.gate)).sqrt();
        let own_m = (SCALE_MEDIANS * median_m).max(LEAST_SCALE_SHARE * self.config.robust_scale_m);
        let is_narrower = own_m < SAME_SCALE * fine.scale_m.unwrap_or(self.config.robust_scale_m);
        if is_narrower {
            fine.scale_m = Some(own_m);
            fine.tolerance_m = (POLISHED_SHARE * own_m).max(self.config.translation_tolerance_m);
        }
        is_narrower
    }

    /// Whether the last steps are taken with a scale of the scans' own.
    fn polishes<M: Minimiser>(&self) -> bool {
        M::IS_ROBUST && self.config.robust_kernel != RobustKernel::None
    }

    /// One pass over the source's points.
    fn pass<M: Minimiser>(&self, detail: Detail, walk: &Walk, sums: &mut Vec<M::Sum>) -> M::Sum {
        let gates = Gates::new(walk, self.final_gate(), self.config);
        let settings = M::settings(self.config, &gates);
        let within = walk.gate.max(self.config.overlap_distance_m);
        let mut sum = self.scans.sum(detail, &walk.pose, within, self.config.threads, &settings, sums);
        M::finish(&mut sum, &walk.pose);
        sum
    }

    fn final_gate(&self) -> f64 {
        self.config.final_pair_distance_m.min(self.limits.pair_distance_m)
    }

    /// The mean cost of a source point.
    fn cost<M: Minimiser>(&self, detail: Detail, sum: &M::Sum, final_gate: f64) -> f64 {
        let (evidence, count) = (M::evidence(sum), self.scans.count(detail) as f64);
        let unpaired = count - f64::from(evidence.judged);
        (evidence.cost_sum + unpaired * M::unpaired_cost(self.config, final_gate)) / count
    }

    /// The answer, from a pass over the best pose at the final pair distance.
    fn report<M: Minimiser>(&self, walk: &Walk, sum: &M::Sum, constraint: Constraint) -> Alignment {
        let evidence = M::evidence(sum);
        let config = self.config;
        let overlap = f64::from(evidence.overlapping) / self.scans.count(Detail::Full) as f64;
        let errors = M::errors(sum, config.points_per_independent_error, overlap);
        Alignment {
            target_from_source: walk.best.pose,
            covariance: evidence.plane.covariance(&constraint, &errors, self.limits.pair_distance_m),
            overlap,
            overlap_distance_m: config.overlap_distance_m,
            residual_rms_m: (evidence.residual_sq / f64::from(evidence.pairs.max(1))).sqrt(),
            cost: walk.best.cost,
            iterations: walk.iterations,
            converged: walk.settled && !walk.limited && !walk.best.limited,
            limit_reached: walk.limited || walk.best.limited,
            constraint,
        }
    }
}

/// Room for the sums of the blocks, kept between alignments.
pub(super) struct Rooms<M: Minimiser> {
    own: Vec<M::Sum>,
    approach: Vec<<M::Approach as Minimiser>::Sum>,
}

impl<M: Minimiser> Default for Rooms<M> {
    fn default() -> Self {
        Self { own: Vec::new(), approach: Vec::new() }
    }
}
