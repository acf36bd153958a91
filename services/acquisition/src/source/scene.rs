//! Scans of a scene by the ray-cast scanner.

use mirador_core::geometry::Pose;
use mirador_core::scan::Point;
use mirador_core::simulation::{CompiledScene, ScanSeed, Scanner, Scene};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};

use super::{ScanInfo, Source, SourceError, Written, limited, prior_at};
use crate::AcquisitionConfig;

/// Time between two scans of a tour: driving there and one turn of the head [ns].
const STEP_NS: i64 = 30_000_000_000;
/// One turn of the head at 50 sweeps a second: 720 sweeps take 14.4 s [ns a sweep].
const SWEEP_NS: u64 = 20_000_000;
/// Width of the robot's stance: over this square the ground's slope tilts it [m].
const STANCE_M: f64 = 0.8;

/// The tour of a scene's poses.
pub(super) struct SceneSource {
    scene: CompiledScene,
    scanner: Scanner,
    truth: Vec<Pose>,
    priors: Vec<Pose>,
    seed: u64,
    threads: usize,
}

/// The scene a configuration names: a built-in one, or a file.
///
/// # Errors
/// When there is none of that name, or the file is wrong.
pub fn scene_of(config: &AcquisitionConfig) -> Result<Scene, SourceError> {
    let fail = |e: mirador_core::simulation::SceneError| SourceError::Scene(e.to_string());
    if config.scene.ends_with(".toml") {
        Scene::load(config.scene.as_ref()).map_err(fail)
    } else {
        Scene::builtin(&config.scene).map_err(fail)
    }
}

impl SceneSource {
    pub(super) fn open(config: &AcquisitionConfig, threads: usize) -> Result<Self, SourceError> {
        let scene = scene_of(config)?;
        let scanner = Scanner::new(config.scanner.clone()).map_err(|e| SourceError::Scene(e.to_string()))?;
        let scene = CompiledScene::new(scene).map_err(|e| SourceError::Scene(e.to_string()))?;
        let mut truth = Vec::new();
        for round in 0..config.rounds {
            let tour = &scene.scene().poses;
            // Back and forth, so that the robot never jumps from the last pose to the first.
            let order: Box<dyn Iterator<Item = _>> =
                if round % 2 == 0 { Box::new(tour.iter()) } else { Box::new(tour.iter().rev()) };
            for pose in order {
                let pose = scene.leaning_scanner_pose(pose, config.scanner.height_m, STANCE_M).ok_or_else(|| {
                    SourceError::Scene(format!("{}: pose ({}, {}) is not on the terrain", config.scene, pose.x, pose.y))
                })?;
                truth.push(pose);
            }
        }
        truth.truncate(limited(truth.len(), config));
        if truth.is_empty() {
            return Err(SourceError::Scene(format!("{}: the scene has no [[poses]] to scan from", config.scene)));
        }
        let priors = odometry(&truth, config);
        Ok(Self { scene, scanner, truth, priors, seed: config.seed, threads })
    }
}

/// Dead reckoning along the true poses: every step's translation and heading get an error, which adds up. Roll and
/// pitch come from an inertial unit, which does not drift.
fn odometry(truth: &[Pose], config: &AcquisitionConfig) -> Vec<Pose> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(u64::MAX);
    let mut draw = |sigma: f64| Normal::new(0.0, sigma).map_or(0.0, |n| n.sample(&mut rng));
    let mut priors: Vec<Pose> = Vec::with_capacity(truth.len());
    for (index, pose) in truth.iter().enumerate() {
        let (Some(last_truth), Some(last)) = (index.checked_sub(1).and_then(|i| truth.get(i)), priors.last()) else {
            priors.push(*pose);
            continue;
        };
        let step = last_truth.inverse() * pose;
        let sigma = config.odometry_noise * step.translation.vector.norm();
        let error = Pose::from_parts(
            Translation3::new(draw(sigma), draw(sigma), draw(sigma * 0.2)),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), draw(config.odometry_noise_deg.to_radians())),
        );
        priors.push(last * step * error);
    }
    priors
}

impl Source for SceneSource {
    fn describe(&self) -> String {
        format!("{} scans of scene '{}'", self.truth.len(), self.scene.scene().name)
    }

    fn scans(&self) -> usize {
        self.truth.len()
    }

    fn info(&self, index: usize) -> Option<ScanInfo> {
        let prior = prior_at(self.priors.get(index)?);
        let stamp_ns = i64::try_from(index).unwrap_or(0).saturating_mul(STEP_NS);
        Some(ScanInfo { cells: self.scanner.grid().cells(), stamp_ns, prior: Some(prior) })
    }

    fn write(&mut self, index: usize, out: &mut [Point]) -> Result<Written, SourceError> {
        let scans = self.truth.len();
        let pose = self.truth.get(index).ok_or(SourceError::NoSuchScan { index, scans })?;
        let seed = ScanSeed { seed: self.seed, scan: index as u64 };
        self.scanner
            .scan(&self.scene, pose, seed, self.threads, out, None)
            .map_err(|e| SourceError::Scene(e.to_string()))?;
        let duration_ns = self.scanner.grid().rows as u64 * SWEEP_NS;
        Ok(Written { origin: [0.0; 3], grid: Some(self.scanner.grid()), duration_ns, filtered: None })
    }
}

/// The true poses of a configuration's tour, map_from_scanner.
///
/// # Errors
/// As for opening the source.
pub fn true_poses(config: &AcquisitionConfig) -> Result<Vec<Pose>, SourceError> {
    Ok(SceneSource::open(config, 1)?.truth)
}
