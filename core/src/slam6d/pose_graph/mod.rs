//! The pose graph: poses as nodes, measured motions between them as edges, and the poses that fit all of them best.
//!
//! Minimises the sum of e^T Omega e over the edges, e = log(measured^-1 * from^-1 * to) in SE(3), by Gauss-Newton with
//! Levenberg-Marquardt damping where a step fails, on sparse normal equations (Grisetti et al. 2010; Dellaert and Kaess
//! 2017). Loop closures are robust: those that contradict the rest are switched off. Node 0 is held fixed, and so is the
//! first node of every part of the graph that no edge joins to it.
//!
//! Results depend neither on threads nor on the order of calls before, except that an optimisation starts where the
//! last one ended.

mod components;
mod config;
mod covariance;
mod edge;
mod incremental;
mod levenberg;
mod linearisation;
mod robust;
mod sparse_solver;
mod structure;
pub mod survey;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use config::PoseGraphConfig;
pub use covariance::CovarianceError;
pub use edge::{Edge, EdgeError, EdgeKind};
pub use incremental::Update;

use components::Components;
use levenberg::{Problem, Workspace};
use structure::{OutOfMemory, Structure};

use crate::geometry::{Pose, rotation_angle};
use crate::registration::ConfigError;

/// Poses and the motions measured between them.
pub struct PoseGraph {
    config: PoseGraphConfig,
    poses: Vec<Pose>,
    edges: Vec<Edge>,
    /// How much each edge counts, from 0 (switched off) to 1.
    weights: Vec<f64>,
    components: Components,
    /// For each node the first edge that joins it to an earlier one.
    anchors: Vec<Option<usize>>,
    /// The equations of the whole graph, as of the last full optimisation.
    solved: Option<Solved>,
    /// The first edge that no optimisation has seen.
    first_new_edge: usize,
}

/// The whole graph's equations.
struct Solved {
    workspace: Workspace,
    /// The nodes and edges there were.
    nodes: usize,
    edges: usize,
    /// The factor is that of the equations at the optimum.
    is_exact: bool,
}

/// What an optimisation did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Optimisation {
    /// Sum of e^T Omega e over the edges that are not switched off, before.
    pub chi2_before: f64,
    /// The same, after.
    pub chi2: f64,
    /// Linearisations.
    pub iterations: u32,
    /// The last step was below the tolerances.
    pub converged: bool,
    /// The loop closures that are switched off, as indices of edges, ascending.
    pub switched_off: Vec<usize>,
    /// How far the pose moved that moved farthest [m].
    pub largest_translation_m: f64,
    /// How much the pose turned that turned most [rad].
    pub largest_rotation: f64,
    /// The first node that could move; 1 when all could.
    pub first_node: usize,
}

/// Why a graph could not be optimised.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum OptimiseError {
    /// The equations do not fit into memory.
    #[error("the equations of {nodes} poses and {edges} edges do not fit into memory")]
    OutOfMemory {
        /// Poses of the graph.
        nodes: usize,
        /// Edges of the graph.
        edges: usize,
    },
    /// The sum of squares at the start is not finite: a pose is out of all bounds.
    #[error("the residuals of the {edges} edges are not finite at the start")]
    NotFinite {
        /// Edges of the graph.
        edges: usize,
    },
}

impl PoseGraph {
    /// An empty graph.
    ///
    /// # Errors
    /// The first field of the settings out of range.
    pub fn new(config: PoseGraphConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            poses: Vec::new(),
            edges: Vec::new(),
            weights: Vec::new(),
            components: Components::default(),
            anchors: Vec::new(),
            solved: None,
            first_new_edge: 0,
        })
    }

    /// Adds a pose where it is believed to be and returns its index. Node 0 is held fixed. Takes constant time.
    pub fn add_node(&mut self, map_from_node: Pose) -> usize {
        self.poses.push(map_from_node);
        self.anchors.push(None);
        self.components.add();
        self.poses.len() - 1
    }

    /// Adds a measurement and returns its index. Takes constant time; no pose moves before the next optimisation.
    ///
    /// # Errors
    /// [`EdgeError`]; the graph is as before.
    pub fn add_edge(&mut self, edge: Edge) -> Result<usize, EdgeError> {
        edge.check(self.poses.len())?;
        self.components.join(edge.from, edge.to);
        self.anchors[edge.from.max(edge.to)].get_or_insert(self.edges.len());
        self.edges.push(edge);
        self.weights.push(1.0);
        Ok(self.edges.len() - 1)
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &PoseGraphConfig {
        &self.config
    }

    /// The poses `map_from_node`, by index of the node.
    #[must_use]
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// The measurements, by index of the edge.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The squared Mahalanobis distance of an edge at the present poses, e^T Omega e; `None` without such an edge.
    #[must_use]
    pub fn edge_chi2(&self, edge: usize) -> Option<f64> {
        let edge = self.edges.get(edge)?;
        Some(linearisation::chi2(edge, self.poses.get(edge.from)?, self.poses.get(edge.to)?))
    }

    /// The loop closures that are switched off, as indices of edges, ascending.
    #[must_use]
    pub fn switched_off(&self) -> Vec<usize> {
        (0..self.edges.len()).filter(|edge| self.weights[*edge] <= robust::OFF).collect()
    }

    /// The sum of e^T Omega e over the edges that are not switched off.
    #[must_use]
    pub fn chi2(&self) -> f64 {
        let used = self.edges.iter().zip(&self.weights).filter(|(_, weight)| **weight > robust::OFF);
        used.map(|(edge, _)| linearisation::chi2(edge, &self.poses[edge.from], &self.poses[edge.to])).sum()
    }

    /// Moves all poses to where they fit all measurements best.
    ///
    /// # Errors
    /// [`OptimiseError`]; the poses are as before.
    pub fn optimise(&mut self) -> Result<Optimisation, OptimiseError> {
        let before = self.poses.clone();
        if !self.edges.iter().zip(0..).all(|(_, edge)| self.edge_chi2(edge).is_some_and(f64::is_finite)) {
            return Err(OptimiseError::NotFinite { edges: self.edges.len() });
        }
        let mut solved = match self.solved.take() {
            Some(solved) if solved.nodes == self.poses.len() && solved.edges == self.edges.len() => solved,
            _ => self.analyse().map_err(|OutOfMemory| self.out_of_memory())?,
        };
        let mut problem = Problem { edges: &self.edges, poses: &mut self.poses, weights: &mut self.weights };
        let walk = robust::optimise(&mut problem, &mut solved.workspace, &self.config);
        solved.is_exact = problem.factorise_at_optimum(&mut solved.workspace);
        self.solved = Some(solved);
        self.first_new_edge = self.edges.len();
        Ok(self.report(&before, 0, &walk))
    }

    /// The equations of the whole graph.
    fn analyse(&self) -> Result<Solved, OutOfMemory> {
        let is_free: Vec<bool> = (0..self.poses.len()).map(|node| self.components.first_of(node) != node).collect();
        let structure = Structure::new(self.edges.iter().map(|edge| (edge.from, edge.to)), &is_free)?;
        let workspace = Workspace::new(structure, (0..self.edges.len()).collect())?;
        Ok(Solved { workspace, nodes: self.poses.len(), edges: self.edges.len(), is_exact: false })
    }

    fn out_of_memory(&self) -> OptimiseError {
        OptimiseError::OutOfMemory { nodes: self.poses.len(), edges: self.edges.len() }
    }

    /// The report on an optimisation that began at `before`, the poses from `first` on.
    fn report(&self, before: &[Pose], first: usize, walk: &levenberg::Walk) -> Optimisation {
        let (mut largest_translation_m, mut largest_rotation) = (0.0_f64, 0.0_f64);
        for (before, after) in before.iter().zip(&self.poses[first..]) {
            let moved = before.inverse() * after;
            largest_translation_m = largest_translation_m.max(moved.translation.vector.norm());
            largest_rotation = largest_rotation.max(rotation_angle(&moved));
        }
        Optimisation {
            chi2_before: self.chi2_of(before, first),
            chi2: self.chi2(),
            iterations: walk.iterations,
            converged: walk.converged,
            switched_off: self.switched_off(),
            largest_translation_m,
            largest_rotation,
            first_node: first.max(1),
        }
    }

    /// [`Self::chi2`] with other poses from `first` on.
    fn chi2_of(&self, poses: &[Pose], first: usize) -> f64 {
        let pose = |node: usize| node.checked_sub(first).and_then(|k| poses.get(k)).unwrap_or(&self.poses[node]);
        let used = self.edges.iter().zip(&self.weights).filter(|(_, weight)| **weight > robust::OFF);
        used.map(|(edge, _)| linearisation::chi2(edge, pose(edge.from), pose(edge.to))).sum()
    }
}
