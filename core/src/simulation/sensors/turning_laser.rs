//! The laser on the turning head, as it speaks: sweeps of beams with their own times, and encoder ticks in between
//! (section 1). The scan is put together by whoever listens.

use thiserror::Error;

use super::noise::Noise;
use super::planar_laser::LaserBeam;
use super::sweeps_ahead::SweepsAhead;
use crate::geometry::Pose;
use crate::simulation::compiled_scene::CompiledScene;
use crate::simulation::scanner_config::{ScannerConfig, ScannerConfigError};

/// Sweeps a second [Hz].
const SWEEP_RATE: f64 = 50.0;
/// Time between two encoder readings [s].
const TICK_S: f64 = 0.01;
/// Angle of the head a count of its encoder [rad]: 14 bits.
const COUNT_RAD: f64 = std::f64::consts::TAU / 16384.0;
/// The home switch is pressed within this angle of home [rad].
const HOME_RAD: f64 = 0.02;
/// The motor's speed swings by this share, so many times a turn.
const RIPPLE: f64 = 0.02;
const RIPPLES: f64 = 5.0;
/// Fastest turning of the source's head: 5 turns a minute [rad/s].
const FASTEST: f64 = 5.0 * std::f64::consts::TAU / 60.0;

/// One sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserSweep {
    /// Simulated time of the first beam [s].
    pub time: f64,
    /// From the first to the last beam [s].
    pub duration: f64,
    /// Angle of the first beam over the horizon ahead of the head [rad].
    pub first_angle: f64,
    /// From beam to beam [rad].
    pub angle_step: f64,
    /// Counts the sweeps of a scan.
    pub sweep: u32,
    /// In the order in which they are fired.
    pub beams: Vec<LaserBeam>,
}

/// What the head's controller says every 10 ms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderTick {
    /// Simulated time [s].
    pub time: f64,
    /// Of the head since the home switch, in whole counts [rad].
    pub angle: f64,
    /// Of the head [rad/s].
    pub velocity: f64,
    /// Whether the home switch is pressed.
    pub is_home: bool,
    /// Counts the readings of a scan.
    pub reading: u32,
}

/// Why a head cannot turn so.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TurningLaserError {
    /// A field of the scanner is out of range.
    #[error(transparent)]
    Scanner(#[from] ScannerConfigError),
    /// The head would have to turn too fast.
    #[error("a turn of {turn_deg} deg in {sweeps} sweeps at 50 Hz is faster than 5 turns a minute; take more sweeps")]
    TooFast {
        /// Angle of a scan [deg].
        turn_deg: f64,
        /// Sweeps of a scan.
        sweeps: usize,
    },
}

/// The laser and its head. A scan begins at home, which is the scanner's `first_sweep_deg`.
#[derive(Debug, Clone)]
pub struct TurningLaser {
    config: ScannerConfig,
    noise: Noise,
    /// Simulated time of the scan's first beam [s].
    start: f64,
    sweeps: u32,
    ticks: u32,
    ahead: SweepsAhead,
}

impl TurningLaser {
    /// A head at home; nothing is sent before [`TurningLaser::start`].
    ///
    /// # Errors
    /// When the config is out of range or asks for a head that turns too fast.
    pub fn new(config: ScannerConfig, noise: Noise) -> Result<Self, TurningLaserError> {
        config.validate()?;
        let (turn_deg, sweeps) = (config.turn_deg, config.sweeps);
        if turn_deg.to_radians() / (sweeps as f64 / SWEEP_RATE) > FASTEST {
            return Err(TurningLaserError::TooFast { turn_deg, sweeps });
        }
        let (done, ahead) = (config.sweeps as u32, SweepsAhead::new(&config));
        let mut laser = Self { config, noise, start: 0.0, sweeps: done, ticks: 0, ahead };
        laser.ticks = laser.last_tick() + 1;
        Ok(laser)
    }

    /// Casts on this many threads; the bits do not depend on it.
    pub fn set_threads(&mut self, threads: usize) {
        self.ahead.set_threads(threads);
    }

    /// Begins a scan at a simulated time [s].
    pub fn start(&mut self, time: f64) {
        (self.start, self.sweeps, self.ticks) = (time, 0, 0);
        self.ahead.forget();
    }

    /// Whether a scan is under way.
    #[must_use]
    pub fn is_scanning(&self) -> bool {
        (self.sweeps as usize) < self.config.sweeps || self.ticks <= self.last_tick()
    }

    /// How long a scan takes [s].
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.config.sweeps as f64 / SWEEP_RATE
    }

    /// The reading that brackets the last beam.
    fn last_tick(&self) -> u32 {
        (self.duration() / TICK_S - 1e-6).ceil() as u32
    }

    /// Everything that is due at `time` or before: encoder ticks, and the sweeps whose last beam has been fired. The
    /// robot is taken to stand at `map_from_scanner` meanwhile.
    pub fn advance(
        &mut self,
        time: f64,
        scene: &CompiledScene,
        map_from_scanner: &Pose,
        sweeps: &mut Vec<LaserSweep>,
        ticks: &mut Vec<EncoderTick>,
    ) {
        while self.ticks <= self.last_tick() {
            let after = TICK_S * f64::from(self.ticks);
            if self.start + after > time + 1e-9 {
                break;
            }
            let (angle, velocity) = head(self.config.turn_deg.to_radians(), self.duration(), after);
            let angle = (angle / COUNT_RAD).floor() * COUNT_RAD;
            let is_home = angle < HOME_RAD;
            ticks.push(EncoderTick { time: self.start + after, angle, velocity, is_home, reading: self.ticks });
            self.ticks += 1;
        }
        while (self.sweeps as usize) < self.config.sweeps {
            let begins = f64::from(self.sweeps) / SWEEP_RATE;
            if self.start + begins + self.sweep_duration() > time + 1e-9 {
                break;
            }
            sweeps.push(self.sweep(begins, scene, map_from_scanner));
            self.sweeps += 1;
        }
    }

    /// From the first to the last beam of a sweep [s]: the mirror turns once in a period.
    fn sweep_duration(&self) -> f64 {
        self.config.beam_step_deg * (self.config.beams - 1) as f64 / 360.0 / SWEEP_RATE
    }

    /// The sweep that begins so long after the scan began [s].
    fn sweep(&mut self, begins: f64, scene: &CompiledScene, map_from_scanner: &Pose) -> LaserSweep {
        let (first, step) = (self.config.first_beam_deg.to_radians(), self.config.beam_step_deg.to_radians());
        let (duration, last) = (self.sweep_duration(), (self.config.beams.max(2) - 1) as f64);
        let config = &self.config;
        let total = self.duration();
        let azimuth = |sweep: u32, beam: usize| {
            let after = f64::from(sweep) / SWEEP_RATE + duration * beam as f64 / last;
            config.first_sweep_deg.to_radians() + head(config.turn_deg.to_radians(), total, after).0
        };
        let echoes = self.ahead.sweep(self.sweeps, config, scene, map_from_scanner, azimuth);
        let mut beams = Vec::with_capacity(config.beams);
        for (beam, echo) in echoes.enumerate() {
            let error = self.noise.normal(config.noise_m);
            let (lost, luck) = (self.noise.uniform() < config.dropout, self.noise.uniform());
            let is_seen = !lost && echo.strength.is_none_or(|strength| strength - 0.5 > luck);
            let range = echo.range.map(|range| range + error).filter(|_| is_seen);
            let range = range.filter(|range| (config.range_min_m..=config.range_max_m).contains(range));
            let intensity = echo.strength.filter(|_| range.is_some()).map_or(0, ScannerConfig::intensity);
            let time = (65535.0 * beam as f64 / last).round() as u16;
            beams.push(LaserBeam { range: range.map_or(f32::NAN, |range| range as f32), intensity, time });
        }
        let time = self.start + begins;
        LaserSweep { time, duration, first_angle: first, angle_step: step, sweep: self.sweeps, beams }
    }
}

/// The true angle of the head since home [rad] and its speed [rad/s], some time after a scan began [s] in which it turns
/// by `turn` [rad] in `duration` [s].
fn head(turn: f64, duration: f64, after: f64) -> (f64, f64) {
    let speed = turn / duration;
    let (sin, cos) = (RIPPLES * speed * after).sin_cos();
    (speed * after + RIPPLE / RIPPLES * (1.0 - cos), speed * (1.0 + RIPPLE * sin))
}
