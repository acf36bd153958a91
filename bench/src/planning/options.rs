//! What is measured, and how often.

use std::str::FromStr;

use mirador_core::view_planning::StrategyRegistry;

use super::PlanningBenchError;

/// The kinds of rows that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanningCase {
    /// Plans after forty scans of the source's scanner, by every strategy.
    Evaluate,
    /// Plans as the map grows to thousands of scans.
    Growth,
    /// Whole explorations: scans, metres, quality and coverage by strategy and weights.
    Exploration,
}

impl PlanningCase {
    /// All of them, in the order of the report.
    pub const ALL: [Self; 3] = [Self::Evaluate, Self::Growth, Self::Exploration];

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Evaluate => "evaluate",
            Self::Growth => "growth",
            Self::Exploration => "exploration",
        }
    }
}

impl FromStr for PlanningCase {
    type Err = PlanningBenchError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|case| case.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|case| case.name()).collect();
            let reason = format!("there is no case called `{name}`; known are: {}", known.join(", "));
            PlanningBenchError::BadOption { field: "cases", reason }
        })
    }
}

/// The options of the planning benchmark.
#[derive(Debug, Clone)]
pub struct PlanningOptions {
    /// Plans timed for each row.
    pub repetitions: usize,
    /// Kinds of rows.
    pub cases: Vec<PlanningCase>,
    /// Names of the strategies; empty means all.
    pub strategies: Vec<String>,
    /// Scans of the drive of `growth`.
    pub growth_scans: usize,
    /// Explorations of each strategy in each world, with seeds 1, 2, ...
    pub seeds: u64,
    /// Explorations scan with steps this much coarser than the source's 0.5 deg: 1 is the source's scanner.
    pub coarser: usize,
}

impl Default for PlanningOptions {
    fn default() -> Self {
        Self {
            repetitions: 15,
            cases: PlanningCase::ALL.to_vec(),
            strategies: Vec::new(),
            growth_scans: 4000,
            seeds: 3,
            coarser: 4,
        }
    }
}

impl PlanningOptions {
    /// Checks every field.
    ///
    /// # Errors
    /// [`PlanningBenchError::BadOption`] with the first field out of range, [`PlanningBenchError::Strategy`] for a name
    /// that `registry` does not know.
    pub fn validate(&self, registry: &StrategyRegistry) -> Result<(), PlanningBenchError> {
        for name in &self.strategies {
            registry.create(name)?;
        }
        let check = |field, value: usize, range: std::ops::RangeInclusive<usize>| {
            if range.contains(&value) {
                return Ok(());
            }
            let reason = format!("{value} is not between {} and {}", range.start(), range.end());
            Err(PlanningBenchError::BadOption { field, reason })
        };
        check("repetitions", self.repetitions, 1..=39)?;
        check("growth_scans", self.growth_scans, 40..=100_000)?;
        check("seeds", self.seeds as usize, 1..=1000)?;
        check("coarser", self.coarser, 1..=10)
    }

    pub(super) fn wants(&self, strategy: &str) -> bool {
        self.strategies.is_empty() || self.strategies.iter().any(|name| name == strategy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_case_is_told_which_there_are() {
        let error = "pears".parse::<PlanningCase>().unwrap_err().to_string();
        assert!(error.contains("`pears`") && error.contains("evaluate, growth"), "{error}");
        for case in PlanningCase::ALL {
            assert_eq!(case.name().parse::<PlanningCase>().unwrap(), case);
        }
    }

    #[test]
    fn options_out_of_range_are_named() {
        let refused =
            |options: PlanningOptions| options.validate(&StrategyRegistry::default()).unwrap_err().to_string();
        assert!(refused(PlanningOptions { repetitions: 0, ..Default::default() }).contains("repetitions"));
        assert!(refused(PlanningOptions { growth_scans: 3, ..Default::default() }).contains("growth_scans"));
        PlanningOptions::default().validate(&StrategyRegistry::default()).unwrap();
    }
}
