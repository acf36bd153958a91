//! How far the points of a model lie from the true surfaces.

use mirador_core::geometry::Pose;
use mirador_core::scan::Point;
use mirador_core::simulation::CompiledScene;
use serde::{Deserialize, Serialize};

/// Points taken of every scan, evenly over its returns.
const POINTS_A_SCAN: usize = 500;
/// Farther from every surface than this is said to be this far [m].
const REACH_M: f64 = 1.0;

/// Distances of a sample of the model's points to the nearest true surface [m].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ModelError {
    /// Points sampled.
    pub points: usize,
    /// The median.
    pub median_m: f64,
    /// The 95th percentile.
    pub p95_m: f64,
}

/// The distances gathered so far.
#[derive(Debug, Default)]
pub(super) struct Distances(Vec<f64>);

impl Distances {
    /// Samples a scan.
    pub fn sample(&mut self, scene: &CompiledScene, points: &[Point], map_from_scanner: &Pose) {
        let returns: Vec<&Point> = points.iter().filter(|point| point.is_return()).collect();
        let stride = returns.len().div_ceil(POINTS_A_SCAN).max(1);
        self.0.extend(returns.iter().step_by(stride).map(|point| {
            let at = map_from_scanner * point.position();
            scene.distance_to_surface(&at, REACH_M).unwrap_or(REACH_M)
        }));
    }

    /// Nearest-rank percentiles; none without points.
    pub fn summary(mut self) -> Option<ModelError> {
        self.0.sort_unstable_by(f64::total_cmp);
        let rank = |percent: usize| self.0.get((self.0.len() * percent).div_ceil(100).saturating_sub(1)).copied();
        Some(ModelError { points: self.0.len(), median_m: rank(50)?, p95_m: rank(95)? })
    }
}
