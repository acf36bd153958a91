//! `mirador run`: one service in this process.

use std::path::PathBuf;

use anyhow::{Context, Result};
use mirador_ipc_schema::service::ServiceSetup;
use mirador_ipc_schema::{Domain, Sizes, StopSignal};
use mirador_service_common::ServiceError;

use super::session::load_graph;
use crate::cli::{Common, RunArgs};
use crate::graph::{Graph, SERVICES, ServiceEntry};
use crate::supervise::{die_with_parent, pin_to};
use crate::{EXIT_DONE, Registry, UsageError};

/// Cells of a full scan of the default scanner: the slot size where nothing else says it.
const DEFAULT_POINTS: usize = 389_520;

/// Runs one service until it is stopped.
pub fn run_service(common: &Common, args: &RunArgs, registry: &Registry) -> Result<u8> {
    // First of all: from here on the service ends with its supervisor.
    let stop = StopSignal::from_terminal().context("signals cannot be handled")?;
    if let Some(parent) = args.parent {
        die_with_parent(parent)?;
    }
    let graph = load_graph(common, None, registry)?;
    let entry = entry_of(&graph, &args.service)?;
    pin_to(&entry.cores)?;
    let run_dir = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    let points = if graph.graph.max_points == 0 { DEFAULT_POINTS } else { graph.graph.max_points };
    let setup = ServiceSetup {
        name: args.service.clone(),
        domain: Domain::new(&graph.graph.domain).map_err(|e| UsageError(e.to_string()))?,
        incarnation: args.incarnation,
        sizes: Sizes { scan_points: points },
        wake: graph.graph.wake.into(),
        run_dir,
        run: args.run,
        threads: entry.threads,
        stop,
    };
    let result = match args.service.as_str() {
        "simulator" => mirador_simulator::run(&setup, &graph.simulator),
        "laser_driver" => mirador_laser_driver::run(&setup, &graph.laser_driver),
        "localization" => mirador_localization::run(&setup, &graph.localization),
        "navigation" => mirador_navigation::run(&setup, &graph.navigation),
        "acquisition" => mirador_acquisition::run(&setup, &graph.acquisition),
        "alignment" => mirador_alignment::run(&setup, &graph.alignment, registry),
        "analysis" => mirador_analysis::run(&setup, &graph.analysis),
        "planning" => mirador_planning::run(&setup, &graph.planning),
        "gateway" => mirador_gateway::run(&setup, &graph.gateway),
        _ => mirador_recorder::run(&setup, &graph.recorder).map_err(|e| ServiceError::Work(e.to_string())),
    };
    match result {
        Ok(()) => Ok(EXIT_DONE),
        Err(ServiceError::Config(message)) => Err(UsageError(message).into()),
        Err(error) => Err(error.into()),
    }
}

fn entry_of(graph: &Graph, service: &str) -> Result<ServiceEntry> {
    if !SERVICES.contains(&service) {
        return Err(UsageError(format!("there is no service '{service}'; there are: {}", SERVICES.join(", "))).into());
    }
    let found = graph.services.entries().into_iter().find(|(name, _)| *name == service);
    Ok(found.map_or_else(ServiceEntry::default, |(_, entry)| entry.clone()))
}
