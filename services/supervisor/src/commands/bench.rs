//! `mirador bench`.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use mirador_bench::BenchReport;
use mirador_bench::ipc::{self, IpcOptions};
use mirador_bench::planning::{self, PlanningBenchError, PlanningCase, PlanningOptions};
use mirador_bench::registration::{self, Case, RegistrationBenchError, RegistrationOptions};
use mirador_bench::simulator::{self, SimulatorBenchError};
use mirador_bench::stages::{self, StagesBenchError, StagesOptions};
use mirador_core::view_planning::StrategyRegistry;
use mirador_ipc_schema::StopSignal;

use super::bench_pipeline;
use crate::cli::{BenchPipelineArgs, BenchPlanningArgs, BenchRegistrationArgs, Common};
use crate::{EXIT_DONE, Registry, UsageError};

/// Latency between two processes.
pub fn ipc(json: Option<&Path>, messages: Option<usize>, pace_ms: Option<f64>) -> Result<u8> {
    let own = std::env::current_exe().context("the path of this program is not known")?;
    let mut options = IpcOptions {
        peer_command: vec![own.to_string_lossy().into_owned(), "bench-peer".into(), "--".into()],
        stop: StopSignal::from_terminal()?,
        ..IpcOptions::default()
    };
    if let Some(messages) = messages {
        for payload in &mut options.payloads {
            payload.messages = messages as u64;
        }
    }
    if let Some(ms) = pace_ms {
        let pace = Duration::try_from_secs_f64(ms / 1e3);
        options.pace =
            pace.map_err(|_| UsageError(format!("--pace-ms {ms}: give a time of 0 or more milliseconds")))?;
    }
    let report = ipc::run(&options)?;
    keep(&report, json)?;
    Ok(EXIT_DONE)
}

/// Speed and error of registration, beside the peers.
pub fn registration(args: &BenchRegistrationArgs, quiet: bool, registry: &Registry) -> Result<u8> {
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
    if let Some(path) = json {
        let text = serde_json::to_string_pretty(report)?;
        std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}
