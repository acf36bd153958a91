//! The source's scanner (section 5.3): a planar laser that sweeps a vertical plane while the head turns about z.

use std::ops::Range;

use nalgebra::{Point3, Rotation3, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use thiserror::Error;

use super::compiled_scene::{CompiledScene, Hit, LANES};
use super::ray_tree::{NOTHING, Packet};
use super::scanner_config::{ScannerConfig, ScannerConfigError};
use super::scene::Label;
use crate::geometry::Pose;
use crate::scan::{Grid, Point};
use crate::threads;

/// Lines of the grid a thread takes at a time: small enough to share the work evenly, large enough to amortise it.
const LINES_A_BLOCK: usize = 16;
/// Sweeps and beams of the tile that is cast as one packet: as square as possible, so that its rays stay together.
const TILE: usize = 4;
const _: () = assert!(TILE * TILE == LANES);

/// Why a scan cannot be written.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ScanError {
    /// The slice for the points does not have one element a cell.
    #[error("the scan has {cells} cells but the slice for its points holds {given}")]
    WrongPoints {
        /// Cells of the scanner's grid.
        cells: usize,
        /// Length of the slice.
        given: usize,
    },
    /// The slice for the labels does not have one element a cell.
    #[error("the scan has {cells} cells but the slice for its labels holds {given}")]
    WrongLabels {
        /// Cells of the scanner's grid.
        cells: usize,
        /// Length of the slice.
        given: usize,
    },
}

/// What a scan's errors are drawn from: the run's seed and the scan's number give independent draws to every scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanSeed {
    /// Of the run.
    pub seed: u64,
    /// Number of the scan in the run.
    pub scan: u64,
}

/// A scanner, its beams worked out.
///
/// The grid is in the order in which the sensor delivers: row r is sweep r, column b is beam b, the cell's index is
/// `r * beams + b`.
#[derive(Debug, Clone)]
pub struct Scanner {
    config: ScannerConfig,
    beams: Vec<Beam>,
}

/// What is the same for a beam in every sweep.
#[derive(Debug, Clone, Copy)]
struct Beam {
    /// Cosine and sine of its angle in the sweep's plane.
    cos: f64,
    sin: f64,
    /// Cosine and sine of the azimuth by which the head is ahead of the first beam of its sweep.
    ahead_cos: f64,
    ahead_sin: f64,
    /// When it is fired, in sweeps after the first beam of its sweep.
    after: f64,
}

/// Some lines of the grid and where their points go.
struct Block<'a> {
    first_row: usize,
    points: &'a mut [Point],
    labels: Option<&'a mut [Option<Label>]>,
}

impl Scanner {
    /// Works out the beams.
    ///
    /// # Errors
    /// When a field of the config is out of its range.
    pub fn new(config: ScannerConfig) -> Result<Self, ScannerConfigError> {
        config.validate()?;
        let step = (config.turn_deg / config.sweeps as f64).to_radians();
        let beams = (0..config.beams)
            .map(|b| {
                let turned_deg = b as f64 * config.beam_step_deg;
                let (sin, cos) = (config.first_beam_deg + turned_deg).to_radians().sin_cos();
                // The mirror turns once, 360 deg, while the head advances one step.
                let after = turned_deg / 360.0;
                let ahead = if config.turns_while_sweeping { after * step } else { 0.0 };
                let (ahead_sin, ahead_cos) = ahead.sin_cos();
                Beam { cos, sin, ahead_cos, ahead_sin, after }
            })
            .collect();
        Ok(Self { config, beams })
    }

    /// What the scanner was built from.
    #[must_use]
    pub fn config(&self) -> &ScannerConfig {
        &self.config
    }

    /// The order of its scans: rows are sweeps, columns are beams.
    #[must_use]
    pub fn grid(&self) -> Grid {
        Grid { rows: self.config.sweeps, cols: self.config.beams }
    }

    /// The unit ray of a cell in the scanner's frame, or `None` outside the grid.
    #[must_use]
    pub fn ray(&self, sweep: usize, beam: usize) -> Option<Vector3<f64>> {
        if sweep >= self.config.sweeps {
            return None;
        }
        self.beams.get(beam).map(|b| b.ray(self.head(sweep)))
    }

    /// The true range of a cell [m], or `None` when nothing lies between the scanner's nearest and farthest range.
    #[must_use]
    pub fn true_range(&self, scene: &CompiledScene, map_from_scanner: &Pose, sweep: usize, beam: usize) -> Option<f64> {
        let direction = map_from_scanner.rotation * self.ray(sweep, beam)?;
        let origin = Point3::from(map_from_scanner.translation.vector);
        let range = scene.cast(&origin, &direction, self.config.range_max_m)?.range;
        (range >= self.config.range_min_m).then_some(range)
    }

    /// Scans the scene into `points`, one a cell in the scanner's frame, [`Point::EMPTY`] where there is no return; and
    /// into `labels`, if asked, what each return hit. Works on `threads` threads, the caller's among them.
    /// The bits depend on neither their number nor their pace. Intensity is 0, which means unknown, unless the scanner's
    /// `dark_range_m` is set: then 1000 is light that is seen half of the time.
    ///
    /// # Errors
    /// When a slice does not have one element a cell; nothing is written then.
    pub fn scan(
        &self,
        scene: &CompiledScene,
        map_from_scanner: &Pose,
        seed: ScanSeed,
        threads: usize,
        points: &mut [Point],
        labels: Option<&mut [Option<Label>]>,
    ) -> Result<(), ScanError> {
        let cells = self.grid().cells();
        if points.len() != cells {
            return Err(ScanError::WrongPoints { cells, given: points.len() });
        }
        if let Some(labels) = labels.as_ref().filter(|labels| labels.len() != cells) {
            return Err(ScanError::WrongLabels { cells, given: labels.len() });
        }
        let block = LINES_A_BLOCK * self.config.beams;
        let mut labels = labels.map(|labels| labels.chunks_mut(block));
        let blocks = points.chunks_mut(block).enumerate().map(|(k, points)| Block {
            first_row: k * LINES_A_BLOCK,
            points,
            labels: labels.as_mut().and_then(Iterator::next),
        });
        threads::for_each(blocks, threads.min(cells.div_ceil(block)), |block| {
            self.scan_block(scene, map_from_scanner, seed, block);
        });
        Ok(())
    }

    fn scan_block(&self, scene: &CompiledScene, map_from_scanner: &Pose, seed: ScanSeed, block: Block<'_>) {
        let Block { first_row, points, mut labels } = block;
        let beams = self.config.beams;
        let end_row = first_row + points.len() / beams;
        // Edges show beside their neighbours, so these are cast, too, where edges count.
        let halo = usize::from(self.config.divergence_deg > 0.0);
        let rows = first_row.saturating_sub(halo)..(end_row + halo).min(self.config.sweeps);
        let cast = self.cast_rows(scene, map_from_scanner, rows);
        for (k, line) in points.chunks_mut(beams).enumerate() {
            let first = k * beams;
            let line_labels = labels.as_mut().and_then(|labels| labels.get_mut(first..first + line.len()));
            self.scan_sweep(&cast, seed, first_row + k, line, line_labels);
        }
    }

    /// Casts the centres of the beams of some sweeps, tile by tile.
    fn cast_rows<'a>(&'a self, scene: &'a CompiledScene, map_from_scanner: &Pose, rows: Range<usize>) -> CastRows<'a> {
        let beams = self.config.beams;
        let rotation = map_from_scanner.rotation.to_rotation_matrix();
        let origin = Point3::from(map_from_scanner.translation.vector);
        let mut hits = vec![CastRay { triangle: NOTHING, near: 0.0 }; rows.len() * beams];
        let mut stack = Vec::with_capacity(64);
        for top in (0..rows.len()).step_by(TILE) {
            let heads: [_; TILE] = std::array::from_fn(|k| self.head(rows.start + top + k));
            for left in (0..beams).step_by(TILE) {
                let mut packet = Packet::<LANES>::new(origin.coords.into());
                let (height, width) = (TILE.min(rows.len() - top), TILE.min(beams - left));
                for (row, &head) in heads.iter().enumerate().take(height) {
                    for col in 0..width {
                        let direction = rotation * self.beams[left + col].ray(head);
                        packet.set(TILE * row + col, direction.into(), self.config.range_max_m as f32);
                    }
                }
                scene.trace(&mut packet, &mut stack);
                for row in 0..height {
                    for col in 0..width {
                        let (triangle, near) = (packet.triangle[TILE * row + col], packet.nearest[TILE * row + col]);
                        hits[(top + row) * beams + left + col] = CastRay { triangle, near };
                    }
                }
            }
        }
        CastRows { scanner: self, scene, origin, rotation, rows, hits }
    }

    /// One sweep. Its errors come from a generator of its own, and every beam draws, hit or not.
    fn scan_sweep(
        &self,
        cast: &CastRows<'_>,
        seed: ScanSeed,
        sweep: usize,
        points: &mut [Point],
        mut labels: Option<&mut [Option<Label>]>,
    ) {
        let scene = cast.scene;
        let mut errors = Errors::new(&self.config, scene.scene().terrain.grass_m, seed, sweep);
        let head = self.head(sweep);
        let mut stack = Vec::with_capacity(64);
        for (b, (beam, point)) in self.beams.iter().zip(points).enumerate() {
            let ray = beam.ray(head);
            let drawn = errors.draw();
            let direction = cast.rotation * ray;
            let hit = if self.config.divergence_deg > 0.0 {
                spot::hit(cast, sweep, b, &direction, &mut stack)
            } else {
                cast.hit(sweep, b, &direction)
            };
            let measured = hit.zip(drawn).and_then(|(hit, drawn)| {
                let strength = self.config.strength(scene, &hit, &direction);
                // At strength 1 half of the returns are lost.
                if strength.is_some_and(|strength| strength - 0.5 <= drawn.luck) {
                    return None;
                }
                let in_grass = if drawn.blade > 0.0 && hit.label == Label::Ground {
                    // The blade stands on the ground's tangent plane; the ray was free up to there.
                    drawn.blade / scene.normal(&hit).dot(&direction).abs().max(1e-6)
                } else {
                    0.0
                };
                Some(((hit.range - in_grass).max(0.0) + drawn.error, hit.label, strength))
            });
            let limits = self.config.range_min_m..=self.config.range_max_m;
            let measured = measured.filter(|(range, ..)| limits.contains(range));
            *point = measured.map_or(Point::EMPTY, |(range, _, strength)| {
                let at = (range * ray).cast::<f32>();
                let intensity = strength.map_or(0, ScannerConfig::intensity);
                Point { time: self.time(sweep, beam), intensity, ..Point::new(at.x, at.y, at.z) }
            });
            if let Some(label) = labels.as_mut().and_then(|labels| labels.get_mut(b)) {
                *label = measured.map(|(_, label, _)| label);
            }
        }
    }

    /// Cosine and sine of the head's azimuth at the first beam of a sweep.
    fn head(&self, sweep: usize) -> (f64, f64) {
        let turned_deg = self.config.turn_deg * sweep as f64 / self.config.sweeps as f64;
        let (sin, cos) = (self.config.first_sweep_deg + turned_deg).to_radians().sin_cos();
        (cos, sin)
    }

    /// When a beam is fired, as a fraction of the scan from its first beam (0) to its last (65535).
    fn time(&self, sweep: usize, beam: &Beam) -> u16 {
        let last = (self.config.sweeps - 1) as f64 + self.beams.last().map_or(0.0, |b| b.after);
        let fraction = if last > 0.0 { (sweep as f64 + beam.after) / last } else { 0.0 };
        (fraction * 65535.0).round() as u16
    }
}

/// What the centre of a beam meets.
#[derive(Debug, Clone, Copy)]
struct CastRay {
    triangle: u32,
    /// Range in single precision [m].
    near: f32,
}

/// Some sweeps with what the centres of their beams meet.
struct CastRows<'a> {
    scanner: &'a Scanner,
    scene: &'a CompiledScene,
    origin: Point3<f64>,
    rotation: Rotation3<f64>,
    rows: Range<usize>,
    hits: Vec<CastRay>,
}

impl CastRows<'_> {
    /// What the centre of a beam meets, if it was cast.
    fn ray(&self, sweep: usize, beam: usize) -> Option<CastRay> {
        let row = self.rows.contains(&sweep).then(|| sweep - self.rows.start)?;
        (beam < self.scanner.beams.len()).then(|| self.hits.get(row * self.scanner.beams.len() + beam).copied())?
    }

    /// As a hit; `direction` is the beam's, map frame.
    fn hit(&self, sweep: usize, beam: usize, direction: &Vector3<f64>) -> Option<Hit> {
        let CastRay { triangle, near } = self.ray(sweep, beam)?;
        self.scene.hit(&self.origin, direction, triangle, near)
    }
}

impl Beam {
    /// The unit ray in the scanner's frame when the first beam of its sweep has this azimuth (cosine, sine).
    fn ray(&self, head: (f64, f64)) -> Vector3<f64> {
        let cos = head.0 * self.ahead_cos - head.1 * self.ahead_sin;
        let sin = head.1 * self.ahead_cos + head.0 * self.ahead_sin;
        Vector3::new(self.cos * cos, self.cos * sin, self.sin)
    }
}

/// The range errors of one sweep.
struct Errors {
    rng: ChaCha8Rng,
    sigma: f64,
    dropout: f64,
    grass: f64,
    is_lit: bool,
}

/// What chance does to one beam.
struct Drawn {
    /// Error of its range [m].
    error: f64,
    /// Height of the blade of grass in its way, if it meets the ground [m].
    blade: f64,
    /// Uniform in [0, 1): how much light more than half of what is needed this beam asks for.
    luck: f64,
}

impl Errors {
    fn new(config: &ScannerConfig, grass: f64, seed: ScanSeed, sweep: usize) -> Self {
        // Run and scan are the generator's key and the sweep is its stream: no two sweeps of any run share draws.
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.seed.to_le_bytes());
        key[8..16].copy_from_slice(&seed.scan.to_le_bytes());
        let mut rng = ChaCha8Rng::from_seed(key);
        rng.set_stream(sweep as u64);
        let is_lit = config.dark_range_m > 0.0;
        Self { rng, sigma: config.noise_m, dropout: config.dropout, grass, is_lit }
    }

    /// The next beam's draws, or `None` when its return is lost.
    fn draw(&mut self) -> Option<Drawn> {
        let error = if self.sigma > 0.0 {
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            self.sigma * normal
        } else {
            0.0
        };
        let lost = self.dropout > 0.0 && self.uniform() < self.dropout;
        let blade = if self.grass > 0.0 { self.grass * self.uniform() } else { 0.0 };
        let luck = if self.is_lit { self.uniform() } else { 0.0 };
        (!lost).then_some(Drawn { error, blade, luck })
    }

    /// Uniform in [0, 1).
    fn uniform(&mut self) -> f64 {
        StandardUniform.sample(&mut self.rng)
    }
}

mod spot;
#[cfg(test)]
mod tests;
