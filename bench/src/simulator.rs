//! Speed of the simulator: `mirador bench simulator`.
//!
//! `rays`: rays a second on the triangles of the built-in worlds. `scan`: a full scan of 541 beams by 720 sweeps, ready
//! as points. `physics`: a step of the default robot at full speed. Rays share their origin and come in the scanner's
//! order, as a laser's do.

use std::collections::BTreeMap;
use std::time::Instant;

use mirador_core::scan::Point;
use mirador_core::simulation::{
    CompileError, CompiledScene, Hit, Physics, PhysicsConfig, PhysicsError, Robot, ScanError, ScanSeed, Scanner,
    ScannerConfig, ScannerConfigError, Scene, SceneError,
};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use thiserror::Error;

use crate::{BenchReport, Machine, Provenance, Row, Summary};

/// Steps of the physics measured as one sample.
const STEPS: usize = 200;

/// Why the simulator was not measured.
#[derive(Debug, Error)]
pub enum SimulatorBenchError {
    /// No world of that name.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A world cannot be built.
    #[error(transparent)]
    Compile(#[from] CompileError),
    /// The scanner cannot be built.
    #[error(transparent)]
    Scanner(#[from] ScannerConfigError),
    /// The scanner refused to scan.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The robot cannot stand at the world's start.
    #[error(transparent)]
    Physics(#[from] PhysicsError),
    /// Nothing was measured.
    #[error("repetitions = 0; give 1 or more")]
    NoRepetitions,
}

/// Measures all built-in worlds, `repetitions` times each after one for warming up.
///
/// # Errors
/// When `repetitions` is 0; else only if the simulator refuses its own worlds.
pub fn run(repetitions: usize, say: &mut dyn FnMut(&str)) -> Result<BenchReport, SimulatorBenchError> {
    let mut rows = Vec::new();
    for world in Scene::builtin_names() {
        say(&format!("world {world}"));
        let scene = CompiledScene::new(Scene::builtin(world)?)?;
        let triangles: usize = scene.label_counts().iter().map(|(_, count)| count).sum();
        for threads in [1, 2] {
            rows.push(rays(&scene, threads, repetitions)?.into_row("rays", "1/s", world, triangles, threads));
            for (scanner, config) in [("ideal", ScannerConfig::default()), ("lms111", ScannerConfig::lms111())] {
                let mut row =
                    scan(&scene, config, threads, repetitions)?.into_row("scan", "ms", world, triangles, threads);
                row.params.insert("scanner".into(), json!(scanner));
                rows.push(row);
            }
        }
        rows.push(physics(&scene, repetitions)?.into_row("physics", "us", world, triangles, 1));
    }
    Ok(BenchReport { bench: "simulator".into(), machine: Machine::here(), rows })
}

/// Percentiles of one case.
struct Measured(Summary);

impl Measured {
    fn of(samples: &[f64]) -> Result<Self, SimulatorBenchError> {
        Summary::of(samples).map(Self).ok_or(SimulatorBenchError::NoRepetitions)
    }

    fn into_row(self, name: &str, unit: &str, world: &str, triangles: usize, threads: usize) -> Row {
        let params: [(&str, Value); 3] =
            [("world", json!(world)), ("triangles", json!(triangles)), ("threads", json!(threads))];
        Row {
            name: name.into(),
            params: params.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
            unit: unit.into(),
            summary: self.0,
            provenance: Provenance::Measured,
            extra: BTreeMap::new(),
        }
    }
}

/// Times `work` so often [s], after once for warming up.
fn times<E>(repetitions: usize, mut work: impl FnMut() -> Result<(), E>) -> Result<Vec<f64>, E> {
    work()?;
    let mut times = Vec::with_capacity(repetitions);
    for _ in 0..repetitions {
        let begun = Instant::now();
        work()?;
        times.push(begun.elapsed().as_secs_f64());
    }
    Ok(times)
}

/// Rays a second, the rays shared out in halves.
fn rays(scene: &CompiledScene, threads: usize, repetitions: usize) -> Result<Measured, SimulatorBenchError> {
    let scanner = Scanner::new(ScannerConfig::default())?;
    let grid = scanner.grid();
    let pose = scene.level_scanner_pose(&scene.scene().start, 1.0).unwrap_or_default();
    let cells = (0..grid.rows).flat_map(|row| (0..grid.cols).map(move |col| (row, col)));
    let directions: Vec<Vector3<f64>> =
        cells.filter_map(|(row, col)| scanner.ray(row, col)).map(|ray| pose.rotation * ray).collect();
    let origin = Point3::from(pose.translation.vector);
    let mut hits: Vec<Option<Hit>> = vec![None; directions.len()];
    let part = directions.len().div_ceil(threads).max(1);
    let times = times(repetitions, || {
        std::thread::scope(|scope| {
            for (directions, hits) in directions.chunks(part).zip(hits.chunks_mut(part)) {
                scope.spawn(|| scene.cast_all(&origin, directions, 50.0, hits));
            }
        });
        Ok::<_, SimulatorBenchError>(())
    })?;
    Measured::of(&times.iter().map(|time| directions.len() as f64 / time).collect::<Vec<_>>())
}

/// Milliseconds of a full scan.
fn scan(
    scene: &CompiledScene,
    config: ScannerConfig,
    threads: usize,
    repetitions: usize,
) -> Result<Measured, SimulatorBenchError> {
    let scanner = Scanner::new(config)?;
    let pose = scene.level_scanner_pose(&scene.scene().start, 1.0).unwrap_or_default();
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    let mut number = 0;
    let times = times(repetitions, || {
        number += 1;
        scanner.scan(scene, &pose, ScanSeed { seed: 1, scan: number }, threads, &mut points, None)
    })?;
    Measured::of(&times.iter().map(|time| 1e3 * time).collect::<Vec<_>>())
}

/// Microseconds of a step of the physics, the robot driving in circles.
fn physics(scene: &CompiledScene, repetitions: usize) -> Result<Measured, SimulatorBenchError> {
    let robot = Robot { start: scene.scene().start, ..Robot::default() };
    let mut physics = Physics::new(scene, &[robot], PhysicsConfig::default())?;
    physics.drive(0, 0.3, 0.5);
    let times = times(repetitions, || {
        for _ in 0..STEPS {
            physics.step();
        }
        Ok::<_, SimulatorBenchError>(())
    })?;
    Measured::of(&times.iter().map(|time| 1e6 * time / STEPS as f64).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_world_has_its_rows_and_no_repetition_is_refused() {
        let report = run(1, &mut |_| ()).unwrap();
        for world in Scene::builtin_names() {
            assert_eq!(report.find("rays", &[("world", json!(world))]).len(), 2, "{world}");
            assert_eq!(report.find("scan", &[("world", json!(world)), ("threads", json!(2))]).len(), 2);
            assert_eq!(report.find("physics", &[("world", json!(world))]).len(), 1);
        }
        assert!(report.rows.iter().all(|row| row.summary.p50 > 0.0));
        assert!(matches!(run(0, &mut |_| ()), Err(SimulatorBenchError::NoRepetitions)));
    }
}
