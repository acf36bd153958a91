//! Upkeep of the information map: what one more scan costs, what it costs to move one, and the memory both take.

use std::collections::BTreeMap;
use std::time::Instant;

use mirador_core::analysis::{GroundHeight, PointScore, ScoreConfig, ScoreError, Scorer};
use mirador_core::geometry::Pose;
use mirador_core::information_map::{
    Condenser, InformationMap, InsertError, MapConfig, MapConfigError, Reach, ScanEvidence,
};
use mirador_core::scan::{Point, ScanView};
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig, SurfaceError};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

use crate::registration::RegistrationBenchError;
use crate::registration::simulated::{SimulatedDrive, tour_around_a_block};
use crate::{BenchReport, Machine, Provenance, Row, Summary};

/// What is measured, and how often.
#[derive(Debug, Clone, PartialEq)]
pub struct MapOptions {
    /// Worker threads, one row each.
    pub threads: Vec<usize>,
    /// How often the tour is repeated.
    pub repetitions: usize,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self { threads: vec![1, 2], repetitions: 10 }
    }
}

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum MapBenchError {
    /// The simulated drive cannot be had.
    #[error(transparent)]
    Drive(#[from] RegistrationBenchError),
    /// A scan has no surface.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A scan has no scores.
    #[error(transparent)]
    Scores(#[from] ScoreError),
    /// The map's settings are wrong.
    #[error(transparent)]
    Config(#[from] MapConfigError),
    /// A scan cannot be put into the map.
    #[error(transparent)]
    Insert(#[from] InsertError),
}

struct Scored {
    points: Vec<Point>,
    scores: Vec<PointScore>,
    pose: Pose,
}

/// Measures the map over a tour of fifteen simulated scans of 541 x 720 cells around a block of houses.
///
/// # Errors
/// See [`MapBenchError`].
pub fn run(options: &MapOptions) -> Result<BenchReport, MapBenchError> {
    let drive = tour_around_a_block()?;
    let scans = scored(&drive)?;
    let returns: usize = scans.iter().map(|s| s.points.iter().filter(|p| p.is_return()).count()).sum();
    let params = |more: &[(&str, Value)]| {
        let mut params = BTreeMap::from([("returns".to_owned(), json!(returns / scans.len().max(1)))]);
        params.extend(more.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
        params
    };
    let mut rows = Vec::new();
    let mut last = None;
    for &threads in &options.threads {
        let mut parts = [const { Vec::new() }; 3];
        for _ in 0..options.repetitions {
            last = Some(one_tour(&drive, &scans, threads, &mut parts)?);
        }
        for (name, samples) in ["condense", "add", "map"].into_iter().zip(&parts) {
            rows.extend(row(name, params(&[("threads", json!(threads))]), samples, BTreeMap::new()));
        }
    }
    let Some((mut map, evidence)) = last else { return Ok(report(rows)) };
    let known = map.known_cells().count() as f64 * map.cell_m() * map.cell_m();
    let items: usize = evidence.iter().map(|e| e.measured_items() + e.interpolated_items()).sum();
    let bytes: usize = evidence.iter().map(ScanEvidence::bytes).sum();
    let extra = BTreeMap::from([
        ("bytes_per_known_m2".to_owned(), json!(map.bytes() as f64 / known)),
        ("items_per_scan".to_owned(), json!(items / evidence.len().max(1))),
        ("bytes_per_scan".to_owned(), json!(bytes / evidence.len().max(1))),
        ("known_m2".to_owned(), json!(known)),
    ]);
    rows.extend(row("move_scan", params(&[]), &moves(&mut map, &scans, &evidence, options)?, extra));
    rows.extend(row("choose_levels", params(&[]), &choices(&map, &scans), BTreeMap::new()));
    Ok(report(rows))
}

fn scored(drive: &SimulatedDrive) -> Result<Vec<Scored>, MapBenchError> {
    let (mut builder, mut scorer) = (SurfaceBuilder::new(), Scorer::new());
    let mut scans = Vec::new();
    for (k, pose) in drive.truth.iter().enumerate() {
        let mut points = Vec::new();
        drive.scan(k, &mut points)?;
        let mut scores = vec![PointScore::NONE; points.len()];
        let scan = ScanView { points: &points, grid: Some(drive.grid()) };
        let surface = builder.build(scan, &SurfaceConfig { threads: 2, ..SurfaceConfig::default() })?;
        let config = ScoreConfig { threads: 2, ..ScoreConfig::default() };
        let ground = GroundHeight::resolve(&config, scan, surface, &pose.rotation);
        scorer.score(scan, surface, &pose.rotation, ground, &config, &mut scores)?;
        scans.push(Scored { points, scores, pose: *pose });
    }
    Ok(scans)
}

/// The map of a tour and the summaries of its scans; times in ms of condensing, adding, and both.
fn one_tour(
    drive: &SimulatedDrive,
    scans: &[Scored],
    threads: usize,
    [condense, add, both]: &mut [Vec<f64>; 3],
) -> Result<(InformationMap, Vec<ScanEvidence>), MapBenchError> {
    let config = MapConfig::default();
    let mut map = InformationMap::new(config)?;
    let (mut condenser, mut kept) = (Condenser::new(), Vec::new());
    for scan in scans {
        let view = ScanView { points: &scan.points, grid: Some(drive.grid()) };
        let begin = Instant::now();
        let (evidence, _) = condenser.condense(view, &scan.scores, &scan.pose, &config, threads)?;
        let condensed = begin.elapsed();
        map.add(evidence, &scan.pose)?;
        let done = begin.elapsed();
        condense.push(condensed.as_secs_f64() * 1e3);
        add.push((done - condensed).as_secs_f64() * 1e3);
        both.push(done.as_secs_f64() * 1e3);
        kept.push(evidence.clone());
    }
    Ok((map, kept))
}

/// Times in ms of moving scans by a few centimetres and a tenth of a degree, there and back.
fn moves(
    map: &mut InformationMap,
    scans: &[Scored],
    evidence: &[ScanEvidence],
    options: &MapOptions,
) -> Result<Vec<f64>, MapBenchError> {
    let mut samples = Vec::new();
    for _ in 0..options.repetitions {
        for (scan, evidence) in scans.iter().zip(evidence) {
            let there = Pose::new(Vector3::new(0.04, -0.03, 0.01), Vector3::new(0.0, 0.0, 0.0017)) * scan.pose;
            for (from, to) in [(scan.pose, there), (there, scan.pose)] {
                let begin = Instant::now();
                map.move_scan(evidence, &from, &to)?;
                samples.push(begin.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    Ok(samples)
}

/// Times in ms of choosing the levels from where each scan was taken.
fn choices(map: &InformationMap, scans: &[Scored]) -> Vec<f64> {
    let reach = |pose: &Pose| Reach {
        robot: Point3::from(pose.translation.vector - Vector3::new(0.0, 0.0, 1.0)),
        window_m: 100.0,
        start_m: 2.0,
        max_step_m: 0.5,
        navigable_threshold: 0.7,
    };
    let time = |scan: &Scored| {
        let begin = Instant::now();
        std::hint::black_box(map.choose_levels(&reach(&scan.pose)));
        begin.elapsed().as_secs_f64() * 1e3
    };
    scans.iter().map(time).collect()
}

fn row(name: &str, params: BTreeMap<String, Value>, samples: &[f64], extra: BTreeMap<String, Value>) -> Option<Row> {
    let summary = Summary::of(samples)?;
    let provenance = Provenance::Measured;
    Some(Row { name: name.into(), params, unit: "ms".into(), summary, provenance, extra })
}

fn report(rows: Vec<Row>) -> BenchReport {
    BenchReport { bench: "map".into(), machine: Machine::here(), rows }
}
