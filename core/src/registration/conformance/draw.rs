//! Numbers that look drawn and are the same in every run.

use nalgebra::Vector3;

use crate::geometry::Pose;

/// A sequence of numbers (xorshift64, Marsaglia 2003).
pub(super) struct Draw(u64);

impl Draw {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next number, between the two.
    pub fn between(&mut self, least: f64, most: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        least + (most - least) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A motion of at most so many metres along, and radians about, each axis.
    pub fn motion(&mut self, metres: f64, radians: f64) -> Pose {
        let mut vector = |most: f64| Vector3::from_fn(|_, _| self.between(-most, most));
        Pose::new(vector(metres), vector(radians))
    }
}
