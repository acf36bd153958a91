//! `exploration` rows: the source's weight sets and every other strategy, each over several seeds in each world.

use std::collections::BTreeMap;

use mirador_core::view_planning::{PlanningConfig, StrategyRegistry, Weights};
use serde_json::json;

use super::explore::{Exploration, Outcome, World, planning_config, scanner};
use super::{PlanningBenchError, PlanningOptions};
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

/// The weight sets of the source's experiments (Table of section 10): name, w_A, w_Q, w_O, w_C.
const WEIGHTS: [(&str, [f64; 4]); 10] = [
    ("simple I", [0.43, 0.35, 0.22, 0.09]),
    ("simple II", [0.65, 0.25, 0.10, 0.09]),
    ("simple III", [0.36, 0.50, 0.14, 0.09]),
    ("structured I", [0.20, 0.55, 0.25, 0.09]),
    ("structured II", [0.65, 0.25, 0.10, 0.08]),
    ("unstructured I", [0.40, 0.35, 0.25, 0.125]),
    ("unstructured II", [0.65, 0.30, 0.05, 0.08]),
    ("office I", [0.84, 0.10, 0.05, 0.05]),
    ("office II", [0.35, 0.40, 0.15, 0.40]),
    ("ruin", [0.55, 0.30, 0.15, 0.16]),
];

/// `multi_criteria` with every weight set of the source, and every other strategy.
#[must_use]
pub fn entrants(registry: &StrategyRegistry) -> Vec<Entrant> {
    let sets = WEIGHTS.iter().map(|&(name, [information, quality, zones, cost])| Entrant {
        strategy: "multi_criteria".into(),
        weights_name: name.into(),
        weights: Weights { information, quality, zones, cost },
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
    let scanner = scanner(options.coarser);
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
                let run = Exploration { scanner: scanner.clone(), planning, seed, max_scans: MAX_SCANS };
                let outcome = run.run(&world, registry)?;
                say(&format!(
                    "exploration {name} {} {} seed {seed}: {} scans, {:.0} m, quality {:.3}, coverage {:.3}",
                    entrant.strategy,
                    entrant.weights_name,
                    outcome.scans,
                    outcome.metres,
                    outcome.mean_quality,
                    outcome.coverage
                ));
                rows.extend(row(name, &entrant, seed, &step, &outcome));
            }
        }
    }
    Ok(rows)
}

fn row(world: &str, entrant: &Entrant, seed: u64, step: &str, outcome: &Outcome) -> Option<Row> {
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
        summary: Summary::of(&outcome.plan_ms)?,
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("scans".to_owned(), json!(outcome.scans)),
            ("metres".into(), json!(outcome.metres)),
            ("mean_quality".into(), json!(outcome.mean_quality)),
            ("coverage".into(), json!(outcome.coverage)),
            ("stop".into(), json!(outcome.stop)),
        ]),
    })
}
