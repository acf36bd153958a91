//! `mirador bench pipeline`: a scene through the real processes, and where the time went.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use mirador_acquisition::SourceKind;
use mirador_bench::{BenchReport, Machine, Provenance, Row, Summary};
use mirador_ipc_schema::messages::{Delay, WorkSpan};
use serde_json::{Value, json};

use super::session::{Session, load_graph};
use crate::cli::{BenchPipelineArgs, Common};
use crate::outputs::{GAPS, PARTS, RunData, STAGES, ScanRecord, ScanUsage, ServiceWork, Timeline, chrome_trace};
use crate::{Registry, UsageError};

/// The source's figures: stage, its size, ms. On a 3 GHz Core 2 Duo, worst case (its Table 6-10).
const LITERATURE: [(&str, &str, f64); 5] = [
    ("surface", "175,270 points", 120.0),
    ("alignment", "pair and loop over 15 scans", 8500.0),
    ("analysis", "147,285 points", 450.0),
    ("planning", "113 candidates after 40 scans", 15_330.0),
    ("end_to_end", "sum of the stages", 24_400.0),
];

/// Runs the graph and reports.
///
/// # Errors
/// When the graph cannot run, or did not come to its end.
pub fn measure(common: &Common, args: &BenchPipelineArgs, registry: &Registry) -> Result<BenchReport> {
    let mut graph = load_graph(common, None, registry)?;
    if graph.acquisition.source != SourceKind::Scene {
        return Err(UsageError("bench pipeline measures in a scene: set acquisition.source = \"scene\"".into()).into());
    }
    if graph.services.recorder.is_none() {
        return Err(UsageError("bench pipeline reads what was recorded: add [services.recorder]".into()).into());
    }
    if args.scans == 0 {
        return Err(UsageError("--scans 0: at least one scan must be measured".into()).into());
    }
    let total = args.after.saturating_add(args.scans);
    graph.acquisition.rounds = total;
    graph.acquisition.max_scans = total;
    let (scene, cells) =
        (graph.acquisition.scene.clone(), graph.acquisition.scanner.beams * graph.acquisition.scanner.sweeps);
    let folder = tempfile::tempdir().context("a temporary folder cannot be made")?;
    let out = common.out.clone().unwrap_or_else(|| folder.path().join("run"));
    let title = format!("Pipeline in {scene}");
    let data = Session { common, graph, out, truth: None, title }.record()?;
    if let Some(path) = &args.trace {
        let trace = chrome_trace(&data, args.after).to_string();
        std::fs::write(path, trace).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    let rows = rows(&data, args.after, &json!(cells))?;
    Ok(BenchReport { bench: "pipeline".into(), machine: Machine::here(), rows })
}

/// The rows of the scans from number `after` on.
fn rows(data: &RunData, after: u32, cells: &Value) -> Result<Vec<Row>> {
    let scans: Vec<&ScanRecord> = data.scans.iter().filter(|scan| scan.number() >= after).collect();
    let timelines: Vec<Timeline> = scans.iter().filter_map(|scan| Timeline::of(scan)).collect();
    let Some(returns) = Summary::of(&scans.iter().map(|s| f64::from(s.scan.returns)).collect::<Vec<_>>()) else {
        bail!("no scan came through");
    };
    let params = BTreeMap::from([
        ("points".to_owned(), json!(returns.p50 as u64)),
        ("cells".into(), cells.clone()),
        ("scans_in_map".into(), json!(after)),
    ]);
    let ms = |ns: Vec<u64>| ns.into_iter().map(|ns| Duration::from_nanos(ns).as_secs_f64() * 1e3).collect::<Vec<_>>();
    let mut rows = Vec::new();
    for stage in &STAGES {
        let times = ms(scans.iter().filter_map(|scan| (stage.of)(scan)).collect());
        rows.extend(measured(stage.name, &params, &times, BTreeMap::new()));
    }
    for gap in &GAPS {
        let own = BTreeMap::from([("gap".to_owned(), json!(gap.name))]);
        let times = ms(timelines.iter().map(gap.of).collect());
        rows.extend(measured("gap", &params.clone().into_iter().chain(own).collect(), &times, BTreeMap::new()));
    }
    let overhead = ms(timelines.iter().map(Timeline::graph_overhead).collect());
    let missing = BTreeMap::from([("scans_without_timeline".to_owned(), json!(scans.len() - timelines.len()))]);
    rows.extend(measured("graph_overhead", &params, &overhead, missing));
    rows.extend(work_rows(data, after, &params));
    rows.extend(process_rows(data, after, &params));
    rows.extend(LITERATURE.iter().map(|(name, size, ms)| literature(name, size, *ms)));
    Ok(rows)
}

/// The work of every service: waiting, waking up, taking and computing apart.
fn work_rows(data: &RunData, after: u32, params: &BTreeMap<String, Value>) -> Vec<Row> {
    let mut kinds: Vec<(&str, &str)> = Vec::new();
    for work in &data.work.spans {
        if !kinds.contains(&(&work.service, work.stage())) {
            kinds.push((&work.service, work.stage()));
        }
    }
    let mut rows = Vec::new();
    for (service, stage) in kinds {
        let is_of = |w: &&ServiceWork| w.service == service && w.stage() == stage && w.span.scan >= after;
        let spans: Vec<WorkSpan> = data.work.spans.iter().filter(is_of).map(|work| work.span).collect();
        let needing: Vec<Delay> = spans.iter().filter(|span| span.input_ns > 0).map(WorkSpan::delay).collect();
        let times: [Vec<u64>; 4] = [
            needing.iter().map(|delay| delay.waiting).collect(),
            needing.iter().map(|delay| delay.wake_up).collect(),
            needing.iter().map(|delay| delay.taking).collect(),
            spans.iter().map(WorkSpan::computing).collect(),
        ];
        for (part, ns) in PARTS.iter().zip(times) {
            let own = [("service", json!(service)), ("work", json!(stage)), ("part", json!(part))];
            let own = own.into_iter().map(|(key, value)| (key.to_owned(), value));
            let ms: Vec<f64> = ns.into_iter().map(|ns| ns as f64 / 1e6).collect();
            rows.extend(measured("work", &params.clone().into_iter().chain(own).collect(), &ms, BTreeMap::new()));
        }
    }
    rows
}

/// What every process uses for a scan.
fn process_rows(data: &RunData, after: u32, params: &BTreeMap<String, Value>) -> Vec<Row> {
    type Figure = (&'static str, &'static str, fn(&ScanUsage) -> f64);
    let figures: [Figure; 5] = [
        ("cpu", "ms", |u| u.used.cpu_ns as f64 / 1e6),
        ("minor_faults", "1", |u| u.used.minor_faults as f64),
        ("major_faults", "1", |u| u.used.major_faults as f64),
        ("voluntary_switches", "1", |u| u.used.voluntary_switches as f64),
        ("involuntary_switches", "1", |u| u.used.involuntary_switches as f64),
    ];
    let services: BTreeSet<&str> = data.work.usage.iter().map(|usage| usage.service.as_str()).collect();
    let mut rows = Vec::new();
    for service in services {
        for (figure, unit, of) in figures {
            let used = data.work.usage.iter().filter(|usage| usage.service == service && usage.scan >= after);
            let own = [("service".to_owned(), json!(service)), ("figure".to_owned(), json!(figure))];
            let params = params.clone().into_iter().chain(own).collect();
            let row = measured("process", &params, &used.map(of).collect::<Vec<_>>(), BTreeMap::new());
            rows.extend(row.map(|row| Row { unit: unit.into(), ..row }));
        }
    }
    rows
}

fn measured(
    name: &str,
    params: &BTreeMap<String, Value>,
    times_ms: &[f64],
    extra: BTreeMap<String, Value>,
) -> Option<Row> {
    Some(Row {
        name: name.to_owned(),
        params: params.clone(),
        unit: "ms".into(),
        summary: Summary::of(times_ms)?,
        provenance: Provenance::Measured,
        extra,
    })
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
