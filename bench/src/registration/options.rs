//! What is measured, and how often.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::RegistrationBenchError;

/// The kinds of rows that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Case {
    /// Two scans, from raw points in memory to the pose.
    Pair,
    /// Recorded scans in a row.
    Sequence,
    /// Pose graphs brought to their optimum.
    Relaxation,
    /// The scans of the source's scanner around a block of houses.
    Loop,
    /// A long drive: time and memory as the map grows.
    Growth,
}

impl Case {
    /// All of them, in the order of the report.
    pub const ALL: [Self; 5] = [Self::Pair, Self::Sequence, Self::Relaxation, Self::Loop, Self::Growth];

    /// Its name on the command line and in the report.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pair => "pair",
            Self::Sequence => "sequence",
            Self::Relaxation => "relaxation",
            Self::Loop => "loop",
            Self::Growth => "growth",
        }
    }
}

impl FromStr for Case {
    type Err = RegistrationBenchError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|case| case.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|case| case.name()).collect();
            let reason = format!("there is no case called `{name}`; known are: {}", known.join(", "));
            RegistrationBenchError::BadOption { field: "cases", reason }
        })
    }
}

/// The options of the registration benchmark.
#[derive(Debug, Clone)]
pub struct RegistrationOptions {
    /// How often every contestant runs, apart from one round of warming up. Sequences run a quarter as often.
    pub repetitions: usize,
    /// Names of our methods; empty means all of the registry.
    pub methods: Vec<String>,
    /// Kinds of rows.
    pub cases: Vec<Case>,
    /// Scans of the drive of `growth`.
    pub growth_scans: usize,
    /// The folder of the data sets, or one folder with source, target and target_from_source.txt.
    pub data: PathBuf,
    /// The Python that has the peers; without one they are left out.
    pub python: Option<PathBuf>,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        Self {
            repetitions: 11,
            methods: Vec::new(),
            cases: Case::ALL.to_vec(),
            growth_scans: 4000,
            data: default_data(),
            python: Some(default_python()),
        }
    }
}

impl RegistrationOptions {
    /// Checks every field.
    ///
    /// # Errors
    /// [`RegistrationBenchError::BadOption`] with the first field out of range.
    pub fn validate(&self) -> Result<(), RegistrationBenchError> {
        if !(1..=10_000).contains(&self.repetitions) {
            let reason = format!("{} is not between 1 and 10000", self.repetitions);
            return Err(RegistrationBenchError::BadOption { field: "repetitions", reason });
        }
        if !(10..=100_000).contains(&self.growth_scans) {
            let reason = format!("{} is not between 10 and 100000", self.growth_scans);
            return Err(RegistrationBenchError::BadOption { field: "growth_scans", reason });
        }
        Ok(())
    }

    /// How often a whole sequence runs.
    pub(super) fn sequence_repetitions(&self) -> usize {
        self.repetitions.div_ceil(4)
    }

    pub(super) fn wants(&self, case: Case) -> bool {
        self.cases.contains(&case)
    }
}

/// Where data lies unless told otherwise: `MIRADOR_DATA`, else `../shared/data` beside the project.
fn default_data() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    std::env::var_os("MIRADOR_DATA").map_or_else(beside, PathBuf::from)
}

/// The Python that is used unless told otherwise: `MIRADOR_PYTHON`, else `python3` on the path.
fn default_python() -> PathBuf {
    std::env::var_os("MIRADOR_PYTHON").map_or_else(|| "python3".into(), PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_case_is_told_which_there_are() {
        let error = "pears".parse::<Case>().unwrap_err().to_string();
        assert!(error.contains("`pears`") && error.contains("pair, sequence"), "{error}");
        for case in Case::ALL {
            assert_eq!(case.name().parse::<Case>().unwrap(), case);
        }
    }

    #[test]
    fn no_repetition_is_refused() {
        let options = RegistrationOptions { repetitions: 0, ..RegistrationOptions::default() };
        assert!(options.validate().unwrap_err().to_string().contains("repetitions"));
        RegistrationOptions::default().validate().unwrap();
    }
}
