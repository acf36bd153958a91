//! `mirador bench`.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use mirador_alignment::EXTERNAL;
use mirador_bench::BenchReport;
use mirador_bench::compare::{self, CompareOptions};
use mirador_bench::ipc::{self, IpcOptions, Payload};
use mirador_bench::planning::{self, PlanningBenchError, PlanningCase, PlanningOptions};
use mirador_bench::registration::all_pairs::AllPairsOptions;
use mirador_bench::registration::{self, Case, RegistrationBenchError, RegistrationOptions};
use mirador_bench::simulator::{self, SimulatorBenchError};
use mirador_bench::stages::{self, StagesBenchError, StagesOptions};
use mirador_core::view_planning::StrategyRegistry;
use mirador_ipc_schema::StopSignal;

use super::bench_external::ForeignProgram;
use super::bench_pipeline;
use super::session::load_graph;
use crate::cli::{
    AllPairsArgs, BenchCompareArgs, BenchIpcArgs, BenchPipelineArgs, BenchPlanningArgs, BenchRegistrationArgs, Common,
};
use crate::{EXIT_DONE, EXIT_FAILED, Registry, UsageError};

/// Latency between two processes.
pub fn ipc(args: &BenchIpcArgs) -> Result<u8> {
    let own = std::env::current_exe().context("the path of this program is not known")?;
    let mut options = IpcOptions {
        peer_command: vec![own.to_string_lossy().into_owned(), "bench-peer".into(), "--".into()],
        stop: StopSignal::from_terminal()?,
        ..IpcOptions::default()
    };
    options.subscribers.clone_from(&args.subscribers);
    if !args.payloads.is_empty() {
        options.payloads = args.payloads.iter().map(|bytes| Payload::of(*bytes)).collect();
    }
    if args.loaded {
        options.loaded = vec![false, true];
    }
    if let Some(messages) = args.messages {
        for payload in &mut options.payloads {
            payload.messages = messages;
        }
    }
    if let Some(ms) = args.pace_ms {
        let pace = Duration::try_from_secs_f64(ms / 1e3);
        options.pace =
            pace.map_err(|_| UsageError(format!("--pace-ms {ms}: give a time of 0 or more milliseconds")))?;
    }
    options.validate().map_err(|error| UsageError(error.to_string()))?;
    let report = ipc::run(&options)?;
    keep(&report, args.json.as_deref())?;
    Ok(EXIT_DONE)
}

/// Any methods over all pairs of a folder of scans.
fn all_pairs(common: &Common, args: &BenchRegistrationArgs, data: &Path, registry: &Registry) -> Result<u8> {
    if args.repetitions.is_some() || !args.cases.is_empty() || args.growth_scans.is_some() || args.python.is_some() {
        let message = format!(
            "{}: of a folder of scans every pair is aligned once: --repetitions, --cases, --growth-scans and --python are for \
             the known data sets",
            data.display()
        );
        return Err(UsageError(message).into());
    }
    let (pairs, default) = (&args.pairs, AllPairsOptions::default());
    let graph = load_graph(common, None, registry)?;
    let threads = pairs.threads.unwrap_or(default.threads);
    let (foreign, methods): (Vec<_>, Vec<_>) = args.methods.iter().cloned().partition(|name| name == EXTERNAL);
    let foreign = (!foreign.is_empty()).then(|| ForeignProgram::start(&graph, threads, registry)).transpose()?;
    // The program runs until all is measured.
    let (program, foreign) = foreign.unzip();
    let is_stopped = || program.as_ref().is_some_and(ForeignProgram::is_stopped);
    let options = AllPairsOptions {
        data: data.to_path_buf(),
        truth: pairs.truth.clone(),
        poses: pairs.poses.clone(),
        methods,
        threads,
        settings: graph.alignment.method,
        max_distance_m: pairs.max_distance.unwrap_or(default.max_distance_m),
        success_m: pairs.success_m.unwrap_or(default.success_m),
        success_deg: pairs.success_deg.unwrap_or(default.success_deg),
    };
    let mut say = |line: &str| {
        if !common.quiet {
            eprintln!("{line}");
        }
    };
    let result =
        registration::all_pairs::run(&options, registry, foreign, &is_stopped, &mut say).map_err(usage_or_failure)?;
    keep(&result.report, args.json.as_deref())?;
    if let Some(path) = &pairs.html {
        let page = registration::all_pairs::page(&result)?;
        std::fs::write(path, page).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(EXIT_DONE)
}

/// What the user can mend is wrong usage.
fn usage_or_failure(error: RegistrationBenchError) -> anyhow::Error {
    match error {
        RegistrationBenchError::BadOption { .. }
        | RegistrationBenchError::Registry(_)
        | RegistrationBenchError::Data(_)
        | RegistrationBenchError::BadFile { .. }
        | RegistrationBenchError::NothingMeasured { .. } => UsageError(error.to_string()).into(),
        other => other.into(),
    }
}

/// Speed and error of registration, beside the peers.
pub fn registration(common: &Common, args: &BenchRegistrationArgs, registry: &Registry) -> Result<u8> {
    let quiet = common.quiet;
    if let Some(data) = args.data.as_deref().filter(|data| registration::all_pairs::is_data_set(data)) {
        return all_pairs(common, args, data, registry);
    }
    if args.pairs != AllPairsArgs::default() {
        let message = "--truth, --poses, --html, --max-distance, --success-m, --success-deg and --threads are for a folder of scans: \
                       name it by --data";
        return Err(UsageError(message.into()).into());
    }
    let options = registration_options(args)?;
    let mut say = |line: &str| {
        if !quiet {
            eprintln!("{line}");
        }
    };
    let report = registration::run(&options, registry, &mut say).map_err(|error| match error {
        RegistrationBenchError::BadOption { .. } | RegistrationBenchError::Registry(_) => {
            anyhow::Error::new(UsageError(error.to_string()))
        }
        other => other.into(),
    })?;
    keep(&report, args.json.as_deref())?;
    registration::print_comparison(&report, &mut std::io::stdout().lock())?;
    Ok(EXIT_DONE)
}

/// A scene through the whole graph.
pub fn pipeline(common: &Common, args: &BenchPipelineArgs, registry: &Registry) -> Result<u8> {
    keep(&bench_pipeline::measure(common, args, registry)?, args.json.as_deref())?;
    Ok(EXIT_DONE)
}

/// What became slower from one report to another.
pub fn compare(args: &BenchCompareArgs) -> Result<u8> {
    let options = CompareOptions { threshold: args.threshold, alpha: args.alpha };
    let comparison = compare::compare(&args.old, &args.new, &options).map_err(|e| UsageError(e.to_string()))?;
    compare::print(&comparison, &mut std::io::stdout().lock())?;
    write_json(&comparison, args.json.as_deref())?;
    Ok(if comparison.is_regression() { EXIT_FAILED } else { EXIT_DONE })
}

/// The stages by themselves.
pub fn stages(json: Option<&Path>, threads: &[usize], repetitions: usize) -> Result<u8> {
    let options = StagesOptions { threads: threads.to_vec(), repetitions };
    let report = stages::run(&options).map_err(|error| match error {
        StagesBenchError::Nothing { .. } => anyhow::Error::new(UsageError(error.to_string())),
        other => other.into(),
    })?;
    keep(&report, json)?;
    Ok(EXIT_DONE)
}

/// Speed of the simulator.
pub fn simulator(json: Option<&Path>, repetitions: usize, quiet: bool) -> Result<u8> {
    let mut say = |line: &str| {
        if !quiet {
            eprintln!("{line}");
        }
    };
    let report = simulator::run(repetitions, &mut say).map_err(|error| match error {
        SimulatorBenchError::NoRepetitions => anyhow::Error::new(UsageError(error.to_string())),
        other => other.into(),
    })?;
    keep(&report, json)?;
    Ok(EXIT_DONE)
}

/// The options of the benchmark; what is not given keeps its default.
fn registration_options(args: &BenchRegistrationArgs) -> Result<RegistrationOptions> {
    let mut options = RegistrationOptions { methods: args.methods.clone(), ..RegistrationOptions::default() };
    if let Some(repetitions) = args.repetitions {
        options.repetitions = repetitions;
    }
    if let Some(scans) = args.growth_scans {
        options.growth_scans = scans;
    }
    if !args.cases.is_empty() {
        let cases: Result<Vec<Case>, _> = args.cases.iter().map(|name| name.parse()).collect();
        options.cases = cases.map_err(|error: RegistrationBenchError| UsageError(error.to_string()))?;
    }
    if let Some(data) = &args.data {
        if !data.is_dir() {
            return Err(UsageError(format!("--data {}: there is no such folder", data.display())).into());
        }
        options.data.clone_from(data);
    }
    if let Some(python) = &args.python {
        options.python = Some(python.clone());
    }
    if args.no_peers {
        options.python = None;
    }
    Ok(options)
}

/// Time of a plan, and what strategies achieve.
pub fn planning(args: &BenchPlanningArgs, quiet: bool) -> Result<u8> {
    let wrong = |error: PlanningBenchError| UsageError(error.to_string());
    let default = PlanningOptions::default();
    let cases = args.cases.iter().map(|name| name.parse()).collect::<Result<Vec<PlanningCase>, _>>().map_err(wrong)?;
    let options = PlanningOptions {
        repetitions: args.repetitions.unwrap_or(default.repetitions),
        cases: if cases.is_empty() { default.cases } else { cases },
        strategies: args.strategies.clone(),
        growth_scans: args.growth_scans.unwrap_or(default.growth_scans),
        seeds: args.seeds.unwrap_or(default.seeds),
        coarser: args.coarser.unwrap_or(default.coarser),
    };
    let registry = StrategyRegistry::default();
    options.validate(&registry).map_err(wrong)?;
    let mut say = |line: &str| {
        if !quiet {
            eprintln!("{line}");
        }
    };
    let report = planning::run(&options, &registry, &mut say)?;
    keep(&report, args.json.as_deref())?;
    Ok(EXIT_DONE)
}

/// Prints the table and writes the JSON file, if asked.
fn keep(report: &BenchReport, json: Option<&Path>) -> Result<()> {
    report.print_table(&mut std::io::stdout().lock())?;
    write_json(report, json)
}

fn write_json(value: &impl serde::Serialize, path: Option<&Path>) -> Result<()> {
    if let Some(path) = path {
        // A list of numbers on one line each would make the samples of a report the most of it.
        let text = report_json(&serde_json::to_value(value)?);
        std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}

/// JSON with a line for every row.
fn report_json(value: &serde_json::Value) -> String {
    let Some(object) = value.as_object() else { return value.to_string() };
    let field = |(key, value): (&String, &serde_json::Value)| {
        let rows = value.as_array().filter(|rows| rows.iter().any(serde_json::Value::is_object));
        let lines = rows.map(|rows| rows.iter().map(|row| format!("\n    {row}")).collect::<Vec<_>>().join(","));
        let text = lines.map_or_else(|| value.to_string(), |lines| format!("[{lines}\n  ]"));
        format!("  {}: {text}", serde_json::Value::from(key.as_str()))
    };
    format!("{{\n{}\n}}\n", object.iter().map(field).collect::<Vec<_>>().join(",\n"))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_report_is_written_with_a_line_for_every_row_and_reads_back() {
        let report = json!({"bench": "a \"b\"", "rows": [{"p": 1.5, "samples": [1, 2, 3]}, {"p": null}], "empty": []});
        let text = report_json(&report);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), report);
        assert_eq!(text.lines().filter(|line| line.starts_with("    {")).count(), 2, "{text}");
    }
}
