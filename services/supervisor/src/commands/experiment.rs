//! `mirador experiment`.

use std::path::Path;

use anyhow::Result;
use mirador_bench::experiment::{self, Ending, ExperimentError, Settings};
use mirador_core::view_planning::StrategyRegistry;
use mirador_ipc_schema::StopSignal;

use crate::cli::{Common, ExperimentArgs};
use crate::{EXIT_DONE, EXIT_INTERRUPTED, UsageError};

/// Runs the experiments that are not there yet and writes the tables of all.
pub fn experiment(common: &Common, args: &ExperimentArgs) -> Result<u8> {
    let settings = settings(args);
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

/// What is not given keeps its default.
fn settings(args: &ExperimentArgs) -> Settings {
    let default = Settings::default();
    Settings {
        worlds: if args.worlds.is_empty() { default.worlds } else { args.worlds.clone() },
        experiments: args.experiments.clone(),
        seeds: args.seeds.unwrap_or(default.seeds),
        first_seed: args.first_seed.unwrap_or(default.first_seed),
        coarser: args.coarser.unwrap_or(default.coarser),
        max_scans: args.max_scans.unwrap_or(default.max_scans),
        farthest_m: args.farthest.unwrap_or(default.farthest_m),
        ..default
    }
}
