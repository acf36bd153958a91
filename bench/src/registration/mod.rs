//! `mirador bench registration`: how fast and how right our registration is, beside the peers from PyPI.
//!
//! Everything is timed from raw points in memory to the pose, preparation of both scans included. Our methods run with
//! the settings that users get; the peers with those of the published comparisons (voxels of 0.25 m, 10 neighbours, a
//! farthest partner at 1 m, at 2 m for `handheld_pair`) and the tolerances that their packages come with. They run in
//! processes of their own, take their points in the form they like best before the clock starts, and measure
//! themselves. All contestants of a pair run in turns, in an order that is reversed every round.
//!
//! Rows of the report:
//!
//! - `pair`: params method, data, threads, peer; unit ms; translation_error_m, rotation_error_deg, iterations, overlap
//!   and `parts` (prepare_target, prepare_source, align), medians all. What is not known is null.
//! - `pair_ratio`: our fastest method that is at least as accurate as one method of a peer, over that one; errors below
//!   the accuracy of the truth are alike. `same_accuracy` is false where no method of ours is, and `fastest_peer` marks
//!   the peer's fastest.
//! - `sequence`: scans in a row; params method, data, threads, peer, prior (odometry or none), per (sequence: the time of
//!   all scans; frame: the time of each but the first); error of the trajectory, first poses laid on each other.
//! - `relaxation`: a pose graph from memory to its optimum; sums of squares as g2o reckons them.
//! - `loop`: the time of each scan of the source's scanner (720 sweeps of 541 beams) on a tour around a block of simulated
//!   houses, loops and corrections included.
//! - `growth`: the time of a scan, and the memory, when the map of a long simulated drive has so many scans. Scans that
//!   looked for a loop are set apart.

pub mod all_pairs;
mod chain_relaxation;
mod contest;
mod data;
mod error;
mod growth;
mod literature;
mod mapper;
mod odometry;
mod options;
mod ours;
mod pair;
mod peer_process;
mod peers;
mod print;
mod ratio;
mod relaxation;
mod sequence;
pub mod simulated;
mod tour;

pub use data::{Accuracy, PairData, SequenceData};
pub use error::RegistrationBenchError;
use mirador_core::registration::{RegistrationConfig, Registry};
pub use options::{Case, RegistrationOptions};
pub use peer_process::{PeerError, PeerProcess};
pub use print::print_comparison;
pub(crate) use simulated::town_drive;
pub use simulated::{SimulatedDrive, long_drive, tour_around_a_block};

use crate::{BenchReport, Machine};

/// The numbers of threads that are measured.
pub(crate) const THREADS: [usize; 2] = [1, 2];

/// Measures the methods of `registry` and the peers that are installed. `say` is told what goes on, a line at a time:
/// progress, absent data, absent or failing peers.
///
/// # Errors
/// See [`RegistrationBenchError`].
pub fn run(
    options: &RegistrationOptions,
    registry: &Registry,
    say: &mut dyn FnMut(&str),
) -> Result<BenchReport, RegistrationBenchError> {
    options.validate()?;
    let methods = methods(options, registry)?;
    // Whole maps are measured with the method that users get, unless they name others.
    let chain = if options.methods.is_empty() { vec![ours::DEFAULT_METHOD.to_owned()] } else { methods.clone() };
    let machine = Machine::here();
    let peers = peers::Peers::start(options, &THREADS, say);
    let mut rows = Vec::new();
    if options.wants(Case::Pair) {
        rows.extend(pair::rows(options, registry, &methods, &peers, say)?);
    }
    if options.wants(Case::Sequence) {
        rows.extend(sequence::rows(options, registry, &chain, &peers, say)?);
    }
    if options.wants(Case::Relaxation) {
        rows.extend(relaxation::rows(options, &peers, say)?);
    }
    if options.wants(Case::Loop) {
        rows.extend(tour::rows(options, registry, &chain, say)?);
    }
    if options.wants(Case::Growth) {
        rows.extend(growth::rows(options, registry, &chain, say)?);
    }
    if rows.is_empty() {
        let reason = format!("no data at {}; name its folder by --data or MIRADOR_DATA", options.data.display());
        return Err(RegistrationBenchError::NothingMeasured { reason });
    }
    Ok(BenchReport { bench: "registration".into(), machine, rows })
}

/// The methods to measure, each of which can be made.
fn methods(options: &RegistrationOptions, registry: &Registry) -> Result<Vec<String>, RegistrationBenchError> {
    let methods: Vec<String> = match options.methods.as_slice() {
        [] => registry.names().map(str::to_owned).collect(),
        named => named.to_vec(),
    };
    for method in &methods {
        registry.create(method, &RegistrationConfig::default())?;
    }
    Ok(methods)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> RegistrationOptions {
        RegistrationOptions {
            python: None,
            data: "/no/such/folder".into(),
            cases: vec![Case::Pair, Case::Sequence],
            ..RegistrationOptions::default()
        }
    }

    #[test]
    fn without_data_there_is_an_error_that_says_what_to_do() {
        let error = run(&options(), &Registry::default(), &mut |_| {}).unwrap_err().to_string();
        assert!(error.contains("/no/such/folder") && error.contains("MIRADOR_DATA"), "{error}");
    }

    #[test]
    fn an_unknown_method_is_refused_before_anything_runs() {
        let options = RegistrationOptions { methods: vec!["pears".into()], ..options() };
        let mut said = Vec::new();
        let error = run(&options, &Registry::default(), &mut |line| said.push(line.to_owned())).unwrap_err();
        assert!(matches!(error, RegistrationBenchError::Registry(_)), "{error}");
        assert!(said.is_empty(), "{said:?}");
    }
}
