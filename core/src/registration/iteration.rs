//! The loop shared by all methods: pair, step, stay within the limits, keep the best of all iterates; first with few
//! points and a wide pair distance, then with all.

use nalgebra::UnitQuaternion;

use super::information::{ErrorModel, PlaneSystem};
use super::keyframe::PreparedCloud;
use super::pairs::{Detail, PairSum, Scans};
use super::{AlignError, Alignment, Constraint, Limits, Optimiser, PreparedScan, RegistrationConfig};
use crate::geometry::{self, Pose, Twist};

/// Fewer pairs than this give no step.
const LEAST_PAIRS: u32 = 10;
/// The pair distance is halved when a step moves the points by less than this share of it.
const SETTLED_SHARE: f64 = 0.1;
/// Sparse points are four voxels apart: partners nearer than this many voxels are rare by chance alone.
const SPARSE_GATE_VOXELS: f64 = 4.0;
/// The sparse points have done their part when a step moves the points by less than this many voxels.
const SPARSE_TOLERANCE_VOXELS: f64 = 0.02;
/// After so many steps without a lower cost, each below this share of the pair distance, pairs only change places.
const STALLED_STEPS: u32 = 6;
const STALLED_SHARE: f64 = 0.02;
/// A cost below this share of the start's, over the sparse points, is below the start's over all points, too.
const CLEARLY_BETTER: f64 = 0.7;

/// Classes of residuals, from which the next pass takes the greatest that counts.
const CLASSES: usize = 64;

/// What every method reports of one pass.
#[derive(Debug, Clone, Copy)]
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
    /// Pairs by the square root of their residual, as a share of the pair distance; only when some are trimmed.
    classes: [u32; CLASSES],
}

impl Default for Evidence {
    fn default() -> Self {
        let plane = PlaneSystem::default();
        let (cost_sum, residual_sq) = (0.0, 0.0);
        Self { pairs: 0, overlapping: 0, judged: 0, cost_sum, residual_sq, plane, classes: [0; CLASSES] }
    }
}

impl Evidence {
    /// Counts a pair of a squared residual [m^2] and tells whether it pulls, or is trimmed.
    #[inline(always)]
    pub fn takes(&mut self, gates: &Gates, residual_sq: f32) -> bool {
        self.pairs += 1;
        self.residual_sq += f64::from(residual_sq);
        if gates.trims {
            let share = (residual_sq / gates.pair_sq).sqrt().sqrt();
            self.classes[((share * CLASSES as f32) as usize).min(CLASSES - 1)] += 1;
        }
        residual_sq <= gates.trimmed_sq
    }

    /// The squared residual that the part `kept` of the pairs does not exceed [m^2].
    fn quantile_sq(&self, kept: f64, pair_m: f64) -> f32 {
        let wanted = kept * f64::from(self.pairs);
        let mut seen = 0.0;
        for (class, count) in self.classes.iter().enumerate() {
            seen += f64::from(*count);
            if seen >= wanted {
                let share = (class as f64 + 1.0) / CLASSES as f64;
                return (share * share * pair_m).powi(2) as f32;
            }
        }
        f32::INFINITY
    }

    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.pairs += other.pairs;
        self.overlapping += other.overlapping;
        self.judged += other.judged;
        self.cost_sum += other.cost_sum;
        self.residual_sq += other.residual_sq;
        self.plane.merge(&other.plane);
        for (own, others) in self.classes.iter_mut().zip(&other.classes) {
            *own += others;
        }
    }
}

/// The distances of a pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gates {
    /// The farthest partner [m].
    pub pair_m: f64,
    /// The farthest partner once the alignment has settled [m].
    pub final_m: f64,
    /// Squares [m^2]: of the farthest partner,
    pub pair_sq: f32,
    /// of the distance at which costs are judged, the same for all passes over the same points,
    pub judged_sq: f32,
    /// of the farthest partner that counts as overlap,
    pub overlap_sq: f32,
    /// and of the greatest residual that pulls.
    pub trimmed_sq: f32,
    /// Whether there will be one.
    pub trims: bool,
}

impl Gates {
    fn new(walk: &Walk, final_m: f64, config: &RegistrationConfig) -> Self {
        let square = |v: f64| (v * v) as f32;
        Self {
            pair_m: walk.gate,
            final_m,
            pair_sq: square(walk.gate),
            judged_sq: square(walk.final_gate),
            overlap_sq: square(config.overlap_distance_m),
            trimmed_sq: walk.trimmed_sq,
            trims: config.trimmed_overlap < 1.0,
        }
    }

    /// How much wider than at the end the pass is. While pairs may be far apart, so may residuals that are right.
    pub fn widening(&self) -> f64 {
        (self.pair_m / self.final_m).max(1.0)
    }
}

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
    start: &'a Pose,
    limits: &'a Limits,
    config: &'a RegistrationConfig,
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
        let mut sum = self.descend::<M>(Detail::Full, &mut walk, &mut rooms.own);
        if start_cost.is_some_and(|cost| cost < walk.best.cost) {
            walk.best = Best { pose: *self.start, cost: start_cost.unwrap_or_default(), limited: false };
        }
        if walk.best.pose != walk.pose {
            sum = self.pass::<M>(Detail::Full, &Walk::new(walk.best.pose, self.final_gate()), &mut rooms.own);
        }
        self.report::<M>(&walk, &sum)
    }

    /// Comes near with the sparse points and a shrinking pair distance.
    fn approach<A: Minimiser>(&self, sums: &mut Vec<A::Sum>) -> Walk {
        let voxel_m = self.config.preparation.voxel_m;
        let final_gate = (SPARSE_GATE_VOXELS * voxel_m).max(self.final_gate()).min(self.limits.pair_distance_m);
        let mut walk = Walk::new(*self.start, final_gate);
        walk.gate = self.limits.pair_distance_m;
        walk.tolerance_m = SPARSE_TOLERANCE_VOXELS * voxel_m;
        self.descend::<A>(Detail::Sparse, &mut walk, sums);
        walk
    }

    /// Steps until they are small, and returns the sum at the last pose.
    fn descend<M: Minimiser>(&self, detail: Detail, walk: &mut Walk, sums: &mut Vec<M::Sum>) -> M::Sum {
        loop {
            let sum = self.pass::<M>(detail, walk, sums);
            let improved = walk.judge(self.cost::<M>(detail, &sum, walk.final_gate));
            if walk.iterations >= self.limits.max_iterations {
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
    fn report<M: Minimiser>(&self, walk: &Walk, sum: &M::Sum) -> Alignment {
        let evidence = M::evidence(sum);
        let config = self.config;
        let constraint = evidence.plane.constraint(config.constrained_eigenvalue);
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

/// The best iterate so far.
#[derive(Debug, Clone, Copy)]
struct Best {
    pose: Pose,
    cost: f64,
    limited: bool,
}

/// Where the iteration stands.
#[derive(Debug, Clone, Copy)]
struct Walk {
    pose: Pose,
    limited: bool,
    gate: f64,
    final_gate: f64,
    /// A last step that moves the points by less than this is enough [m]; zero asks for the configuration's.
    tolerance_m: f64,
    iterations: u32,
    /// The last step was below the tolerances, at the final pair distance.
    settled: bool,
    damping: f64,
    /// Small steps in a row that did not lower the cost.
    stalled: u32,
    /// The greatest squared residual that pulls [m^2].
    trimmed_sq: f32,
    first_cost: f64,
    best: Best,
}

impl Walk {
    fn new(pose: Pose, gate: f64) -> Self {
        Self {
            pose,
            limited: false,
            gate,
            final_gate: gate,
            tolerance_m: 0.0,
            iterations: 0,
            settled: false,
            damping: 1e-3,
            stalled: 0,
            trimmed_sq: f32::INFINITY,
            first_cost: f64::INFINITY,
            best: Best { pose, cost: f64::INFINITY, limited: false },
        }
    }

    /// Goes on from the best pose with another pair distance.
    fn continued(&self, gate: f64) -> Self {
        let Best { pose, limited, .. } = self.best;
        Self { limited, iterations: self.iterations, ..Self::new(pose, gate) }
    }

    /// Keeps the present pose when it is the best so far, and tells whether it is.
    fn judge(&mut self, cost: f64) -> bool {
        if self.first_cost.is_infinite() {
            self.first_cost = cost;
        }
        let improved = cost < self.best.cost;
        if improved {
            self.best = Best { pose: self.pose, cost, limited: self.limited };
        }
        improved
    }

    /// The damping of the next step: a step that made things worse asks for a shorter one (Marquardt 1963).
    fn damping(&mut self, optimiser: Optimiser, improved: bool) -> f64 {
        match optimiser {
            Optimiser::GaussNewton => 0.0,
            Optimiser::LevenbergMarquardt => {
                self.damping = if improved { self.damping * 0.1 } else { self.damping * 10.0 }.clamp(1e-7, 1e3);
                self.damping
            }
        }
    }

    /// Takes a step, stays within the limits, and narrows the pair distance once the steps are small against it.
    /// `false` when the limits leave no way to go and the pair distance is final: then nothing was done.
    fn advance(&mut self, problem: &Problem<'_>, step: &Twist, length_m: f64) -> bool {
        let mut next = self.pose * geometry::exp(step);
        next.rotation.renormalize();
        let limited;
        (next, limited) = within_limits(&next, problem.start, problem.limits);
        let moved = self.pose.inverse() * next;
        let (shift, turn) = (moved.translation.vector.norm(), geometry::rotation_angle(&moved));
        let stuck = limited && shift + turn * length_m < problem.config.translation_tolerance_m;
        if stuck && self.gate <= self.final_gate {
            return false;
        }
        (self.pose, self.limited) = (next, limited);
        self.iterations += 1;
        if shift + turn * length_m < SETTLED_SHARE * self.gate {
            self.gate = (0.5 * self.gate).max(self.final_gate);
        }
        true
    }

    /// Whether small steps at the final pair distance have stopped to make things better.
    fn is_stalled(&mut self, improved: bool, step: &Twist, length_m: f64) -> bool {
        let moves_m = step.fixed_rows::<3>(0).norm() + step.fixed_rows::<3>(3).norm() * length_m;
        let in_place = self.gate <= self.final_gate && moves_m < STALLED_SHARE * self.gate;
        self.stalled = if improved || !in_place { 0 } else { self.stalled + 1 };
        self.stalled >= STALLED_STEPS
    }

    /// Whether a step at the final pair distance is below the tolerances.
    fn is_small(&self, step: &Twist, length_m: f64, config: &RegistrationConfig) -> bool {
        let (shift, turn) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
        if self.gate > self.final_gate {
            false
        } else if self.tolerance_m > 0.0 {
            shift + turn * length_m < self.tolerance_m
        } else {
            shift < config.translation_tolerance_m && turn < config.rotation_tolerance
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
