//! `exploration` rows: the source's weight sets and every other strategy, each over several seeds in each world.

use std::collections::BTreeMap;

use mirador_core::simulation::ScannerConfig;
use mirador_core::view_planning::{PlanningConfig, StrategyRegistry, Weights};
use serde_json::json;

use super::{PlanningBenchError, PlanningOptions};
use crate::exploration::{Exploration, Outcome, WEIGHTS, World, coarser, planning_config, weights_of};
use crate::{Provenance, Row, Summary};

/// The worlds.
const WORLDS: [&str; 2] = ["simple", "urban"];
/// A run that does not end is cut off.
const MAX_SCANS: usize = 80;

/// A strategy with its weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Entrant {
    /// The strategy's name.
    pub strategy: String,
    /// Name of the weight set; empty for strategies without weights.
    pub weights_name: String,
    /// The weights.
    pub weights: Weights,
}

/// `multi_criteria` with every weight set of the source, and every other strategy.
#[must_use]
pub fn entrants(registry: &StrategyRegistry) -> Vec<Entrant> {
    let sets = WEIGHTS.iter().map(|set| Entrant {
        strategy: "multi_criteria".into(),
        weights_name: set.0.into(),
        weights: weights_of(set),
    });
    let others = registry.names().filter(|&name| name != "multi_criteria").map(|name| Entrant {
        strategy: name.to_owned(),
        weights_name: String::new(),
        weights: Weights::default(),
    });
    sets.chain(others).collect()
}

/// The rows of all explorations.
pub(super) fn rows(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, PlanningBenchError> {
    let scanner = coarser(&ScannerConfig::lms111(), options.coarser);
    let step = format!("{} deg", scanner.beam_step_deg);
    let mut rows = Vec::new();
    for name in WORLDS {
        let world = World::named(name)?;
        for entrant in entrants(registry).into_iter().filter(|entrant| options.wants(&entrant.strategy)) {
            for seed in 1..=options.seeds {
                let planning = PlanningConfig {
                    strategy: entrant.strategy.clone(),
                    weights: entrant.weights,
                    ..planning_config(&scanner)
                };
                let run = Exploration { scanner: scanner.clone(), planning, seed, max_scans: MAX_SCANS, threads: 2 };
                let outcome = run.run(&world, registry, &|| false)?;
                let last = outcome.last();
                say(&format!(
                    "exploration {name} {} {} seed {seed}: {} scans, {:.0} m, quality {:.3}, coverage {:.3}",
                    entrant.strategy,
                    entrant.weights_name,
                    outcome.scans(),
                    last.metres,
                    last.quality,
                    last.coverage
                ));
                rows.extend(row(name, &entrant, seed, &step, &outcome));
            }
        }
    }
    Ok(rows)
}

fn row(world: &str, entrant: &Entrant, seed: u64, step: &str, outcome: &Outcome) -> Option<Row> {
    let last = outcome.last();
    Some(Row {
        name: "exploration".into(),
        params: BTreeMap::from([
            ("world".to_owned(), json!(world)),
            ("strategy".into(), json!(entrant.strategy)),
            ("weights".into(), json!(entrant.weights_name)),
            ("seed".into(), json!(seed)),
            ("scanner".into(), json!(step)),
        ]),
        unit: "ms".into(),
        summary: Summary::of(&outcome.steps.iter().map(|step| step.planning_ms).collect::<Vec<_>>())?,
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("scans".to_owned(), json!(outcome.scans())),
            ("metres".into(), json!(last.metres)),
            ("mean_quality".into(), json!(last.quality)),
            ("coverage".into(), json!(last.coverage)),
            ("stop".into(), json!(outcome.stop)),
        ]),
    })
}
