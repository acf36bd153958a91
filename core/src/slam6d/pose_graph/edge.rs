//! A measured motion between two poses.

use nalgebra::{Matrix6, SymmetricEigen};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::geometry::{Covariance, Pose};

/// Asymmetry and negative eigenvalues up to this share of the largest entry are rounding.
const ROUNDING: f64 = 1e-9;

/// Where a measurement comes from, which says how far it can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeKind {
    /// From a scan to the next: the chain that holds the graph together. Never switched off.
    Sequential,
    /// Between scans known to overlap because their poses were already known well. Never switched off.
    Overlap,
    /// Between scans that were found to be near each other again. It may be false, so it is robust: switched off when
    /// it contradicts the rest.
    LoopClosure,
}

/// A measured motion between the poses of two nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// The node in whose frame the motion is given.
    pub from: usize,
    /// The node that moved.
    pub to: usize,
    /// The measured pose of `to` in the frame of `from`.
    pub from_from_to: Pose,
    /// The inverse of the covariance of `from_from_to`: translation before rotation, perturbation on the right, in the
    /// frame of `to`. Directions that were not measured have zero information.
    pub information: Matrix6<f64>,
    /// Where the measurement comes from.
    pub kind: EdgeKind,
}

impl Edge {
    /// An edge from a measurement with its covariance, such as an [`crate::registration::Alignment`] of target `from`
    /// and source `to`.
    ///
    /// # Errors
    /// [`EdgeError::Covariance`] when the covariance is not positive definite.
    pub fn with_covariance(
        from: usize,
        to: usize,
        from_from_to: Pose,
        covariance: &Covariance,
        kind: EdgeKind,
    ) -> Result<Self, EdgeError> {
        let inverse = covariance.cholesky().map(|factor| factor.inverse());
        match inverse.filter(|information| information.iter().all(|value| value.is_finite())) {
            Some(information) => Ok(Self { from, to, from_from_to, information, kind }),
            None => Err(EdgeError::Covariance { from, to }),
        }
    }

    /// Passes an edge between two of `nodes` nodes that makes sense.
    pub(crate) fn check(&self, nodes: usize) -> Result<(), EdgeError> {
        let (from, to) = (self.from, self.to);
        if let Some(node) = [from, to].into_iter().find(|node| *node >= nodes) {
            return Err(EdgeError::UnknownNode { node, nodes });
        }
        if from == to {
            return Err(EdgeError::SelfEdge { node: from });
        }
        let rotation = self.from_from_to.rotation.quaternion().coords;
        let pose = self.from_from_to.translation.vector.iter().chain(rotation.iter());
        if pose.chain(self.information.iter()).any(|value| !value.is_finite()) || (rotation.norm() - 1.0).abs() > 1e-6 {
            return Err(EdgeError::NotFinite { from, to });
        }
        let largest = self.information.amax();
        let asymmetry = (self.information - self.information.transpose()).amax();
        // The information mixes units, so its eigenvalues are those after scaling the diagonal to one.
        let scale = self.information.diagonal().map(|value| if value > 0.0 { value.sqrt().recip() } else { 1.0 });
        let scaled = Matrix6::from_fn(|i, j| self.information[(i, j)] * scale[i] * scale[j]);
        let least = SymmetricEigen::new(scaled).eigenvalues.min();
        if asymmetry > ROUNDING * largest || least < -ROUNDING * scaled.amax() {
            return Err(EdgeError::Information { from, to });
        }
        Ok(())
    }
}

/// Why an edge was refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EdgeError {
    /// An end of the edge is not in the graph.
    #[error("node {node} is not in the graph, which has {nodes} nodes")]
    UnknownNode {
        /// The node named.
        node: usize,
        /// The nodes there are.
        nodes: usize,
    },
    /// An edge from a node to itself says nothing.
    #[error("the edge goes from node {node} to itself")]
    SelfEdge {
        /// The node.
        node: usize,
    },
    /// The measured pose or its information holds a value that is not finite, or the rotation is not of unit length.
    #[error("the edge from {from} to {to} holds a value that is not finite, or a rotation that is not of unit length")]
    NotFinite {
        /// Its first node.
        from: usize,
        /// Its second node.
        to: usize,
    },
    /// The information matrix is not symmetric, or has a negative eigenvalue.
    #[error("the information of the edge from {from} to {to} is not symmetric positive semidefinite")]
    Information {
        /// Its first node.
        from: usize,
        /// Its second node.
        to: usize,
    },
    /// The covariance cannot be inverted.
    #[error("the covariance of the edge from {from} to {to} is not symmetric positive definite")]
    Covariance {
        /// Its first node.
        from: usize,
        /// Its second node.
        to: usize,
    },
}
