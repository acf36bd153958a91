use super::*;
use crate::exploration::{Exploration, Outcome, World, coarser, planning_config};
use mirador_core::simulation::ScannerConfig;
use mirador_core::view_planning::PlanningConfig;

/// A short exploration with a coarse scanner.
fn short(strategy: &str, seed: u64, max_scans: usize) -> Outcome {
    let scanner = coarser(&ScannerConfig::lms111(), 4);
    let planning = PlanningConfig { strategy: strategy.into(), ..planning_config(&scanner) };
    let world = World::named("simple").unwrap();
    let run = Exploration { scanner, planning, seed, max_scans, threads: 2 };
    run.run(&world, &StrategyRegistry::default(), &|| false).unwrap()
}

#[test]
fn every_strategy_explores_the_simple_world() {
    for name in StrategyRegistry::default().names() {
        let outcome = short(name, 1, 4);
        let last = outcome.last();
        assert!(outcome.scans() >= 2, "{name} stopped at once: {last:?}");
        assert!(last.metres > 3.0 && last.coverage > outcome.steps[0].coverage, "{name}: {last:?}");
        assert_eq!(outcome.ways.len() + usize::from(outcome.stop.is_some()), outcome.scans(), "{name}");
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let figures = |seed| {
        let outcome = short("coverage_tour", seed, 4);
        let last = outcome.last();
        (outcome.scans(), last.metres.to_bits(), last.quality.to_bits(), last.coverage.to_bits())
    };
    assert_eq!(figures(3), figures(3));
    assert_ne!(figures(3), figures(4));
}

#[test]
fn every_weight_set_of_the_source_enters() {
    let entrants = entrants(&StrategyRegistry::default());
    assert_eq!(entrants.iter().filter(|e| e.strategy == "multi_criteria").count(), 10);
    assert!(entrants.iter().any(|e| e.strategy == "coverage_tour"));
}

#[test]
fn a_world_that_does_not_exist_is_named() {
    assert!(World::named("moon").err().unwrap().to_string().contains("moon"));
}

#[test]
fn the_source_s_figure_is_marked_as_literature() {
    let row = evaluate::literature();
    assert_eq!((row.provenance, row.summary.p50), (crate::Provenance::Literature, 15_330.0));
}
