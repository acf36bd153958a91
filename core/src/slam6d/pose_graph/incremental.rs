//! Optimisation of a growing graph: what is far from the new edges is left alone as long as it would hardly move.
//!
//! A node with its sequential edge costs constant time. Edges near the end are fitted by moving a window of the latest
//! nodes; it is doubled until the nodes in its earlier half move less than `window_tolerance_m`, so that what lies
//! before would move less still. A loop closure, or a window that would take in half the graph, means the whole graph.

use serde::{Deserialize, Serialize};

use super::levenberg::{Walk, Workspace};
use super::robust::OFF;
use super::structure::{OutOfMemory, Structure};
use super::{EdgeKind, Optimisation, OptimiseError, PoseGraph};
use crate::geometry::{Pose, rotation_angle};

/// New edges that fit to this sum of e^T Omega e ask for no optimisation.
const FITS: f64 = 1e-9;
/// Rotations count as the motion of a point so far away [m].
const ARM_M: f64 = 10.0;

/// What an update did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Update {
    /// The new edges fit as they are; no pose moved.
    Nothing,
    /// The latest nodes were moved, from `first_node` on; the sums are those of the edges that touch them.
    Window(Optimisation),
    /// The whole graph was optimised.
    Full(Optimisation),
}

impl Update {
    /// What the optimisation did, if there was one.
    #[must_use]
    pub fn optimisation(&self) -> Option<&Optimisation> {
        match self {
            Self::Nothing => None,
            Self::Window(optimisation) | Self::Full(optimisation) => Some(optimisation),
        }
    }
}

impl PoseGraph {
    /// Moves what the edges added since the last optimisation ask to be moved: nothing, the latest nodes, or all.
    ///
    /// # Errors
    /// [`OptimiseError`]; the poses are as before.
    pub fn update(&mut self) -> Result<Update, OptimiseError> {
        let new = self.first_new_edge..self.edges.len();
        let asking = new.clone().filter(|edge| self.edge_chi2(*edge).is_none_or(|chi2| chi2.is_nan() || chi2 > FITS));
        let Some(earliest) = asking.map(|edge| self.edges[edge].from.min(self.edges[edge].to)).min() else {
            // Edges that fit tell nothing about where the poses are, only about how well they are known.
            self.first_new_edge = new.end;
            return Ok(Update::Nothing);
        };
        let has_closure = self.edges[new].iter().any(|edge| edge.kind == EdgeKind::LoopClosure);
        let mut first = earliest.min(self.poses.len().saturating_sub(self.config.window_nodes));
        let mut before = Vec::new();
        while !has_closure && first > self.poses.len() / 2 {
            let grown = self.poses.len() - first - before.len();
            before.splice(..0, self.poses[first..first + grown].iter().copied());
            let optimisation = self.optimise_window(first)?;
            let earlier = ..before.len() / 2;
            let (shift, turn) = largest_motion(&before[earlier], &self.poses[first..]);
            if shift.max(turn * ARM_M) <= self.config.window_tolerance_m {
                return Ok(Update::Window(optimisation));
            }
            first = first.saturating_sub(before.len());
        }
        self.optimise().map(Update::Full)
    }

    /// Moves only the nodes from `first` on; all before are held. The sums of the report are those of the edges that
    /// touch a node from `first` on. Loop closures count as the last full optimisation decided.
    ///
    /// # Errors
    /// [`OptimiseError`]; the poses are as before.
    pub fn optimise_window(&mut self, first: usize) -> Result<Optimisation, OptimiseError> {
        let first = first.min(self.poses.len());
        let touching = self.edges_by_later.iter().skip(first).flatten().copied();
        let mut edges: Vec<usize> = touching.filter(|edge| self.weights[*edge] > OFF).collect();
        edges.sort_unstable();
        let mut workspace = self.window(first, &edges).map_err(|OutOfMemory| self.out_of_memory())?;
        let before = self.poses[first..].to_vec();
        let (config, mut problem) = (self.config, self.problem());
        let chi2_before = problem.cost(&workspace);
        if !chi2_before.is_finite() {
            return Err(OptimiseError::NotFinite { edges: edges.len() });
        }
        let mut walk = Walk::default();
        problem.minimise(&mut workspace, &config, &mut walk);
        let chi2 = problem.cost(&workspace);
        self.first_new_edge = self.edges.len();
        let (largest_translation_m, largest_rotation) = largest_motion(&before, &self.poses[first..]);
        Ok(Optimisation {
            chi2_before,
            chi2,
            iterations: walk.iterations,
            converged: walk.converged,
            switched_off: self.switched_off(),
            largest_translation_m,
            largest_rotation,
            first_node: first.max(1),
        })
    }

    /// The equations of the nodes from `first` on.
    fn window(&self, first: usize, edges: &[usize]) -> Result<Workspace, OutOfMemory> {
        let is_free: Vec<bool> =
            (0..self.poses.len()).map(|node| node >= first && self.components.first_of(node) != node).collect();
        let ends = edges.iter().map(|edge| (self.edges[*edge].from, self.edges[*edge].to));
        Workspace::new(Structure::new(ends, &is_free)?, edges.to_vec())
    }
}

/// How far the pose moved that moved farthest [m], and how much the one turned that turned most [rad].
pub(super) fn largest_motion(before: &[Pose], after: &[Pose]) -> (f64, f64) {
    before.iter().zip(after).fold((0.0, 0.0), |(shift, turn), (before, after)| {
        let moved = before.inverse() * after;
        (f64::max(shift, moved.translation.vector.norm()), f64::max(turn, rotation_angle(&moved)))
    })
}
