//! All runs that are there, by entry.

use std::collections::BTreeMap;

use super::store::Store;
use super::{Entry, ExperimentError, RunRecord, Settings};
use crate::Summary;
use crate::exploration::{Step, WorldQuality};

/// The runs of an entry, in the order of their seeds.
#[derive(Debug, Clone)]
pub struct Group {
    /// What was run.
    pub entry: Entry,
    /// The runs that are there.
    pub runs: Vec<RunRecord>,
}

/// All runs that are there.
#[derive(Debug, Clone)]
pub struct Results {
    /// What was asked for.
    pub settings: Settings,
    /// One for every entry.
    pub groups: Vec<Group>,
    /// The ceiling of quality of the worlds that have been measured.
    pub ceilings: BTreeMap<String, WorldQuality>,
}

impl Results {
    pub(super) fn read(settings: &Settings, entries: &[Entry], store: &Store) -> Result<Self, ExperimentError> {
        let mut groups = Vec::new();
        for entry in entries {
            let mut runs = Vec::new();
            for seed in settings.all_seeds() {
                runs.extend(store.read(&format!("runs/{}-{seed}.json", entry.id()))?);
            }
            groups.push(Group { entry: entry.clone(), runs });
        }
        let mut ceilings = BTreeMap::new();
        for world in &settings.worlds {
            let ceiling: Option<WorldQuality> = store.read(&format!("runs/{world}-ceiling.json"))?;
            ceilings.extend(ceiling.map(|ceiling| (world.clone(), ceiling)));
        }
        Ok(Self { settings: settings.clone(), groups, ceilings })
    }

    /// Whether every run that was asked for is there.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let all_runs = self.groups.iter().all(|group| group.runs.len() as u64 == self.settings.seeds);
        all_runs && self.ceilings.len() == self.settings.worlds.len()
    }

    /// The groups of a world.
    pub fn of_world<'a>(&'a self, world: &'a str) -> impl Iterator<Item = &'a Group> + 'a {
        self.groups.iter().filter(move |group| group.entry.world == world)
    }
}

impl Group {
    /// A figure of every run at its end; none without runs.
    #[must_use]
    pub fn summary(&self, of: impl Fn(&RunRecord) -> f64) -> Option<Summary> {
        Summary::of(&self.runs.iter().map(of).collect::<Vec<_>>())
    }

    /// A figure of the last step of every run.
    #[must_use]
    pub fn at_end(&self, of: impl Fn(&Step) -> f64) -> Option<Summary> {
        Summary::of(&self.runs.iter().filter_map(|run| run.last().map(&of)).collect::<Vec<_>>())
    }

    /// A figure of every step of every run.
    #[must_use]
    pub fn of_steps(&self, of: impl Fn(&Step) -> f64) -> Option<Summary> {
        Summary::of(&self.runs.iter().flat_map(|run| run.steps.iter().map(&of)).collect::<Vec<_>>())
    }

    /// Runs by the reason for which they stopped.
    #[must_use]
    pub fn stops(&self) -> BTreeMap<String, usize> {
        let mut stops = BTreeMap::new();
        for run in &self.runs {
            *stops.entry(run.stop_word()).or_insert(0) += 1;
        }
        stops
    }

    /// Targets given up in all runs, by what was there.
    #[must_use]
    pub fn given_up(&self) -> BTreeMap<String, usize> {
        let mut given_up = BTreeMap::new();
        for target in self.runs.iter().flat_map(|run| &run.given_up) {
            *given_up.entry(target.what.clone()).or_insert(0) += 1;
        }
        given_up
    }

    /// Runs that did not end by their own criterion.
    #[must_use]
    pub fn failures(&self) -> usize {
        self.runs.iter().filter(|run| run.is_failure()).count()
    }
}
