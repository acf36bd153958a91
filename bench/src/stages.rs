//! The stages by themselves, one after the other in this process: surface, scores, and the upkeep of the information map
//! (what one more scan costs, what it costs to move one, and the memory both take).

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
pub struct StagesOptions {
    /// Worker threads, one row each.
    pub threads: Vec<usize>,
    /// How often the tour is repeated, apart from once for warming up.
    pub repetitions: usize,
}

impl Default for StagesOptions {
    fn default() -> Self {
        Self { threads: vec![1, 2], repetitions: 10 }
    }
}

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum StagesBenchError {
    /// Nothing was asked for.
    #[error("stages bench: {field} = 0: at least 1 is needed")]
    Nothing {
        /// The option.
        field: &'static str,
    },
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

/// The source's figures: row, its size, ms. On a 3 GHz Core 2 Duo, worst case (its Table 6-10).
const LITERATURE: [(&str, &str, f64); 2] = [("surface", "175,270 points", 120.0), ("scores", "147,285 points", 450.0)];

/// Measures the stages over a tour of fifteen simulated scans of 541 x 720 cells around a block of houses.
///
/// # Errors
/// See [`StagesBenchError`].
pub fn run(options: &StagesOptions) -> Result<BenchReport, StagesBenchError> {
    if options.repetitions == 0 || options.threads.is_empty() || options.threads.contains(&0) {
        let field = if options.repetitions == 0 { "repetitions" } else { "threads" };
        return Err(StagesBenchError::Nothing { field });
    }
    let drive = tour_around_a_block()?;
    let mut scans = scans_of(&drive)?;
    let mut first = Vec::new();
    for &threads in &options.threads {
        first.push((threads, surfaces_and_scores(&drive, &mut scans, threads, options.repetitions)?));
    }
    let returns: usize = scans.iter().map(|s| s.points.iter().filter(|p| p.is_return()).count()).sum();
    let params = |more: &[(&str, Value)]| {
        let mut params = BTreeMap::from([("returns".to_owned(), json!(returns / scans.len().max(1)))]);
        params.extend(more.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
        params
    };
    let mut rows = Vec::new();
    for (threads, parts) in &first {
        for (name, samples) in ["surface", "scores"].into_iter().zip(parts) {
            rows.extend(row(name, params(&[("threads", json!(threads))]), samples, BTreeMap::new()));
        }
    }
    rows.extend(LITERATURE.iter().map(|(name, size, ms)| literature(name, size, *ms)));
    let mut last = None;
    for &threads in &options.threads {
        let mut parts = [const { Vec::new() }; 3];
        one_tour(&drive, &scans, threads, &mut [const { Vec::new() }; 3])?;
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

/// The scans of the tour, without scores yet.
fn scans_of(drive: &SimulatedDrive) -> Result<Vec<Scored>, StagesBenchError> {
    let mut scans = Vec::new();
    for (k, pose) in drive.truth.iter().enumerate() {
        let mut points = Vec::new();
        drive.scan(k, &mut points)?;
        let scores = vec![PointScore::NONE; points.len()];
        scans.push(Scored { points, scores, pose: *pose });
    }
    Ok(scans)
}

/// Gives every scan its scores. Times in ms of the surfaces, and of the ground height with the scores.
fn surfaces_and_scores(
    drive: &SimulatedDrive,
    scans: &mut [Scored],
    threads: usize,
    repetitions: usize,
) -> Result<[Vec<f64>; 2], StagesBenchError> {
    let (mut builder, mut scorer) = (SurfaceBuilder::new(), Scorer::new());
    let surface_config = SurfaceConfig { threads, ..SurfaceConfig::default() };
    let config = ScoreConfig { threads, ..ScoreConfig::default() };
    let mut times = [const { Vec::new() }; 2];
    for repetition in 0..=repetitions {
        for Scored { points, scores, pose } in &mut *scans {
            let scan = ScanView::with_grid(points.as_slice(), Some(drive.grid()));
            let begin = Instant::now();
            let surface = builder.build(scan, &surface_config)?;
            let built = begin.elapsed();
            let ground = GroundHeight::resolve(&config, scan, surface, &pose.rotation);
            scorer.score(scan, surface, &pose.rotation, ground, &config, scores)?;
            let done = begin.elapsed();
            if repetition > 0 {
                times[0].push(built.as_secs_f64() * 1e3);
                times[1].push((done - built).as_secs_f64() * 1e3);
            }
        }
    }
    Ok(times)
}

/// The map of a tour and the summaries of its scans; times in ms of condensing, adding, and both.
fn one_tour(
    drive: &SimulatedDrive,
    scans: &[Scored],
    threads: usize,
    [condense, add, both]: &mut [Vec<f64>; 3],
) -> Result<(InformationMap, Vec<ScanEvidence>), StagesBenchError> {
    let config = MapConfig::default();
    let mut map = InformationMap::new(config)?;
    map.set_threads(threads);
    let (mut condenser, mut kept) = (Condenser::new(), Vec::new());
    for scan in scans {
        let view = ScanView::with_grid(&scan.points, Some(drive.grid()));
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
    options: &StagesOptions,
) -> Result<Vec<f64>, StagesBenchError> {
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

fn literature(name: &str, size: &str, ms: f64) -> Row {
    Row {
        name: name.to_owned(),
        params: BTreeMap::from([("source".to_owned(), json!(size))]),
        unit: "ms".into(),
        summary: Summary::single(ms),
        provenance: Provenance::Literature,
        extra: BTreeMap::new(),
    }
}

fn report(rows: Vec<Row>) -> BenchReport {
    BenchReport { bench: "stages".into(), machine: Machine::here(), rows }
}
