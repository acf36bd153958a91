//! How well the pose of one node is known as seen from another.

use thiserror::Error;

use super::{Edge, PoseGraph};
use crate::geometry::{Covariance, Pose, adjoint};
use nalgebra::Matrix6;

/// A direction with this variance [m^2] or [rad^2] is not measured: rounding alone keeps it from being infinite.
const OPEN: f64 = 1e8;

/// Why a covariance cannot be given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum CovarianceError {
    /// The node is not in the graph.
    #[error("node {node} is not in the graph, which has {nodes} nodes")]
    UnknownNode {
        /// The node named.
        node: usize,
        /// The nodes there are.
        nodes: usize,
    },
    /// No chain of edges joins the two nodes.
    #[error("no chain of edges joins node {a} to node {b}")]
    Unconnected {
        /// The one node.
        a: usize,
        /// The other.
        b: usize,
    },
    /// The edges leave a direction of motion between the nodes open, so the covariance is infinite.
    #[error("the edges between node {a} and node {b} leave a direction of motion open")]
    Unconstrained {
        /// The one node.
        a: usize,
        /// The other.
        b: usize,
    },
}

impl PoseGraph {
    /// The covariance of `a_from_b`: perturbation on the right, in the frame of `b`, translation before rotation.
    ///
    /// For nodes that were there at the last full optimisation it is the exact marginal of the linearised equations,
    /// by a forward substitution over the path from the two nodes to the root of the elimination: neither an inverse
    /// nor all of the factor is touched. For newer nodes the covariances along their chain of first edges are added,
    /// which leaves out what newer edges tell: an upper bound. Loop candidates are what it is for.
    ///
    /// # Errors
    /// [`CovarianceError`].
    pub fn relative_covariance(&self, a: usize, b: usize) -> Result<Covariance, CovarianceError> {
        let nodes = self.poses.len();
        if let Some(node) = [a, b].into_iter().find(|node| *node >= nodes) {
            return Err(CovarianceError::UnknownNode { node, nodes });
        }
        if self.components.first_of(a) != self.components.first_of(b) {
            return Err(CovarianceError::Unconnected { a, b });
        }
        let open = CovarianceError::Unconstrained { a, b };
        let solved = self.solved.as_ref().filter(|solved| solved.is_exact).map_or(0, |solved| solved.nodes);
        // Walk both nodes back along their first edges to where the equations, or each other, are met. The chains give
        // the covariances of x_from_a and y_from_b.
        let (mut x, mut y) = (a, b);
        let (mut chain_a, mut chain_b) = (Covariance::zeros(), Covariance::zeros());
        let anchored = |node: &mut usize, chain: &mut Covariance, end: usize| {
            let edge = self.edges_by_later[*node].first().and_then(|edge| self.edges.get(*edge)).ok_or(open)?;
            *chain += self.chained(edge, *node, end).ok_or(open)?;
            *node = edge.from.min(edge.to);
            Ok(())
        };
        while x != y && (x >= solved || y >= solved) {
            if x > y {
                anchored(&mut x, &mut chain_a, a)?;
            } else {
                anchored(&mut y, &mut chain_b, b)?;
            }
        }
        let between = if x == y { Covariance::zeros() } else { self.marginal(x, y).ok_or(open)? };
        // All of it as perturbations in the frame of b.
        let b_from_y = adjoint(&(self.poses[b].inverse() * self.poses[y]));
        let b_from_a = adjoint(&(self.poses[b].inverse() * self.poses[a]));
        let covariance =
            b_from_y * between * b_from_y.transpose() + chain_b + b_from_a * chain_a * b_from_a.transpose();
        if covariance.diagonal().iter().all(|variance| *variance < OPEN) {
            Ok((covariance + covariance.transpose()) * 0.5)
        } else {
            Err(open)
        }
    }

    /// The covariance of an edge as a perturbation of its later node, seen from the frame of `end`, to which the chain
    /// leads on.
    fn chained(&self, edge: &Edge, later: usize, end: usize) -> Option<Covariance> {
        let covariance = edge.information.cholesky()?.inverse();
        // The perturbation is in the frame of `to`, whichever is later.
        debug_assert!(later == edge.from.max(edge.to));
        let end_from_to = adjoint(&(self.poses[end].inverse() * self.poses[edge.to]));
        Some(end_from_to * covariance * end_from_to.transpose())
    }

    /// The exact marginal covariance of `x_from_y` in the frame of `y`, both among the nodes of the solved equations.
    fn marginal(&self, x: usize, y: usize) -> Option<Covariance> {
        let solved = self.solved.as_ref()?;
        // x_from_y perturbed: exp(-dx) T exp(dy) = T exp(dy - Ad(T^-1) dx); hence G = [I at y, -Ad(T^-1)^T at x].
        let y_from_x: Pose = self.poses[y].inverse() * self.poses[x];
        let blocks = [(y, Matrix6::identity()), (x, -adjoint(&y_from_x).transpose())];
        Some(solved.workspace.solver.project(&blocks))
    }
}
