//! The settings of the pose graph.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;

/// The settings of the pose graph.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseGraphConfig {
    /// Most linearisations of one optimisation.
    pub max_iterations: u32,
    /// The optimisation has converged when no pose moves farther than this in a step [m].
    pub translation_tolerance_m: f64,
    /// ... and none turns more than this [rad].
    pub rotation_tolerance: f64,
    /// Whether loop closures that contradict the rest are switched off.
    pub robust: bool,
    /// The squared Mahalanobis distance up to which a loop closure counts as true. An honest covariance gives 6 on
    /// average and more than 36 once in 360,000.
    pub closure_gate: f64,
    /// The shortest window that is optimised when edges arrive near the end [nodes].
    pub window_nodes: usize,
    /// A window grows until the nodes at its border would move less than this [m], and turn less than the angle that
    /// moves a point at 10 m as far.
    pub window_tolerance_m: f64,
}

impl Default for PoseGraphConfig {
    fn default() -> Self {
        Self {
            max_iterations: 200,
            translation_tolerance_m: 1e-5,
            rotation_tolerance: 1e-6,
            robust: true,
            closure_gate: 36.0,
            window_nodes: 20,
            window_tolerance_m: 1e-4,
        }
    }
}

impl PoseGraphConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("pose_graph.max_iterations", f64::from(self.max_iterations), 1.0, 1e6)?;
        ConfigError::check("pose_graph.translation_tolerance_m", self.translation_tolerance_m, 1e-12, 1.0)?;
        ConfigError::check("pose_graph.rotation_tolerance", self.rotation_tolerance, 1e-12, 1.0)?;
        ConfigError::check("pose_graph.closure_gate", self.closure_gate, 1.0, 1e9)?;
        ConfigError::check("pose_graph.window_nodes", self.window_nodes as f64, 2.0, 1e6)?;
        ConfigError::check("pose_graph.window_tolerance_m", self.window_tolerance_m, 1e-9, 10.0)
    }
}
