//! Strategies by name.

use super::exponential::ExponentialGain;
use super::frontier::Frontier;
use super::greedy::{Greedy, GreedyTarget};
use super::multi_criteria::MultiCriteria;
use super::random::Random;
use super::strategy::Strategy;
use super::tour::CoverageTour;
use thiserror::Error;

/// Makes a strategy in its initial state.
pub type MakeStrategy = fn() -> Box<dyn Strategy>;

/// No strategy has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("planning: no strategy is called {name:?}; there are: {}", known.join(", "))]
pub struct UnknownStrategy {
    /// The name asked for.
    pub name: String,
    /// The names there are.
    pub known: Vec<String>,
}

/// The strategies that can be chosen by name. [`StrategyRegistry::default`] holds the built-in ones; a program of
/// one's own adds to them by one [`StrategyRegistry::register`].
#[derive(Clone)]
pub struct StrategyRegistry {
    entries: Vec<(String, MakeStrategy)>,
}

impl Default for StrategyRegistry {
    fn default() -> Self {
        let mut registry = Self { entries: Vec::new() };
        registry.register("multi_criteria", || Box::new(MultiCriteria::default()));
        registry.register("coverage_tour", || Box::new(CoverageTour::default()));
        registry.register("frontier", || Box::<Frontier>::default());
        registry.register("greedy_unvisited", || Box::new(Greedy::new(GreedyTarget::Unvisited)));
        registry.register("greedy_unscanned", || Box::new(Greedy::new(GreedyTarget::Unscanned)));
        registry.register("greedy_replanning", || Box::new(Greedy::new(GreedyTarget::Replanning)));
        registry.register("greedy_informative", || Box::new(Greedy::new(GreedyTarget::Informative)));
        registry.register("greedy_new_cells", || Box::new(Greedy::new(GreedyTarget::NewCells)));
        registry.register("exponential_gain", || Box::<ExponentialGain>::default());
        registry.register("random", || Box::new(Random::default()));
        registry
    }
}

impl StrategyRegistry {
    /// Adds a strategy, or replaces the one of the same name.
    pub fn register(&mut self, name: &str, make: MakeStrategy) {
        self.entries.retain(|(known, _)| known != name);
        self.entries.push((name.to_owned(), make));
    }

    /// The names, in the order of registration.
    pub fn names(&self) -> impl Iterator<Item = &str> + '_ {
        self.entries.iter().map(|(name, _)| name.as_str())
    }

    /// A new strategy of that name.
    ///
    /// # Errors
    /// [`UnknownStrategy`] lists the names there are.
    pub fn create(&self, name: &str) -> Result<Box<dyn Strategy>, UnknownStrategy> {
        match self.entries.iter().find(|(known, _)| known == name) {
            Some((_, make)) => Ok(make()),
            None => Err(UnknownStrategy { name: name.to_owned(), known: self.names().map(str::to_owned).collect() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let message = StrategyRegistry::default().create("fronteer").err().unwrap().to_string();
        assert!(
            message.contains("fronteer") && message.contains("multi_criteria, coverage_tour, frontier"),
            "{message}"
        );
    }

    #[test]
    fn a_strategy_of_ones_own_can_be_added_or_replace_a_built_in() {
        let mut registry = StrategyRegistry::default();
        registry.register("mine", || Box::<Frontier>::default());
        registry.register("frontier", || Box::new(MultiCriteria::default()));
        assert_eq!(registry.create("mine").unwrap().name(), "frontier");
        assert_eq!(registry.create("frontier").unwrap().name(), "multi_criteria");
        assert_eq!(registry.names().count(), StrategyRegistry::default().names().count() + 1);
    }

    #[test]
    fn a_strategy_goes_by_the_name_it_is_registered_under() {
        let registry = StrategyRegistry::default();
        for name in registry.names() {
            assert_eq!(registry.create(name).unwrap().name(), name);
        }
    }
}
