//! `mirador experiment`.

use std::path::Path;

use anyhow::Result;
use mirador_bench::experiment::{self, Ending, ExperimentError, Settings};
use mirador_core::view_planning::{PlanningConfig, StrategyRegistry};
use mirador_ipc_schema::StopSignal;

use super::session::load_graph;
use crate::cli::{Common, ExperimentArgs};
use crate::{EXIT_DONE, EXIT_INTERRUPTED, Registry, UsageError};

/// Of `[planning.view]`, what an experiment decides by itself.
const NOT_SET: [&str; 3] = ["strategy", "scanner", "work_area"];

/// Runs the experiments that are not there yet and writes the tables of all.
pub fn experiment(common: &Common, args: &ExperimentArgs, registry: &Registry) -> Result<u8> {
    let settings = settings(args, planning(common, registry)?);
    let folder = common.out.as_deref().unwrap_or_else(|| Path::new("mirador-experiment"));
    let stop = StopSignal::from_terminal()?;
    let mut say = |line: &str| {
        if !common.quiet {
            eprintln!("{line}");
        }
    };
    let registry = StrategyRegistry::default();
    if !(1..=64).contains(&args.jobs) {
        return Err(UsageError(format!("--jobs {}: give 1 to 64", args.jobs)).into());
    }
    let result = experiment::run(&settings, folder, args.jobs, &registry, &|| stop.is_set(), &mut say);
    let (_, ending) = result.map_err(|error: ExperimentError| {
        if error.is_usage() { UsageError(error.to_string()).into() } else { anyhow::Error::from(error) }
    })?;
    if !common.quiet {
        println!("{}", folder.join("experiment.html").display());
    }
    match ending {
        Ending::Finished => Ok(EXIT_DONE),
        Ending::Interrupted => {
            eprintln!("interrupted; the same command goes on with it");
            Ok(EXIT_INTERRUPTED)
        }
    }
}

/// The planner's settings by the graph file and `--set`; the rest of a graph is of no use to an experiment.
fn planning(common: &Common, registry: &Registry) -> Result<PlanningConfig> {
    for set in &common.set {
        let key = set.split('=').next().unwrap_or_default().trim();
        let field = key.strip_prefix("planning.view.").and_then(|field| field.split('.').next());
        if field.is_none_or(|field| NOT_SET.contains(&field)) {
            let reason = "an experiment is one process and takes keys of planning.view only, and of these not strategy (see \
                          --experiments), scanner and work_area";
            return Err(UsageError(format!("--set {key}: {reason}")).into());
        }
    }
    if common.live {
        return Err(UsageError("--live: an experiment is one process, of which nothing can be seen live".into()).into());
    }
    Ok(load_graph(common, None, registry)?.planning.view)
}

/// What is not given keeps its default.
fn settings(args: &ExperimentArgs, planning: PlanningConfig) -> Settings {
    let default = Settings::default();
    Settings {
        worlds: if args.worlds.is_empty() { default.worlds } else { args.worlds.clone() },
        experiments: args.experiments.clone(),
        seeds: args.seeds.unwrap_or(default.seeds),
        first_seed: args.first_seed.unwrap_or(default.first_seed),
        coarser: args.coarser.unwrap_or(default.coarser),
        max_scans: args.max_scans.unwrap_or(default.max_scans),
        farthest_m: args.farthest.unwrap_or(planning.farthest_m),
        planning,
        ..default
    }
}
