//! Gauss-Newton on SE(3), damped as by Levenberg and Marquardt where the full step fails.

use super::linearisation::{chi2, linearise};
use super::sparse_solver::SparseSolver;
use super::structure::{OutOfMemory, SIZE, Structure};
use super::{Edge, PoseGraphConfig};
use crate::geometry::{Pose, Twist, exp};

/// The least damping that changes anything.
const LEAST_DAMPING: f64 = 1e-7;
/// With a damping beyond this a step is shorter than rounding.
const MOST_DAMPING: f64 = 1e12;
/// A decrease by less than this share is rounding.
const ROUNDING: f64 = 1e-13;

/// The part of a graph that is optimised.
pub(super) struct Problem<'a> {
    pub edges: &'a [Edge],
    pub poses: &'a mut [Pose],
    /// How much each edge counts.
    pub weights: &'a mut [f64],
}

/// The buffers of a part of a graph: nothing is allocated from one iteration to the next.
pub(super) struct Workspace {
    pub solver: SparseSolver,
    /// The edges of the part.
    pub edge_indices: Vec<usize>,
    trial: Vec<Pose>,
}

impl Workspace {
    /// Buffers for the edges named, whose pattern is `structure`.
    pub fn new(structure: Structure, edge_indices: Vec<usize>) -> Result<Self, OutOfMemory> {
        let trial = vec![Pose::identity(); structure.order.len()];
        Ok(Self { solver: SparseSolver::new(structure)?, edge_indices, trial })
    }
}

/// Where an optimisation stands.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Walk {
    pub iterations: u32,
    pub converged: bool,
    damping: f64,
}

impl Problem<'_> {
    /// The weighted sum of squares.
    pub fn cost(&self, workspace: &Workspace) -> f64 {
        workspace.edge_indices.iter().map(|edge| self.weights[*edge] * self.chi2(*edge)).sum()
    }

    /// e^T Omega e of an edge.
    pub fn chi2(&self, edge: usize) -> f64 {
        let edge = &self.edges[edge];
        chi2(edge, &self.poses[edge.from], &self.poses[edge.to])
    }

    /// Iterates until the steps are below the tolerances.
    pub fn minimise(&mut self, workspace: &mut Workspace, config: &PoseGraphConfig, walk: &mut Walk) {
        walk.converged = workspace.trial.is_empty();
        while !walk.converged && walk.iterations < config.max_iterations {
            self.step(workspace, config, walk);
        }
    }

    /// Takes one step downhill, if there is one.
    pub fn step(&mut self, workspace: &mut Workspace, config: &PoseGraphConfig, walk: &mut Walk) {
        let cost = self.linearise(workspace);
        walk.iterations += 1;
        loop {
            if workspace.solver.solve(walk.damping) {
                let (shift, turn) = largest(&workspace.solver.step);
                self.swap_in_trial(workspace);
                let trial = self.cost(workspace);
                if trial <= cost * (1.0 + ROUNDING) {
                    let small = shift < config.translation_tolerance_m && turn < config.rotation_tolerance;
                    walk.converged = small && walk.damping < 1e-2;
                    walk.damping = if walk.damping <= LEAST_DAMPING { 0.0 } else { 0.1 * walk.damping };
                    return;
                }
                self.swap_back(workspace);
            }
            walk.damping = (10.0 * walk.damping).max(LEAST_DAMPING);
            if walk.damping > MOST_DAMPING {
                // No step leads downhill any more.
                walk.converged = true;
                walk.damping = 0.0;
                return;
            }
        }
    }

    /// Builds the normal equations and returns the weighted sum of squares.
    pub(super) fn linearise(&self, workspace: &mut Workspace) -> f64 {
        let Workspace { solver, edge_indices, .. } = workspace;
        solver.clear();
        let mut cost = 0.0;
        for (position, index) in edge_indices.iter().enumerate() {
            let (edge, weight) = (&self.edges[*index], self.weights[*index]);
            if weight > 0.0 {
                let terms = linearise(edge, &self.poses[edge.from], &self.poses[edge.to], weight);
                cost += weight * terms.chi2;
                solver.add(position, (edge.from, edge.to), &terms);
            }
        }
        cost
    }

    /// Leaves the factor of the equations at the present poses in the workspace; `false` when they are singular.
    pub fn factorise_at_optimum(&self, workspace: &mut Workspace) -> bool {
        self.linearise(workspace);
        workspace.solver.factorise_exactly()
    }

    /// Moves the poses by the step; the former ones are kept in the workspace.
    fn swap_in_trial(&mut self, workspace: &mut Workspace) {
        let Workspace { solver, trial, .. } = workspace;
        for ((node, step), former) in solver.structure.order.iter().zip(solver.step.chunks_exact(SIZE)).zip(trial) {
            let pose = &mut self.poses[*node];
            *former = *pose;
            *pose *= exp(&Twist::from_column_slice(step));
            pose.rotation.renormalize();
        }
    }

    fn swap_back(&mut self, workspace: &mut Workspace) {
        let Workspace { solver, trial, .. } = workspace;
        solver.structure.order.iter().zip(trial).for_each(|(node, former)| self.poses[*node] = *former);
    }
}

/// The longest translation [m] and rotation [rad] of a step.
fn largest(step: &[f64]) -> (f64, f64) {
    let square = |part: &[f64]| part.iter().map(|value| value * value).sum::<f64>();
    let largest = step
        .chunks_exact(SIZE)
        .fold((0.0_f64, 0.0_f64), |(shift, turn), step| (shift.max(square(&step[..3])), turn.max(square(&step[3..]))));
    (largest.0.sqrt(), largest.1.sqrt())
}
