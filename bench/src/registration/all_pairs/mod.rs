//! Any set of methods over all pairs of a data set: time, error, success rate, iterations. A user decides with it which
//! registration to ship.
//!
//! A pair is two scans whose true poses lie near each other; every method aligns every pair once, from raw points in memory,
//! after one pair for warming up, the methods in turns whose order is reversed pair by pair. The start is the prior motion,
//! or the identity where there are no priors.

mod data;
mod page;
mod plots;
mod rows;

use std::path::PathBuf;
use std::time::Instant;

use mirador_core::geometry::{Pose, rotation_angle};
use mirador_core::registration::{Limits, PairIds, Registration, RegistrationConfig, Registry};
use serde::Serialize;

pub use page::page;

use super::RegistrationBenchError;
use crate::{BenchReport, Machine};
use data::{DataSet, Pair};

/// What is measured on a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct AllPairsOptions {
    /// A folder of scan files.
    pub data: PathBuf,
    /// File with the true poses, relative to the folder; else the data's own poses.
    pub truth: Option<PathBuf>,
    /// File with prior poses, relative to the folder.
    pub poses: Option<PathBuf>,
    /// The methods; empty means all of the registry.
    pub methods: Vec<String>,
    /// Worker threads of each method.
    pub threads: usize,
    /// Settings of the methods, but for the threads.
    pub settings: RegistrationConfig,
    /// Scans farther apart than this make no pair [m].
    pub max_distance_m: f64,
    /// The largest translation error of a success [m].
    pub success_m: f64,
    /// The largest rotation error of a success [deg].
    pub success_deg: f64,
}

impl Default for AllPairsOptions {
    fn default() -> Self {
        Self {
            data: PathBuf::new(),
            truth: None,
            poses: None,
            methods: Vec::new(),
            threads: 2,
            settings: RegistrationConfig::default(),
            max_distance_m: 4.0,
            success_m: 0.1,
            success_deg: 1.0,
        }
    }
}

impl AllPairsOptions {
    fn validate(&self) -> Result<(), RegistrationBenchError> {
        let positive =
            [("max-distance", self.max_distance_m), ("success-m", self.success_m), ("success-deg", self.success_deg)];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(RegistrationBenchError::BadOption { field, reason: format!("{value} is not above 0") });
            }
        }
        if self.threads == 0 {
            return Err(RegistrationBenchError::BadOption { field: "threads", reason: "0 is not at least 1".into() });
        }
        Ok(())
    }
}

/// What a method made of a pair.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Attempt {
    /// Number of the target scan.
    pub target: usize,
    /// Number of the source scan.
    pub source: usize,
    /// How far they truly are apart [m].
    pub distance_m: f64,
    /// From raw points to the pose [ms].
    pub ms: f64,
    /// Of the translation [m]; null where there is no pose.
    pub translation_error_m: Option<f64>,
    /// Of the rotation [deg]; null where there is no pose.
    pub rotation_error_deg: Option<f64>,
    /// Steps taken.
    pub iterations: Option<u32>,
    /// Share of the source's points with a partner.
    pub overlap: Option<f64>,
    /// Whether both errors are those of a success.
    pub success: bool,
}

/// Everything a method did.
#[derive(Debug, Clone, PartialEq)]
pub struct Entrant {
    /// The method.
    pub method: String,
    /// Pair by pair.
    pub attempts: Vec<Attempt>,
}

/// What came of a data set.
#[derive(Debug, Clone)]
pub struct AllPairs {
    /// Name of the data set: its folder.
    pub name: String,
    /// What it was measured with.
    pub options: AllPairsOptions,
    /// In words: scans, pairs, truth, starts.
    pub about: Vec<String>,
    /// The methods.
    pub entrants: Vec<Entrant>,
    /// As rows.
    pub report: BenchReport,
}

/// Whether a folder holds scans itself, so that it is a data set and not a folder of data sets.
#[must_use]
pub fn is_data_set(folder: &std::path::Path) -> bool {
    !folder.join("target_from_source.txt").is_file()
        && mirador_core::formats::list_scans(folder).is_ok_and(|scans| !scans.files.is_empty())
}

/// Measures the methods of `registry` on all pairs, and beside them one that is there already, until all is measured or
/// `is_stopped` says that the user does not want it any more.
///
/// # Errors
/// See [`RegistrationBenchError`].
pub fn run(
    options: &AllPairsOptions,
    registry: &Registry,
    another: Option<Box<dyn Registration>>,
    is_stopped: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<AllPairs, RegistrationBenchError> {
    options.validate()?;
    let mut names: Vec<String> = match options.methods.as_slice() {
        [] if another.is_some() => Vec::new(),
        [] => registry.names().map(str::to_owned).collect(),
        named => named.to_vec(),
    };
    let mut methods = Vec::new();
    for name in &names {
        let settings = RegistrationConfig { threads: options.threads, ..options.settings.clone() };
        methods.push(registry.create(name, &settings)?);
    }
    names.extend(another.iter().map(|method| method.name().to_owned()));
    methods.extend(another);
    let data = DataSet::read(options)?;
    data.about.iter().for_each(|line| say(line));
    let mut entrants: Vec<Entrant> = names.into_iter().map(|method| Entrant { method, attempts: Vec::new() }).collect();
    let limits = Limits::default();
    if let Some(first) = data.pairs.first() {
        for method in &mut methods {
            attempt(&mut **method, &data, first, &limits, options);
        }
    }
    for (number, pair) in data.pairs.iter().enumerate() {
        if is_stopped() {
            return Err(RegistrationBenchError::Interrupted);
        }
        if number % 50 == 0 {
            say(&format!("pair {} of {}", number + 1, data.pairs.len()));
        }
        let mut turns: Vec<_> = methods.iter_mut().zip(&mut entrants).collect();
        if number % 2 == 1 {
            turns.reverse();
        }
        for (method, entrant) in turns {
            entrant.attempts.push(attempt(&mut **method, &data, pair, &limits, options));
        }
    }
    let rows = rows::rows(&data.name, options, &entrants);
    let report = BenchReport { bench: "registration".into(), machine: Machine::here(), rows };
    Ok(AllPairs { name: data.name, options: options.clone(), about: data.about, entrants, report })
}

fn attempt(
    method: &mut dyn Registration,
    data: &DataSet,
    pair: &Pair,
    limits: &Limits,
    options: &AllPairsOptions,
) -> Attempt {
    method.name_pair(PairIds { target: Some(pair.target as u64), source: Some(pair.source as u64) });
    let begin = Instant::now();
    let aligned = match (method.prepare(data.view(pair.target)), method.prepare(data.view(pair.source))) {
        (Ok(target), Ok(source)) => method.align(&*target, &*source, &pair.start, limits).ok(),
        _ => None,
    };
    let ms = begin.elapsed().as_secs_f64() * 1e3;
    let errors = aligned.as_ref().map(|alignment| errors(&pair.truth, &alignment.target_from_source));
    Attempt {
        target: pair.target,
        source: pair.source,
        distance_m: pair.truth.translation.vector.norm(),
        ms,
        translation_error_m: errors.map(|(metres, _)| metres),
        rotation_error_deg: errors.map(|(_, degrees)| degrees),
        iterations: aligned.as_ref().map(|alignment| alignment.iterations),
        overlap: aligned.as_ref().map(|alignment| alignment.overlap),
        success: errors.is_some_and(|(m, deg)| m <= options.success_m && deg <= options.success_deg),
    }
}

/// Translation [m] and rotation [deg] between a pose and the truth.
fn errors(truth: &Pose, found: &Pose) -> (f64, f64) {
    let error = truth.inverse() * found;
    (error.translation.vector.norm(), rotation_angle(&error).to_degrees())
}
