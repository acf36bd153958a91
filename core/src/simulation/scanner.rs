//! The source's scanner (section 5.3): a planar laser that sweeps a vertical plane while the head turns about z.

use std::sync::{Mutex, PoisonError};

use nalgebra::{Point3, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::compiled_scene::CompiledScene;
use super::scene::Label;
use crate::geometry::Pose;
use crate::scan::{Grid, Point};

/// Lines of the grid a thread takes at a time: small enough to share the work evenly, large enough to amortise it.
const LINES_A_BLOCK: usize = 8;

/// The scanner's geometry and errors. The default is the source's: a SICK LMS111 with 541 beams over 270 deg every
/// 0.5 deg, range 50 m, 1 m over the ground, 720 sweeps a turn.
///
/// The fan lies in a vertical plane with its blind 90 deg downwards: beam angles run from -45 deg ahead of the head over
/// the zenith (90 deg) to 225 deg, that is -45 deg behind it. In a full turn every direction is therefore seen twice,
/// half a turn apart, which is what brings the 389,520 cells to the 150,000 to 180,000 returns the source reports
/// outdoors. Ground is seen from a distance of one scanner height on.
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
        }
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
    /// Cosine and sine of the azimuth by which it lags behind the first beam of its sweep.
    lag_cos: f64,
    lag_sin: f64,
    /// When it is fired, in sweeps after the first beam of its sweep.
    after: f64,
}

/// Some lines of the grid and where their points go.
struct Block<'a> {
    first_row: usize,
    points: &'a mut [Point],
    labels: Option<&'a mut [Option<Label>]>,
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
        ];
        match checks.into_iter().find(|(holds, ..)| !holds) {
            None => Ok(()),
            Some((_, field, value, allowed)) => Err(ScannerConfigError::OutOfRange { field, value, allowed }),
        }
    }

    /// The same scanner without noise and dropouts: what it gives is the truth.
    #[must_use]
    pub fn noise_free(&self) -> Self {
        Self { noise_m: 0.0, dropout: 0.0, ..self.clone() }
    }
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
                let lag = if config.turns_while_sweeping { after * step } else { 0.0 };
                let (lag_sin, lag_cos) = lag.sin_cos();
                Beam { cos, sin, lag_cos, lag_sin, after }
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
    /// The bits depend on neither their number nor their pace. Intensity is 0, which means unknown.
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
        let queue = Mutex::new(blocks);
        let work = || {
            loop {
                let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some(block) = next else { return };
                self.scan_block(scene, map_from_scanner, seed, block);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..threads {
                // Where the system refuses a thread, the others do its share.
                if std::thread::Builder::new().spawn_scoped(scope, work).is_err() {
                    break;
                }
            }
            work();
        });
        Ok(())
    }

    fn scan_block(&self, scene: &CompiledScene, map_from_scanner: &Pose, seed: ScanSeed, block: Block<'_>) {
        let Block { first_row, points, mut labels } = block;
        for (k, line) in points.chunks_mut(self.config.beams).enumerate() {
            let first = k * self.config.beams;
            let line_labels = labels.as_mut().and_then(|labels| labels.get_mut(first..first + line.len()));
            self.scan_sweep(scene, map_from_scanner, seed, first_row + k, line, line_labels);
        }
    }

    /// One sweep. Its errors come from a generator of its own, and every beam draws, hit or not.
    fn scan_sweep(
        &self,
        scene: &CompiledScene,
        map_from_scanner: &Pose,
        seed: ScanSeed,
        sweep: usize,
        points: &mut [Point],
        mut labels: Option<&mut [Option<Label>]>,
    ) {
        let mut errors = Errors::new(&self.config, seed, sweep);
        let origin = Point3::from(map_from_scanner.translation.vector);
        let map_from_scanner = map_from_scanner.rotation.to_rotation_matrix();
        let head = self.head(sweep);
        for (b, (beam, point)) in self.beams.iter().zip(points).enumerate() {
            let ray = beam.ray(head);
            let error = errors.draw();
            let hit = scene.cast(&origin, &(map_from_scanner * ray), self.config.range_max_m);
            let measured = hit.zip(error).map(|(hit, error)| (hit.range + error, hit.label));
            let limits = self.config.range_min_m..=self.config.range_max_m;
            let measured = measured.filter(|(range, _)| limits.contains(range));
            *point = measured.map_or(Point::EMPTY, |(range, _)| {
                let at = (range * ray).cast::<f32>();
                Point { time: self.time(sweep, beam), ..Point::new(at.x, at.y, at.z) }
            });
            if let Some(label) = labels.as_mut().and_then(|labels| labels.get_mut(b)) {
                *label = measured.map(|(_, label)| label);
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

impl Beam {
    /// The unit ray in the scanner's frame when the first beam of its sweep has this azimuth (cosine, sine).
    fn ray(&self, head: (f64, f64)) -> Vector3<f64> {
        let cos = head.0 * self.lag_cos - head.1 * self.lag_sin;
        let sin = head.1 * self.lag_cos + head.0 * self.lag_sin;
        Vector3::new(self.cos * cos, self.cos * sin, self.sin)
    }
}

/// The range errors of one sweep.
struct Errors {
    rng: ChaCha8Rng,
    sigma: f64,
    dropout: f64,
}

impl Errors {
    fn new(config: &ScannerConfig, seed: ScanSeed, sweep: usize) -> Self {
        // Run and scan are the generator's key and the sweep is its stream: no two sweeps of any run share draws.
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.seed.to_le_bytes());
        key[8..16].copy_from_slice(&seed.scan.to_le_bytes());
        let mut rng = ChaCha8Rng::from_seed(key);
        rng.set_stream(sweep as u64);
        Self { rng, sigma: config.noise_m, dropout: config.dropout }
    }

    /// The error of the next beam's range [m], or `None` when its return is lost.
    fn draw(&mut self) -> Option<f64> {
        let error = if self.sigma > 0.0 {
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            self.sigma * normal
        } else {
            0.0
        };
        let lost = self.dropout > 0.0 && {
            let uniform: f64 = StandardUniform.sample(&mut self.rng);
            uniform < self.dropout
        };
        (!lost).then_some(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{ScanPose, Scene};

    const SEED: ScanSeed = ScanSeed { seed: 3, scan: 1 };

    fn world(tail: &str) -> CompiledScene {
        let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-20, 20], y_m = [-20, 20] }\n";
        CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "test").unwrap())
    }

    /// One turn of 72 sweeps with 28 beams from -45 to 225 deg.
    fn coarse() -> ScannerConfig {
        ScannerConfig { beam_step_deg: 10.0, beams: 28, sweeps: 72, ..ScannerConfig::default() }
    }

    fn pose(world: &CompiledScene, x: f64, y: f64, yaw: f64) -> Pose {
        world.level_scanner_pose(&ScanPose { x, y, yaw }, 1.0).unwrap()
    }

    fn scan(config: ScannerConfig, world: &CompiledScene, pose: &Pose, seed: ScanSeed, threads: usize) -> Vec<Point> {
        let scanner = Scanner::new(config).unwrap();
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        scanner.scan(world, pose, seed, threads, &mut points, None).unwrap();
        points
    }

    fn bits(points: &[Point]) -> Vec<u8> {
        bytemuck::cast_slice(points).to_vec()
    }

    #[test]
    fn the_default_scanner_is_the_source_s() {
        let scanner = Scanner::new(ScannerConfig::default()).unwrap();
        assert_eq!(scanner.grid(), Grid { rows: 720, cols: 541 });
        let first = scanner.ray(360, 0).unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((first - Vector3::new(half, 0.0, -half)).norm() < 1e-12, "{first}");
        let zenith = scanner.ray(5, 270).unwrap();
        assert!((zenith - Vector3::z()).norm() < 1e-12, "{zenith}");
        assert_eq!(scanner.ray(720, 0), None);
        assert_eq!(scanner.ray(0, 541), None);
    }

    #[test]
    fn neighbouring_cells_are_neighbours_in_direction() {
        let scanner = Scanner::new(ScannerConfig::default()).unwrap();
        for sweep in (0..719).step_by(37) {
            for beam in 0..540 {
                let ray = scanner.ray(sweep, beam).unwrap();
                let step = 0.502f64.to_radians();
                assert!((ray.norm() - 1.0).abs() < 1e-12);
                assert!(ray.angle(&scanner.ray(sweep, beam + 1).unwrap()) < step);
                assert!(ray.angle(&scanner.ray(sweep + 1, beam).unwrap()) < step);
            }
        }
    }

    #[test]
    fn the_number_of_threads_does_not_change_a_bit_and_the_seed_does() {
        let world = CompiledScene::new(Scene::builtin("simple").unwrap());
        let pose = pose(&world, -9.0, -10.0, 0.3);
        let config = ScannerConfig { dropout: 0.02, ..coarse() };
        let one = bits(&scan(config.clone(), &world, &pose, SEED, 1));
        for threads in [0, 2, 3] {
            assert_eq!(one, bits(&scan(config.clone(), &world, &pose, SEED, threads)));
        }
        assert_ne!(one, bits(&scan(config.clone(), &world, &pose, ScanSeed { seed: 4, ..SEED }, 1)));
        assert_ne!(one, bits(&scan(config, &world, &pose, ScanSeed { scan: 2, ..SEED }, 1)));
    }

    #[test]
    fn points_without_noise_lie_on_the_surface_their_label_names() {
        let tail = "terrain = { slope_x_deg = 3, margin_m = 40 }\n\
                    [[box]]\nlabel = \"wall\"\nx_m = 6\ny_m = 0\nz_m = -2\nlength_m = 2\nwidth_m = 8\nheight_m = 6\n";
        let world = world(tail);
        let map_from_scanner = pose(&world, 1.0, 2.0, 0.7);
        let config = ScannerConfig { beam_step_deg: 1.0, beams: 271, sweeps: 180, ..ScannerConfig::default() };
        let scanner = Scanner::new(config.noise_free()).unwrap();
        let mut points = vec![Point::EMPTY; scanner.grid().cells()];
        let mut labels = vec![None; points.len()];
        scanner.scan(&world, &map_from_scanner, SEED, 2, &mut points, Some(&mut labels)).unwrap();
        let mut seen = [0; 2];
        for (point, label) in points.iter().zip(&labels) {
            assert_eq!(point.is_return(), label.is_some());
            let Some(label) = label else { continue };
            let p = map_from_scanner * point.position();
            let off_plane = (p.z - p.x * 3.0f64.to_radians().tan()) * 3.0f64.to_radians().cos();
            let (dx, dy, dz) = ((p.x - 6.0).abs() - 1.0, p.y.abs() - 4.0, (p.z - 1.0).abs() - 3.0);
            let off_box = dx.max(dy).max(dz);
            match label {
                Label::Ground => assert!(off_plane.abs() < 1e-3 && off_box > -1e-3, "{p}"),
                Label::Wall => assert!(off_box.abs() < 1e-3 && off_plane > -1e-3, "{p}"),
                other => panic!("there is no {other} in this scene"),
            }
            assert!(point.range() <= 50.0);
            seen[usize::from(*label == Label::Wall)] += 1;
        }
        assert!(seen[0] > 5000 && seen[1] > 500, "{seen:?}");
        let empty = points.iter().filter(|p| !p.is_return()).count();
        assert!(empty > points.len() / 3, "the sky gives no returns: {empty}");
    }

    #[test]
    fn a_noise_free_scan_has_the_true_ranges() {
        let world = CompiledScene::new(Scene::builtin("plane").unwrap());
        let map_from_scanner = pose(&world, 0.0, 0.0, 0.2);
        let scanner = Scanner::new(coarse().noise_free()).unwrap();
        let points = scan(coarse().noise_free(), &world, &map_from_scanner, SEED, 1);
        for (index, point) in points.iter().enumerate() {
            let range = scanner.true_range(&world, &map_from_scanner, index / 28, index % 28);
            assert_eq!(range.is_some(), point.is_return());
            assert!(range.is_none_or(|range| (range - f64::from(point.range())).abs() < 1e-4));
        }
    }

    #[test]
    fn noise_has_the_asked_spread_along_the_ray_and_no_bias() {
        let world = world("");
        let pose = pose(&world, 0.0, 0.0, 0.0);
        let config = ScannerConfig { noise_m: 0.02, first_beam_deg: -45.0, beam_step_deg: 1.0, beams: 30, ..coarse() };
        let truth = scan(config.noise_free(), &world, &pose, SEED, 1);
        let noisy = scan(config, &world, &pose, SEED, 1);
        let errors: Vec<_> = truth.iter().zip(&noisy).map(|(t, n)| f64::from(n.range() - t.range())).collect();
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let sigma = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!(mean.abs() < 4.0 * 0.02 / n.sqrt(), "{mean}");
        assert!((sigma - 0.02).abs() < 0.0015, "{sigma}");
        assert!(truth.iter().zip(&noisy).all(|(t, n)| t.vector().normalize().dot(&n.vector().normalize()) > 0.999_999));
    }

    #[test]
    fn dropouts_empty_the_asked_share_of_cells() {
        let world = world("");
        let pose = pose(&world, 0.0, 0.0, 0.0);
        let config = ScannerConfig { first_beam_deg: -45.0, beam_step_deg: 1.0, beams: 30, ..coarse() };
        let lost = scan(ScannerConfig { dropout: 0.25, ..config.clone() }, &world, &pose, SEED, 1);
        let share = lost.iter().filter(|p| !p.is_return()).count() as f64 / lost.len() as f64;
        assert!((share - 0.25).abs() < 0.04, "{share}");
        assert!(scan(ScannerConfig { dropout: 1.0, ..config }, &world, &pose, SEED, 1).iter().all(|p| !p.is_return()));
    }

    #[test]
    fn nothing_outside_the_ranges_gives_a_return() {
        let world = world("terrain = { margin_m = 100 }\n");
        let pose = pose(&world, 0.0, 0.0, 0.0);
        let config = ScannerConfig {
            range_min_m: 2.0,
            range_max_m: 12.0,
            noise_m: 0.5,
            beam_step_deg: 0.5,
            beams: 90,
            ..coarse()
        };
        let points = scan(config, &world, &pose, SEED, 1);
        let returns: Vec<_> = points.iter().filter(|p| p.is_return()).map(Point::range).collect();
        assert!(!returns.is_empty() && returns.len() < points.len());
        assert!(returns.iter().all(|range| (1.9999..12.0001).contains(range)));
    }

    #[test]
    fn time_runs_from_the_first_beam_to_the_last() {
        let world = world("[[sphere]]\nlabel = \"other\"\nx_m = 0\ny_m = 0\nz_m = -9\nradius_m = 10\n");
        // The scanner stands within a closed sphere, so every beam returns.
        let points = scan(coarse(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 1);
        assert!(points.iter().all(Point::is_return));
        assert_eq!(points[0].time, 0);
        assert_eq!(points[points.len() - 1].time, 65535);
        assert!(points.windows(2).all(|pair| pair[0].time < pair[1].time));
    }

    #[test]
    fn slices_of_the_wrong_length_are_refused() {
        let world = world("");
        let scanner = Scanner::new(coarse()).unwrap();
        let pose = pose(&world, 0.0, 0.0, 0.0);
        let mut points = vec![Point::EMPTY; 28 * 72];
        let short = scanner.scan(&world, &pose, SEED, 1, &mut points[1..], None);
        assert_eq!(short, Err(ScanError::WrongPoints { cells: 2016, given: 2015 }));
        let labels = scanner.scan(&world, &pose, SEED, 1, &mut points, Some(&mut [None; 5]));
        assert_eq!(labels, Err(ScanError::WrongLabels { cells: 2016, given: 5 }));
    }

    #[test]
    fn a_field_out_of_range_is_named_with_its_range() {
        let message = |config: ScannerConfig| config.validate().unwrap_err().to_string();
        let text = message(ScannerConfig { dropout: 1.5, ..coarse() });
        assert_eq!(text, "scanner.dropout = 1.5 is out of range: must lie in 0 ..= 1");
        assert!(message(ScannerConfig { noise_m: f64::NAN, ..coarse() }).contains("noise_m"));
        assert!(message(ScannerConfig { beams: 40, ..coarse() }).contains("the fan"));
        assert!(message(ScannerConfig { range_max_m: 0.05, ..coarse() }).contains("range_max_m"));
    }

    #[test]
    fn a_config_is_written_as_toml_and_read_back() {
        let text = toml::to_string(&coarse()).unwrap();
        assert_eq!(toml::from_str::<ScannerConfig>(&text).unwrap(), coarse());
        assert!(toml::from_str::<ScannerConfig>("beems = 3").is_err());
    }
}
