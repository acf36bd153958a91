//! What a scanner is, in numbers.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::compiled_scene::{CompiledScene, Hit};

/// The scanner's geometry and errors. The default is the source's: a SICK LMS111 with 541 beams over 270 deg every
/// 0.5 deg, range 50 m, 1 m over the ground, 720 sweeps a turn.
///
/// The fan lies in a vertical plane with its blind 90 deg downwards: beam angles run from -45 deg ahead of the head over
/// the zenith (90 deg) to 225 deg, that is -45 deg behind it. In a full turn every direction is therefore seen twice,
/// half a turn apart, and a third of the 389,520 cells look below the horizon: open ground with a few things on it gives
/// some 130,000 to 150,000 returns, where the source reports 150,000 to 180,000 outdoors. Ground is seen from a distance
/// of one scanner height on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScannerConfig {
    /// Angle of the first beam over the horizon ahead of the head [deg].
    pub first_beam_deg: f64,
    /// From beam to beam [deg].
    pub beam_step_deg: f64,
    /// Beams a sweep.
    pub beams: usize,
    /// Azimuth of the head at the first sweep, from x towards y [deg]. -180 puts the seam behind the robot.
    pub first_sweep_deg: f64,
    /// What the head turns in all [deg].
    pub turn_deg: f64,
    /// Sweeps a scan.
    pub sweeps: usize,
    /// Whether the head turns on during a sweep, as a real one does: each beam then has an azimuth of its own, and the
    /// last of a 270 deg fan is 3/4 of a step ahead of the first.
    pub turns_while_sweeping: bool,
    /// Nothing nearer gives a return [m].
    pub range_min_m: f64,
    /// Nothing farther gives a return [m].
    pub range_max_m: f64,
    /// Height of the scanner over the ground [m].
    pub height_m: f64,
    /// Standard deviation of a range [m].
    pub noise_m: f64,
    /// Probability that a return is lost, 0 to 1.
    pub dropout: f64,
    /// How far off a surface that returns a tenth of the light, square to the beam, is seen half of the time [m]. The
    /// light falls with the square of the range and with the cosine of incidence, so that dark surfaces and grazing
    /// beams give no return; the intensity of points is then its strength. 0 sees everything and leaves intensity 0.
    pub dark_range_m: f64,
    /// Opening angle of a beam [deg]: at edges its spot falls on two surfaces. 0 is a line.
    pub divergence_deg: f64,
    /// Where the two surfaces of a spot are nearer to one another than this, the range is a mixture of both [m]; else
    /// it is that of the surface which fills more of the spot.
    pub pulse_m: f64,
}

impl Default for ScannerConfig {
    fn default() -> Self {
        Self {
            first_beam_deg: -45.0,
            beam_step_deg: 0.5,
            beams: 541,
            first_sweep_deg: -180.0,
            turn_deg: 360.0,
            sweeps: 720,
            turns_while_sweeping: true,
            range_min_m: 0.1,
            range_max_m: 50.0,
            height_m: 1.0,
            noise_m: 0.01,
            dropout: 0.0,
            dark_range_m: 0.0,
            divergence_deg: 0.0,
            pulse_m: 0.6,
        }
    }
}

impl ScannerConfig {
    /// The default scanner with what its data sheet says of light: 18 m on a surface that returns a tenth of it, beams
    /// of 15 mrad.
    #[must_use]
    pub fn lms111() -> Self {
        Self { dark_range_m: 18.0, divergence_deg: 0.86, ..Self::default() }
    }
}

/// Why a scanner cannot be had.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScannerConfigError {
    /// A field is outside its range.
    #[error("scanner.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
}

impl ScannerConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the first field outside its range, and the range.
    pub fn validate(&self) -> Result<(), ScannerConfigError> {
        let fan = self.beam_step_deg * self.beams.saturating_sub(1) as f64;
        let angle = "must lie in -360 ..= 360";
        let checks = [
            (self.first_beam_deg.abs() <= 360.0, "first_beam_deg", self.first_beam_deg, angle),
            (self.beam_step_deg > 0.0, "beam_step_deg", self.beam_step_deg, "must be above 0"),
            ((1..=100_000).contains(&self.beams), "beams", self.beams as f64, "must lie in 1 ..= 100000"),
            (fan < 360.0, "beams", self.beams as f64, "the fan, (beams - 1) * beam_step_deg, must stay under 360"),
            (self.first_sweep_deg.abs() <= 360.0, "first_sweep_deg", self.first_sweep_deg, angle),
            (
                self.turn_deg > 0.0 && self.turn_deg <= 360.0,
                "turn_deg",
                self.turn_deg,
                "must lie in 0 < turn_deg <= 360",
            ),
            ((1..=100_000).contains(&self.sweeps), "sweeps", self.sweeps as f64, "must lie in 1 ..= 100000"),
            (self.range_min_m >= 0.0, "range_min_m", self.range_min_m, "must be 0 or more"),
            (
                self.range_max_m > self.range_min_m && self.range_max_m <= 1e4,
                "range_max_m",
                self.range_max_m,
                "must be above range_min_m and at most 10000",
            ),
            (
                self.height_m > 0.0 && self.height_m <= 100.0,
                "height_m",
                self.height_m,
                "must lie in 0 < height_m <= 100",
            ),
            ((0.0..=10.0).contains(&self.noise_m), "noise_m", self.noise_m, "must lie in 0 ..= 10"),
            ((0.0..=1.0).contains(&self.dropout), "dropout", self.dropout, "must lie in 0 ..= 1"),
            ((0.0..=1e4).contains(&self.dark_range_m), "dark_range_m", self.dark_range_m, "must lie in 0 ..= 10000"),
            ((0.0..=5.0).contains(&self.divergence_deg), "divergence_deg", self.divergence_deg, "must lie in 0 ..= 5"),
            ((0.0..=100.0).contains(&self.pulse_m), "pulse_m", self.pulse_m, "must lie in 0 ..= 100"),
        ];
        match checks.into_iter().find(|(holds, ..)| !holds) {
            None => Ok(()),
            Some((_, field, value, allowed)) => Err(ScannerConfigError::OutOfRange { field, value, allowed }),
        }
    }

    /// The light that comes back from a hit, in parts of what is needed to see it half of the time; `None` where the
    /// scanner sees everything.
    pub(super) fn strength(&self, scene: &CompiledScene, hit: &Hit, direction: &Vector3<f64>) -> Option<f64> {
        if self.dark_range_m <= 0.0 {
            return None;
        }
        let cosine = scene.normal(hit).dot(direction).abs();
        let nearness = self.dark_range_m / hit.range.max(0.1);
        // `dark_range_m` is said of a surface that returns a tenth.
        Some(10.0 * scene.colour(hit).reflectance() * cosine * nearness * nearness)
    }

    /// The intensity of a return of this strength: 1000 is seen half of the time.
    pub(super) fn intensity(strength: f64) -> u16 {
        (1000.0 * strength).clamp(1.0, 65535.0) as u16
    }

    /// How far off level ground of middling brightness is seen half of the time [m], no farther than anything is: the beam
    /// grazes it at an angle whose sine is height over range, so the light that returns falls with the cube of the range.
    #[must_use]
    pub fn ground_range_m(&self) -> f64 {
        /// Of soil, grass and asphalt.
        const REFLECTANCE: f64 = 0.3;
        if self.dark_range_m <= 0.0 {
            return self.range_max_m;
        }
        (10.0 * REFLECTANCE * self.dark_range_m.powi(2) * self.height_m).cbrt().min(self.range_max_m)
    }

    /// The same scanner without noise, dropouts and mixed ranges: what it gives is the truth.
    #[must_use]
    pub fn noise_free(&self) -> Self {
        Self { noise_m: 0.0, dropout: 0.0, dark_range_m: 0.0, divergence_deg: 0.0, ..self.clone() }
    }
}
