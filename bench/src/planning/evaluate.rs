//! `evaluate_candidates` rows: the time of a plan on the map of a drive through a simulated town, as it grows.

use std::collections::BTreeMap;

use mirador_core::information_map::InformationMap;
use mirador_core::scan::ScanView;
use mirador_core::simulation::ScannerConfig;
use mirador_core::view_planning::{PlanningConfig, Situation, StrategyRegistry, ViewPlan, Weights, Workspace};
use serde_json::{Value, json};

use super::{PlanningBenchError, PlanningOptions};
use crate::exploration::{Mapper, coarser, planning_config, situation, timed_plan};
use crate::registration::town_drive;
use crate::{Provenance, Row, Summary};

/// Candidates of the source's figure.
const CANDIDATES: usize = 113;
/// Scans of the source's figure.
const SCANS: usize = 40;
/// Seed of the candidates.
const SEED: u64 = 7;

/// The source's figure, on two cores at 3 GHz.
pub(super) fn literature() -> Row {
    let ms = 15_330.0;
    Row {
        name: "evaluate_candidates".into(),
        params: params("source (C++, 2 x 3 GHz)", CANDIDATES, SCANS, 2, "0.5 deg"),
        unit: "ms".into(),
        summary: Summary::single(ms),
        provenance: Provenance::Literature,
        extra: BTreeMap::from([("source".to_owned(), json!("the source's Table 6-10, worst case on a Core 2 Duo"))]),
    }
}

fn params(strategy: &str, candidates: usize, scans: usize, threads: usize, step: &str) -> BTreeMap<String, Value> {
    BTreeMap::from([
        ("strategy".to_owned(), json!(strategy)),
        ("candidates".into(), json!(candidates)),
        ("scans_in_map".into(), json!(scans)),
        ("threads".into(), json!(threads)),
        ("scanner".into(), json!(step)),
    ])
}

/// One contestant: a strategy that plans after every scan, and what it took.
struct Contestant {
    strategy: String,
    threads: usize,
    workspace: Workspace,
    ms: Vec<f64>,
    last: Option<ViewPlan>,
}

/// Rows of every strategy after forty scans of the source's scanner, and of some special plans.
pub(super) fn rows(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, PlanningBenchError> {
    let mut names: Vec<(String, usize)> = registry.names().map(|name| (name.to_owned(), 2)).collect();
    names.push(("multi_criteria".into(), 1));
    say("evaluate_candidates: 40 scans of the source's scanner");
    drive(options, registry, ScannerConfig::default(), "0.5 deg", &[SCANS], &names, say)
}

/// Rows as the map grows, at two threads, with a coarse scanner.
pub(super) fn growth(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, PlanningBenchError> {
    let sizes: Vec<usize> = [40, 400, 4000].into_iter().filter(|&size| size <= options.growth_scans).collect();
    let names = ["multi_criteria", "coverage_tour"].map(|name| (name.to_owned(), 2));
    drive(options, registry, coarser(&ScannerConfig::default(), 4), "2 deg", &sizes, &names, say)
}

/// Drives through the town and times the plans of the last scans before each size, each on a map that has just grown by a
/// scan, as in the service.
fn drive(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    scanner: ScannerConfig,
    step: &str,
    sizes: &[usize],
    names: &[(String, usize)],
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, PlanningBenchError> {
    let Some(&most) = sizes.last() else { return Ok(Vec::new()) };
    let names: Vec<_> = names.iter().filter(|(name, _)| options.wants(name)).collect();
    let config = PlanningConfig { max_candidates: CANDIDATES, ..planning_config(&scanner) };
    let drive = town_drive(most, scanner.clone())?;
    let mut mapper = Mapper::new(&scanner, 2)?;
    let mut contestants: Vec<Contestant> = names
        .iter()
        .map(|(name, threads)| Contestant {
            strategy: name.clone(),
            threads: *threads,
            workspace: Workspace::new(),
            ms: Vec::new(),
            last: None,
        })
        .collect();
    let (mut points, mut rows) = (Vec::new(), Vec::new());
    for (k, pose) in drive.truth.iter().enumerate() {
        drive.scan(k, &mut points)?;
        mapper.take_in(ScanView::with_grid(&points, Some(drive.grid())), pose)?;
        // As in the service: where the robot has driven, it can drive.
        if let Some(before) = k.checked_sub(1).and_then(|k| drive.truth.get(k)) {
            mapper.map.drove(&[before, pose].map(|at| [at.translation.x, at.translation.y]));
        }
        let scans = k + 1;
        if scans % 500 == 0 {
            say(&format!("growth: {scans} of {most} scans"));
        }
        let Some(&size) = sizes.iter().find(|&&size| scans <= size && scans + options.repetitions >= size) else {
            continue;
        };
        for contestant in &mut contestants {
            let situation = Situation { threads: contestant.threads, ..situation(pose, scanner.height_m, k, SEED) };
            let mut strategy = registry.create(&contestant.strategy)?;
            let config = PlanningConfig { strategy: contestant.strategy.clone(), ..config.clone() };
            let (plan, ms) = timed_plan(strategy.as_mut(), &mut contestant.workspace, &mapper.map, &situation, &config);
            // The first one of each size reads all of the window anew.
            let is_first = contestant.ms.is_empty() && contestant.last.is_none();
            if !is_first {
                contestant.ms.push(ms);
            }
            contestant.last = Some(plan);
            if scans == size {
                let known = known_cells_near(&mapper.map, &situation, &config);
                rows.extend(row(contestant, &config, size, step, known, mapper.map.bytes()));
                if contestant.strategy == "multi_criteria" && contestant.threads == 2 {
                    rows.extend(special_rows(options, registry, &mapper, &situation, &config, step, size)?);
                }
                (contestant.ms, contestant.last) = (Vec::new(), None);
            }
        }
    }
    Ok(rows)
}

/// Known cells that a plan looks at: within the reach of candidates and the scanner's range around it.
fn known_cells_near(map: &InformationMap, situation: &Situation, config: &PlanningConfig) -> usize {
    let robot = situation.map_from_robot.translation.vector;
    let reach_m = config.near_m + config.scanner.range_m;
    let is_near = |[x, y]: [f64; 2]| (x - robot.x).abs() <= reach_m && (y - robot.y).abs() <= reach_m;
    map.known_cells().filter(|(index, _)| is_near(map.centre_of(*index))).count()
}

fn row(
    contestant: &Contestant,
    config: &PlanningConfig,
    scans: usize,
    step: &str,
    known: usize,
    map_bytes: usize,
) -> Option<Row> {
    let plan = contestant.last.as_ref()?;
    let summary = Summary::of(&contestant.ms)?;
    let p50 = summary.p50;
    let cell_m = 0.3;
    let in_range = std::f64::consts::PI * (config.scanner.range_m / cell_m).powi(2) * plan.candidates.len() as f64;
    let seen: f64 =
        plan.candidates.iter().map(|c| f64::from(c.raw.unexplored_cells) + f64::from(c.raw.known_cells)).sum();
    Some(Row {
        name: "evaluate_candidates".into(),
        params: params(&contestant.strategy, plan.candidates.len(), scans, contestant.threads, step),
        unit: "ms".into(),
        summary,
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("cells_per_second".to_owned(), json!((in_range / (p50 / 1e3)).round())),
            ("cells_seen".into(), json!(seen)),
            ("navigable_cells".into(), json!(plan.navigable_cells)),
            ("known_cells".into(), json!(known)),
            ("ns_per_known_cell".into(), json!((1e6 * p50 / known as f64).round())),
            ("bytes".into(), json!(contestant.workspace.bytes())),
            ("map_bytes".into(), json!(map_bytes)),
            ("reachable_cells".into(), json!(plan.reachable_cells)),
            ("decision".into(), json!(plan.decision)),
        ]),
    })
}

/// A plan that has nothing from an earlier one, and plans asked for again with other weights.
fn special_rows(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    mapper: &Mapper,
    situation: &Situation,
    config: &PlanningConfig,
    step: &str,
    scans: usize,
) -> Result<Vec<Row>, PlanningBenchError> {
    let mut strategy = registry.create("multi_criteria")?;
    let (mut cold, mut weighed, mut candidates) = (Vec::new(), Vec::new(), 0);
    for k in 0..options.repetitions {
        let mut workspace = Workspace::new();
        let (plan, ms) = timed_plan(strategy.as_mut(), &mut workspace, &mapper.map, situation, config);
        cold.push(ms);
        candidates = plan.candidates.len();
        let weights = Weights { information: 0.1 + 0.001 * k as f64, quality: 0.7, zones: 0.2, cost: 0.09 };
        let config = PlanningConfig { weights, ..config.clone() };
        weighed.push(timed_plan(strategy.as_mut(), &mut workspace, &mapper.map, situation, &config).1);
    }
    let row = |name: &str, ms: &[f64]| {
        Some(Row {
            name: name.into(),
            params: params("multi_criteria", candidates, scans, 2, step),
            unit: "ms".into(),
            summary: Summary::of(ms)?,
            provenance: Provenance::Measured,
            extra: BTreeMap::new(),
        })
    };
    Ok(row("first_plan", &cold).into_iter().chain(row("other_weights", &weighed)).collect())
}
