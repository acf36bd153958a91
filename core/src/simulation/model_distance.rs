//! How far the points of a model lie from the true surfaces.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::CompiledScene;

/// Points taken of every scan, evenly over its returns.
const POINTS_A_SCAN: usize = 500;
/// Farther from every surface than this is said to be this far [m].
const REACH_M: f64 = 1.0;

/// Distances of a sample of a model's points to the nearest true surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ModelDistance {
    /// Points sampled.
    pub points: usize,
    /// The median [m].
    pub median_m: f64,
    /// The 95th percentile [m].
    pub p95_m: f64,
}

/// The distances gathered so far.
#[derive(Debug, Default)]
pub struct ModelDistances(Vec<f64>);

impl ModelDistances {
    /// Samples the returns of a scan, given in the scene's frame [m].
    pub fn sample(&mut self, scene: &CompiledScene, returns: impl Iterator<Item = Point3<f64>> + Clone) {
        let stride = returns.clone().count().div_ceil(POINTS_A_SCAN).max(1);
        let distance = |at: Point3<f64>| scene.distance_to_surface(&at, REACH_M).unwrap_or(REACH_M);
        self.0.extend(returns.step_by(stride).map(distance));
    }

    /// Nearest-rank percentiles; `None` without points.
    #[must_use]
    pub fn summary(mut self) -> Option<ModelDistance> {
        self.0.sort_unstable_by(f64::total_cmp);
        let rank = |percent: usize| self.0.get((self.0.len() * percent).div_ceil(100).saturating_sub(1)).copied();
        Some(ModelDistance { points: self.0.len(), median_m: rank(50)?, p95_m: rank(95)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Scene;

    #[test]
    fn a_sample_of_every_scan_is_measured_and_what_is_far_off_is_cut() {
        let scene = CompiledScene::new(Scene::builtin("plane").unwrap()).unwrap();
        let start = scene.scene().start;
        let sheet = |height: f64, count: usize| (0..count).map(move |_| Point3::new(start.x, start.y, height));
        let mut distances = ModelDistances::default();
        distances.sample(&scene, sheet(0.02, 10_000));
        distances.sample(&scene, sheet(0.1, 100));
        distances.sample(&scene, sheet(50.0, 10));
        let summary = distances.summary().unwrap();
        assert_eq!(summary.points, 500 + 100 + 10);
        assert!((summary.median_m - 0.02).abs() < 1e-5 && (summary.p95_m - 0.1).abs() < 1e-5, "{summary:?}");
        assert_eq!(ModelDistances::default().summary(), None);
        let mut far = ModelDistances::default();
        far.sample(&scene, sheet(50.0, 1));
        assert_eq!(far.summary().unwrap().median_m, REACH_M);
    }
}
