//! Lasers with a line or a plane of beams: `laser1d` and `laser2d`.

use nalgebra::{Point3, Vector3};

use super::noise::Noise;
use crate::geometry::Pose;
use crate::simulation::compiled_scene::{CompiledScene, Hit, Viewpoint};

/// One beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaserBeam {
    /// Range [m], NaN without a return.
    pub range: f32,
    /// Sensor's own scale, 0 when unknown.
    pub intensity: u16,
    /// Time of the beam as a fraction of the sweep's duration, 0 to 65535.
    pub time: u16,
}

/// Beams in the sensor's x-y plane, the first one rightmost.
#[derive(Debug, Clone)]
pub struct PlanarLaser {
    directions: Vec<Vector3<f64>>,
    range_max: f64,
    sigma: f64,
    noise: Noise,
    rotated: Vec<Vector3<f64>>,
    hits: Vec<Option<Hit>>,
    /// What the hits were cast from.
    cast_from: Option<Viewpoint>,
}

impl PlanarLaser {
    /// Beams every `resolution` over `field_of_view` [rad], symmetric about x; one beam along x when the view is 0.
    #[must_use]
    pub fn new(range_max: f64, sigma: f64, resolution: f64, field_of_view: f64, noise: Noise) -> Self {
        let count = if field_of_view > 0.0 { (field_of_view / resolution + 1e-6) as usize + 1 } else { 1 };
        let first = -0.5 * resolution * (count - 1) as f64;
        let direction = |beam: usize| {
            let (sin, cos) = (first + resolution * beam as f64).sin_cos();
            Vector3::new(cos, sin, 0.0)
        };
        let directions: Vec<_> = (0..count).map(direction).collect();
        let (rotated, hits) = (directions.clone(), vec![None; count]);
        Self { directions, range_max, sigma, noise, rotated, hits, cast_from: None }
    }

    /// The number of beams.
    #[must_use]
    pub fn beams(&self) -> usize {
        self.directions.len()
    }

    /// One sweep from `map_from_sensor`, appended to `out`.
    pub fn sweep(&mut self, scene: &CompiledScene, map_from_sensor: &Pose, out: &mut Vec<LaserBeam>) {
        // A robot that stands sees what it has seen.
        if self.cast_from != Some(scene.viewpoint(map_from_sensor)) {
            self.cast(scene, map_from_sensor);
        }
        let last = (self.hits.len().max(2) - 1) as f64;
        for (beam, hit) in self.hits.iter().enumerate() {
            let error = self.noise.normal(self.sigma);
            let range = hit.map_or(f32::NAN, |hit| (hit.range + error).max(0.0) as f32);
            let time = (65535.0 * beam as f64 / last).round() as u16;
            out.push(LaserBeam { range, intensity: 0, time });
        }
    }
    fn cast(&mut self, scene: &CompiledScene, map_from_sensor: &Pose) {
        let rotation = map_from_sensor.rotation.to_rotation_matrix();
        for (rotated, direction) in self.rotated.iter_mut().zip(&self.directions) {
            *rotated = rotation * direction;
        }
        let origin = Point3::from(map_from_sensor.translation.vector);
        scene.cast_all(&origin, &self.rotated, self.range_max, &mut self.hits);
        self.cast_from = Some(scene.viewpoint(map_from_sensor));
    }
}
