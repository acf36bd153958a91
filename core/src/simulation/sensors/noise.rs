//! Seeded random numbers, one independent stream a sensor.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};

/// A stream of random numbers of its own.
#[derive(Debug, Clone)]
pub struct Noise {
    rng: ChaCha8Rng,
}

impl Noise {
    /// The stream of a run's seed and a sensor's number.
    #[must_use]
    pub fn new(seed: u64, sensor: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(sensor);
        Self { rng }
    }

    /// Normal with this standard deviation.
    pub fn normal(&mut self, sigma: f64) -> f64 {
        let normal: f64 = StandardNormal.sample(&mut self.rng);
        sigma * normal
    }

    /// Three independent normal numbers.
    pub fn normal3(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::new(self.normal(sigma), self.normal(sigma), self.normal(sigma))
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        StandardUniform.sample(&mut self.rng)
    }

    /// The time until something happens that happens every `mean` [s] on average.
    pub fn waiting(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }

    /// One step of a first-order Gauss-Markov process of this standard deviation and correlation time [s].
    pub fn drift(&mut self, value: f64, sigma: f64, correlation: f64, step: f64) -> f64 {
        let keep = (-step / correlation).exp();
        keep * value + self.normal(sigma * (1.0 - keep * keep).sqrt())
    }
}
