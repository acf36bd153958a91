//! `mirador explore`.

use std::path::PathBuf;

use anyhow::Result;

use super::session::{Session, load_graph_or};
use crate::cli::{Common, ExploreArgs};
use crate::graph::{EXPLORATION, Graph};
use crate::{Registry, UsageError};

/// Explores a simulated world until the strategy stops.
pub fn explore(common: &Common, args: &ExploreArgs, registry: &Registry) -> Result<u8> {
    let mut graph = load_graph_or(common, EXPLORATION, registry)?;
    if graph.services.simulator.is_none() {
        let message = "this graph has no simulator to explore with: add [services.simulator], launch it with `mirador up`, \
                       or scan a world from given poses with `mirador tour`";
        return Err(UsageError(message.into()).into());
    }
    apply(args, &mut graph)?;
    let out = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    let title = format!("Exploration of {}", graph.simulator.world);
    Session { common, graph, out, truth: None, title }.run()
}

/// The options of the command line win over the graph file.
fn apply(args: &ExploreArgs, graph: &mut Graph) -> Result<()> {
    if let Some(world) = &args.world {
        // A file is found by services that run elsewhere, too.
        let is_file = world.ends_with(".toml");
        let absolute = std::path::absolute(world).ok().filter(|_| is_file);
        graph.simulator.world = absolute.map_or_else(|| world.clone(), |path| path.display().to_string());
    }
    if let Some(strategy) = &args.strategy {
        graph.planning.view.strategy.clone_from(strategy);
    }
    match args.weights[..] {
        [] => {}
        [information, quality, zones, cost] => {
            let weights = &mut graph.planning.view.weights;
            (weights.information, weights.quality) = (information, quality);
            (weights.zones, weights.cost) = (zones, cost);
        }
        _ => {
            let message = format!("--weights takes four numbers A,Q,O,C, not {}", args.weights.len());
            return Err(UsageError(message).into());
        }
    }
    if let Some(seed) = args.seed {
        graph.simulator.seed = seed;
        graph.planning.seed = seed;
        graph.acquisition.seed = seed;
    }
    if let Some(scans) = args.max_scans {
        graph.acquisition.max_scans = scans;
    }
    if let Some(speed) = args.speed {
        graph.simulator.speed = speed;
        graph.graph.lockstep = speed == 0.0;
    }
    graph.planning.validate().map_err(UsageError)?;
    graph.simulator.validate().map_err(|e| UsageError(e.to_string()))?;
    Ok(())
}
