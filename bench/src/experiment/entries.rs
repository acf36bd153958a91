//! What is run: the source's experiments in their worlds, and every strategy in every world.

use mirador_core::view_planning::StrategyRegistry;

use super::ExperimentError;
use super::literature::{LITERATURE, Literature};
use crate::exploration::WEIGHTS;

/// A strategy with its weights in a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The source's name of the experiment; empty for what it did not do.
    pub experiment: String,
    /// The world.
    pub world: String,
    /// The strategy.
    pub strategy: String,
    /// Name of the weight set; empty for strategies without weights.
    pub weights_name: String,
    /// w_A, w_Q, w_O, w_C, for strategies that use them.
    pub weights: Option<[f64; 4]>,
}

impl Entry {
    /// Names the entry in file names: unlike that of every other.
    #[must_use]
    pub fn id(&self) -> String {
        let rest = if self.weights_name.is_empty() { self.strategy.clone() } else { slug(&self.weights_name) };
        format!("{}-{rest}", self.world)
    }

    /// What it is called in tables.
    #[must_use]
    pub fn label(&self) -> String {
        match (self.experiment.as_str(), self.weights_name.as_str()) {
            ("", "") => self.strategy.clone(),
            ("", weights) => format!("weights of {weights}"),
            (experiment, _) => experiment.to_owned(),
        }
    }

    /// The source's figures for this experiment.
    #[must_use]
    pub fn literature(&self) -> Option<&'static Literature> {
        LITERATURE.iter().find(|known| known.experiment == self.experiment)
    }

    /// Whether it is the source's multi-criteria utility, with whichever weights.
    #[must_use]
    pub fn is_weighted(&self) -> bool {
        self.weights.is_some()
    }

    fn is_called(&self, name: &str) -> bool {
        name == self.strategy || (!self.experiment.is_empty() && name == slug(&self.experiment))
    }
}

/// `simple II` is `simple_ii` on the command line.
fn slug(name: &str) -> String {
    name.to_lowercase().replace(' ', "_")
}

/// Everything there is in a world: the source's experiments there, its weight sets of the other worlds, and every other
/// strategy.
fn all_in(world: &str, registry: &StrategyRegistry) -> Vec<Entry> {
    let belongs = |name: &str| name.split(' ').next() == Some(world);
    let experiment_of = |name: &str| if belongs(name) { name.to_owned() } else { String::new() };
    let is_simulated = |name: &str| LITERATURE.iter().any(|known| known.experiment == name);
    let weighted = WEIGHTS.iter().filter(|(name, _)| is_simulated(name)).map(|&(name, weights)| Entry {
        experiment: experiment_of(name),
        world: world.to_owned(),
        strategy: "multi_criteria".into(),
        weights_name: name.to_owned(),
        weights: Some(weights),
    });
    let others = registry.names().filter(|&name| name != "multi_criteria").map(|name| Entry {
        experiment: if world == "simple" && name == "greedy_new_cells" { "simple IV".into() } else { String::new() },
        world: world.to_owned(),
        strategy: name.to_owned(),
        weights_name: String::new(),
        weights: None,
    });
    let mut entries: Vec<Entry> = weighted.chain(others).collect();
    // The source's own first, in its order.
    entries.sort_by_key(|entry| (entry.experiment.is_empty(), entry.experiment.clone()));
    entries
}

/// The entries of these worlds that go by one of `names` (all when there are none): a strategy's name, or that of an
/// experiment as `simple_ii`.
///
/// # Errors
/// When a name means nothing in these worlds; the error lists what there is.
pub fn entries(
    worlds: &[String],
    names: &[String],
    registry: &StrategyRegistry,
) -> Result<Vec<Entry>, ExperimentError> {
    let all: Vec<Entry> = worlds.iter().flat_map(|world| all_in(world, registry)).collect();
    if let Some(unknown) = names.iter().find(|name| !all.iter().any(|entry| entry.is_called(name))) {
        let mut known: Vec<String> =
            all.iter().filter(|e| !e.experiment.is_empty()).map(|e| slug(&e.experiment)).collect();
        known.extend(registry.names().map(str::to_owned));
        let reason = format!(
            "nothing in the worlds {} is called `{unknown}`; there are: {}",
            worlds.join(", "),
            known.join(", ")
        );
        return Err(ExperimentError::BadOption { option: "experiments", reason });
    }
    Ok(all.into_iter().filter(|e| names.is_empty() || names.iter().any(|name| e.is_called(name))).collect())
}
