//! What decides the figures of an experiment.

use std::collections::{BTreeMap, BTreeSet};

use mirador_core::simulation::ScannerConfig;
use mirador_core::view_planning::{PlanningConfig, StrategyRegistry};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Entry, ExperimentError, entries};
use crate::exploration::{Exploration, World, coarser, for_scanner};

/// What decides the figures of an experiment: runs of other settings are not mixed with these.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Version of the program.
    pub version: String,
    /// Names of the worlds.
    pub worlds: Vec<String>,
    /// Experiments (`simple_ii`) and strategies; empty means all.
    pub experiments: Vec<String>,
    /// The first seed.
    pub first_seed: u64,
    /// Runs of every entry, with seeds from `first_seed` on.
    pub seeds: u64,
    /// The scanner's steps are this much coarser than the source's 0.5 deg.
    pub coarser: usize,
    /// A run is cut off after so many scans.
    pub max_scans: usize,
    /// d_max of the source's stop rule [m].
    pub farthest_m: f64,
    /// The planner's other settings. Strategy and weights are those of the experiment, the scanner is that of the robot, and the
    /// work area that of the world.
    #[serde(default)]
    pub planning: PlanningConfig,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            worlds: ["simple", "structured", "unstructured"].map(String::from).to_vec(),
            experiments: Vec::new(),
            first_seed: 1,
            seeds: 10,
            coarser: 1,
            max_scans: 120,
            farthest_m: PlanningConfig::default().farthest_m,
            planning: PlanningConfig::default(),
        }
    }
}

impl Settings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ExperimentError::BadOption`] with the first field that is wrong.
    pub fn validate(&self, registry: &StrategyRegistry) -> Result<(), ExperimentError> {
        let refuse = |option, reason| Err(ExperimentError::BadOption { option, reason });
        let known = World::names();
        if let Some(world) = self.worlds.iter().find(|world| !known.contains(&world.as_str())) {
            return refuse("worlds", format!("there is no world called `{world}`; there are: {}", known.join(", ")));
        }
        let twice = |list: &[String]| list.iter().enumerate().any(|(k, name)| list[..k].contains(name));
        if self.worlds.is_empty() || twice(&self.worlds) {
            return refuse("worlds", "name at least one world, and each only once".into());
        }
        let check = |option, value: u64, range: std::ops::RangeInclusive<u64>| {
            let reason = format!("{value} is not between {} and {}", range.start(), range.end());
            if range.contains(&value) { Ok(()) } else { Err(ExperimentError::BadOption { option, reason }) }
        };
        check("seeds", self.seeds, 1..=1000)?;
        check("first-seed", self.first_seed, 0..=1_000_000_000)?;
        check("coarser", self.coarser as u64, 1..=10)?;
        check("max-scans", self.max_scans as u64, 1..=10_000)?;
        if !(1.0..=1e4).contains(&self.farthest_m) {
            return refuse("farthest", format!("{} is not between 1 and 10000 m", self.farthest_m));
        }
        if let Err(error) = self.planning.validate() {
            return refuse("set", format!("planning.view: {error}"));
        }
        entries(&self.worlds, &self.experiments, registry).map(|_| ())
    }

    /// Where these differ from others, field by field, in words; `None` where they do not.
    pub(super) fn differences(&self, kept: &Self) -> Option<String> {
        let fields = |settings: &Self| {
            let mut fields = BTreeMap::new();
            flatten(String::new(), serde_json::to_value(settings).unwrap_or_default(), &mut fields);
            fields
        };
        let (now, then) = (fields(self), fields(kept));
        let keys: BTreeSet<&String> = now.keys().chain(then.keys()).collect();
        let value = |fields: &BTreeMap<String, Value>, key: &String| fields.get(key).cloned().unwrap_or_default();
        let differences: Vec<String> = keys
            .into_iter()
            .filter(|key| now.get(*key) != then.get(*key))
            .map(|key| format!("{key} was {}, now {}", value(&then, key), value(&now, key)))
            .collect();
        (!differences.is_empty()).then(|| differences.join("; "))
    }

    /// The scanner: one that loses and mixes returns as an LMS111 does.
    pub(super) fn scanner(&self) -> ScannerConfig {
        coarser(&ScannerConfig::lms111(), self.coarser)
    }

    /// The seeds.
    pub(super) fn all_seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.seeds
    }

    /// One run.
    pub(super) fn exploration(&self, entry: &Entry, seed: u64, threads: usize) -> Exploration {
        let scanner = self.scanner();
        let mut planning = PlanningConfig {
            strategy: entry.strategy.clone(),
            farthest_m: self.farthest_m,
            ..for_scanner(self.planning.clone(), &scanner)
        };
        if let Some([information, quality, zones, cost]) = entry.weights {
            planning.weights = mirador_core::view_planning::Weights { information, quality, zones, cost };
        }
        Exploration { scanner, planning, seed, max_scans: self.max_scans, threads }
    }
}

/// The values of a tree by their dotted paths.
fn flatten(path: String, value: Value, into: &mut BTreeMap<String, Value>) {
    let Value::Object(fields) = value else {
        into.insert(path, value);
        return;
    };
    for (key, value) in fields {
        let path = if path.is_empty() { key } else { format!("{path}.{key}") };
        flatten(path, value, into);
    }
}
