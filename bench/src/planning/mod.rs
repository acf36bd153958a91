//! `mirador bench planning`: how long a plan takes, and how well strategies explore.
//!
//! Rows of the report:
//!
//! - `evaluate_candidates`: params strategy, candidates, scans_in_map, threads, scanner; unit ms: a whole plan (reading
//!   what changed in the map, ways, candidates, their gains, the decision) on a map that has just grown by a scan.
//!   cells_per_second counts every cell in range of a candidate, known_cells the known ones that the plan looks at. The source's figure stands beside as literature.
//! - `first_plan`: the same without anything kept from an earlier plan. `other_weights`: the plan asked for again.
//! - `exploration`: params world, strategy, weights, seed, scanner; unit ms, over the plans of the run; scans, metres,
//!   mean_quality, coverage, stop. The scanner loses and mixes returns as an LMS111 does.

mod error;
mod evaluate;
mod options;
mod tournament;

pub use error::PlanningBenchError;
use mirador_core::view_planning::StrategyRegistry;
pub use options::{PlanningCase, PlanningOptions};
pub use tournament::{Entrant, entrants};

use crate::{BenchReport, Machine};

/// Measures the strategies of `registry`. `say` is told what goes on, a line at a time.
///
/// # Errors
/// See [`PlanningBenchError`].
pub fn run(
    options: &PlanningOptions,
    registry: &StrategyRegistry,
    say: &mut dyn FnMut(&str),
) -> Result<BenchReport, PlanningBenchError> {
    options.validate(registry)?;
    let mut rows = Vec::new();
    for case in &options.cases {
        match case {
            PlanningCase::Evaluate => {
                rows.push(evaluate::literature());
                rows.extend(evaluate::rows(options, registry, say)?);
            }
            PlanningCase::Growth => rows.extend(evaluate::growth(options, registry, say)?),
            PlanningCase::Exploration => rows.extend(tournament::rows(options, registry, say)?),
        }
    }
    Ok(BenchReport { bench: "planning".into(), machine: Machine::here(), rows })
}

#[cfg(test)]
mod tests;
