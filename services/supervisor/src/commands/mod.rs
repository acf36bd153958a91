//! The commands.

mod bench;
mod bench_external;
mod bench_pipeline;
mod convert;
mod doctor;
mod experiment;
mod explore;
mod find;
mod replan;
mod replay;
mod robot_world;
mod service;
mod session;
mod top;
mod tour;
mod up;

use std::io::Write;

use anyhow::Result;

use crate::cli::{BenchCommand, Cli, Command, ExploreArgs};
use crate::{EXIT_DONE, Registry, supervise};

/// Carries out the command and returns the exit code.
pub fn dispatch(cli: Cli, registry: Registry) -> Result<u8> {
    let common = &cli.common;
    supervise::pin_to(&common.cores)?;
    match cli.command {
        None => explore::explore(common, &ExploreArgs::default(), &registry),
        Some(Command::Explore(args)) => explore::explore(common, &args, &registry),
        Some(Command::Tour { world }) => tour::tour(common, world, &registry),
        Some(Command::Replay(args)) => replay::replay(common, &args, &registry),
        Some(Command::Up { graph }) => up::up(common, &graph, &registry),
        Some(Command::Run(args)) => service::run_service(common, &args, &registry),
        Some(Command::Top { once, json }) => top::top(common, once, json),
        Some(Command::Replan(args)) => replan::replan(common, &args),
        Some(Command::Bench { what: BenchCommand::Ipc(args) }) => bench::ipc(&args),
        Some(Command::Bench { what: BenchCommand::Stages { json, threads, repetitions } }) => {
            bench::stages(json.as_deref(), &threads, repetitions)
        }
        Some(Command::Bench { what: BenchCommand::Simulator { json, repetitions } }) => {
            bench::simulator(json.as_deref(), repetitions, common.quiet)
        }
        Some(Command::Bench { what: BenchCommand::Registration(args) }) => {
            bench::registration(common, &args, &registry)
        }
        Some(Command::Bench { what: BenchCommand::Compare(args) }) => bench::compare(&args),
        Some(Command::Bench { what: BenchCommand::Pipeline(args) }) => bench::pipeline(common, &args, &registry),
        Some(Command::Bench { what: BenchCommand::Planning(args) }) => bench::planning(&args, common.quiet),
        Some(Command::Explain { dir, scan }) => {
            let mut text = Vec::new();
            crate::explain::explain(&dir, scan, &mut text)?;
            // A reader that closes the pipe early (head, less) has seen what it wanted.
            let _ = std::io::stdout().lock().write_all(&text);
            Ok(EXIT_DONE)
        }
        Some(Command::Convert { input, output, grid }) => {
            convert::convert(&input, &output, grid.as_deref(), common.quiet)
        }
        Some(Command::Doctor { fix }) => doctor::doctor(common, fix),
        Some(Command::Experiment(args)) => experiment::experiment(common, &args, &registry),
        Some(Command::ExecChild { parent, command }) => {
            supervise::exec_child(parent, &command)?;
            Ok(EXIT_DONE)
        }
        Some(Command::BenchPeer { args }) => {
            mirador_bench::ipc::peer_main(args)?;
            Ok(EXIT_DONE)
        }
    }
}
