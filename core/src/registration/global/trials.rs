//! Seeded trials of relocalisation: wrong priors to start from, and what came of them.

use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::geometry::{self, Pose};
use crate::registration::coarse::{Relocalisation, SearchRange};

/// How a trial ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// A pose was trusted and it is right.
    Recovered,
    /// No pose was trusted.
    Refused,
    /// A pose was trusted and it is wrong.
    FalseAccept {
        /// By so much [m]; infinite where no pose is right.
        translation_m: f64,
        /// And by so much [rad].
        rotation: f64,
    },
}

/// The largest error of a right pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// [m].
    pub translation_m: f64,
    /// [rad].
    pub rotation: f64,
}

impl Default for Tolerance {
    /// 0.1 m and 0.5 degrees.
    fn default() -> Self {
        Self { translation_m: 0.1, rotation: 0.5_f64.to_radians() }
    }
}

impl Outcome {
    /// Compares an answer with the truth; `None` where the scans have no pose in common.
    #[must_use]
    pub fn of(answer: &Relocalisation, truth: Option<&Pose>, tolerance: Tolerance) -> Self {
        let Some(alignment) = answer.trusted() else { return Self::Refused };
        let Some(truth) = truth else {
            return Self::FalseAccept { translation_m: f64::INFINITY, rotation: f64::INFINITY };
        };
        let error = truth.inverse() * alignment.target_from_source;
        let (translation_m, rotation) = (error.translation.vector.norm(), geometry::rotation_angle(&error));
        if translation_m <= tolerance.translation_m && rotation <= tolerance.rotation {
            Self::Recovered
        } else {
            Self::FalseAccept { translation_m, rotation }
        }
    }
}

/// How many trials ended in which way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Trusted and right.
    pub recovered: usize,
    /// Not trusted.
    pub refused: usize,
    /// Trusted and wrong.
    pub false_accepts: usize,
}

impl Tally {
    /// Counts an outcome.
    pub fn add(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Recovered => self.recovered += 1,
            Outcome::Refused => self.refused += 1,
            Outcome::FalseAccept { .. } => self.false_accepts += 1,
        }
    }

    /// All trials.
    #[must_use]
    pub fn trials(&self) -> usize {
        self.recovered + self.refused + self.false_accepts
    }
}

/// Errors of priors and random poses, the same for the same seed.
#[derive(Debug, Clone)]
pub struct Draws {
    random: ChaCha8Rng,
}

impl Draws {
    /// Draws from a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Evenly from 0 to 1.
    pub fn share(&mut self) -> f64 {
        (self.random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Evenly from -1 to 1.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.share() - 1.0
    }

    /// -1 or 1.
    fn sign(&mut self) -> f64 {
        if self.share() < 0.5 { -1.0 } else { 1.0 }
    }

    /// An error on the border of the range: the whole translation in a random direction across the vertical, the whole
    /// yaw and both tilts, and any height within it. A prior of `truth * error` is as wrong as it may be.
    pub fn error_at_the_border(&mut self, range: &SearchRange) -> Pose {
        let [yaw, roll, pitch] = [range.yaw, range.tilt, range.tilt].map(|most| most * self.sign());
        self.error(range, 1.0, [roll, pitch, yaw])
    }

    /// An error within the range, evenly.
    pub fn error_within(&mut self, range: &SearchRange) -> Pose {
        let share = self.share().sqrt();
        let [yaw, roll, pitch] = [range.yaw, range.tilt, range.tilt].map(|most| most * self.signed());
        self.error(range, share, [roll, pitch, yaw])
    }

    fn error(&mut self, range: &SearchRange, share: f64, [roll, pitch, yaw]: [f64; 3]) -> Pose {
        let direction = self.share() * std::f64::consts::TAU;
        let metres = share * range.translation_m;
        let shift = Vector3::new(metres * direction.cos(), metres * direction.sin(), range.height_m * self.signed());
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw)
            * UnitQuaternion::from_scaled_axis(Vector3::y() * pitch)
            * UnitQuaternion::from_scaled_axis(Vector3::x() * roll);
        Pose::from_parts(shift.into(), turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_at_the_border_have_the_size_asked_for_and_are_the_same_for_a_seed() {
        let range = SearchRange::default();
        let (mut a, mut b) = (Draws::new(3), Draws::new(3));
        for _ in 0..20 {
            let error = a.error_at_the_border(&range);
            assert_eq!(error, b.error_at_the_border(&range));
            let across = error.translation.vector.xy().norm();
            assert!((across - 5.0).abs() < 1e-9 && error.translation.z.abs() <= 0.5);
            let (roll, pitch, yaw) = error.rotation.euler_angles();
            assert!((yaw.abs() - range.yaw).abs() < 1e-9);
            assert!((roll.abs() - range.tilt).abs() < 1e-9 && (pitch.abs() - range.tilt).abs() < 1e-9);
        }
    }
}
