use super::*;
use mirador_core::view_planning::PlanningConfig;

/// A short exploration with a coarse scanner.
fn short(strategy: &str, seed: u64, max_scans: usize) -> Outcome {
    let scanner = scanner(8);
    let planning = PlanningConfig { strategy: strategy.into(), ..planning_config(&scanner) };
    let world = World::named("simple").unwrap();
    Exploration { scanner, planning, seed, max_scans }.run(&world, &StrategyRegistry::default()).unwrap()
}

#[test]
fn every_strategy_explores_the_simple_world() {
    for name in StrategyRegistry::default().names() {
        let outcome = short(name, 1, 4);
        assert!(outcome.scans >= 2, "{name} stopped at once: {outcome:?}");
        assert!(outcome.metres > 3.0 && outcome.coverage > 0.3, "{name}: {outcome:?}");
        assert_eq!(outcome.plan_ms.len(), outcome.scans);
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let figures = |seed| {
        let o = short("coverage_tour", seed, 4);
        (o.scans, o.metres.to_bits(), o.mean_quality.to_bits(), o.coverage.to_bits())
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
