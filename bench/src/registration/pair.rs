//! `pair` and `pair_ratio` rows.

use std::collections::BTreeMap;

use mirador_core::geometry::rotation_angle;
use mirador_core::registration::Registry;
use serde_json::json;

use super::contest::{self, Contestant, Outcome, Sample};
use super::data::{PairData, for_each_pair};
use super::ours::OurPair;
use super::peers::{PeerPair, Peers};
use super::ratio::{Entry, choose, fastest};
use super::{RegistrationBenchError, RegistrationOptions, THREADS};
use crate::{Provenance, Row, Summary};

/// Whose the row is.
#[derive(Debug, Clone, PartialEq)]
struct Entrant {
    method: String,
    threads: usize,
    version: Option<String>,
}

impl Entrant {
    fn is_peer(&self) -> bool {
        self.version.is_some()
    }
}

/// The rows of all pairs that are there.
pub(super) fn rows(
    options: &RegistrationOptions,
    registry: &Registry,
    methods: &[String],
    peers: &Peers,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let (mut pairs, mut ratios) = (Vec::new(), Vec::new());
    for_each_pair(&options.data, say, |data, say| {
        say(&format!("pair {}: {} and {} points", data.name, data.target.len(), data.source.len()));
        let measured = measure(options.repetitions, registry, methods, peers, &data, say)?;
        pairs.extend(measured.iter().filter_map(|(entrant, samples)| pair_row(&data, entrant, samples)));
        for threads in THREADS {
            ratios.extend(ratio_rows(&data, threads, &measured));
        }
        Ok(())
    })?;
    pairs.append(&mut ratios);
    Ok(pairs)
}

/// Who has run, with all samples.
type Measured = Vec<(Entrant, Vec<Sample>)>;

fn measure(
    rounds: usize,
    registry: &Registry,
    methods: &[String],
    peers: &Peers,
    data: &PairData,
    say: &mut dyn FnMut(&str),
) -> Result<Measured, RegistrationBenchError> {
    let (mut entrants, mut contestants): (Vec<Entrant>, Vec<Box<dyn Contestant + '_>>) = (Vec::new(), Vec::new());
    for threads in THREADS {
        for method in methods {
            contestants.push(Box::new(OurPair::new(registry, method, threads, data)?));
            entrants.push(Entrant { method: method.clone(), threads, version: None });
        }
        for peer in peers.pair_contestants(threads, data) {
            let version = Some(peers.small_gicp_version().unwrap_or_default());
            entrants.push(Entrant { method: PeerPair::method(&peer), threads, version });
            contestants.push(Box::new(peer));
        }
    }
    let outcomes = contest::hold(&mut contestants, rounds, say);
    let whole = |outcome: Outcome| outcome.failure.is_none().then_some(outcome.samples);
    Ok(entrants.into_iter().zip(outcomes).filter_map(|(entrant, o)| Some((entrant, whole(o)?))).collect())
}

/// Errors of a pose: translation [m] and, where the true rotation is known, rotation [deg].
fn errors(data: &PairData, sample: &Sample) -> (f64, Option<f64>) {
    let error = data.truth.inverse() * sample.pose;
    match data.accuracy.rotation_deg {
        Some(_) => (error.translation.vector.norm(), Some(rotation_angle(&error).to_degrees())),
        // A translation error in the source's frame would mix in the rotation, which is not known.
        None => ((sample.pose.translation.vector - data.truth.translation.vector).norm(), None),
    }
}

/// Time and error over all samples. The errors are medians: peers with several threads do not repeat themselves.
fn entry(data: &PairData, entrant: &Entrant, samples: &[Sample]) -> Option<Entry> {
    let times: Vec<f64> = samples.iter().map(|sample| sample.ms).collect();
    Some(Entry {
        method: entrant.method.clone(),
        time: Summary::of(&times)?,
        translation_error_m: contest::median(samples.iter().map(|s| errors(data, s).0))?,
        rotation_error_deg: contest::median(samples.iter().filter_map(|s| errors(data, s).1)),
    })
}

fn pair_row(data: &PairData, entrant: &Entrant, samples: &[Sample]) -> Option<Row> {
    let entry = entry(data, entrant, samples)?;
    let parts: Vec<&BTreeMap<String, f64>> = samples.iter().map(|sample| &sample.parts).collect();
    let iterations = contest::median(samples.iter().filter_map(|s| Some(s.iterations? as f64)));
    let overlap = contest::median(samples.iter().filter_map(|s| s.overlap));
    let mut extra = BTreeMap::from([
        ("translation_error_m".to_owned(), json!(entry.translation_error_m)),
        ("rotation_error_deg".into(), json!(entry.rotation_error_deg)),
        ("iterations".into(), json!(iterations.map(|n| n as u64))),
        ("overlap".into(), json!(overlap)),
        ("parts".into(), json!(contest::median_parts(&parts))),
    ]);
    if let Some(version) = &entrant.version {
        extra.insert("version".into(), json!(version));
    }
    Some(Row {
        name: "pair".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(entrant.method)),
            ("data".into(), json!(data.name)),
            ("threads".into(), json!(entrant.threads)),
            ("peer".into(), json!(entrant.is_peer())),
        ]),
        unit: "ms".into(),
        summary: entry.time,
        provenance: Provenance::Measured,
        extra,
    })
}

/// One row for each method of the peers: ours over it.
fn ratio_rows(data: &PairData, threads: usize, measured: &Measured) -> Vec<Row> {
    let entries = |peer: bool| -> Vec<Entry> {
        let chosen = measured.iter().filter(|(e, _)| e.threads == threads && e.is_peer() == peer);
        chosen.filter_map(|(entrant, samples)| entry(data, entrant, samples)).collect()
    };
    let (ours, theirs) = (entries(false), entries(true));
    let best = fastest(theirs.iter()).map(|peer| peer.method.clone());
    theirs.iter().filter_map(|peer| ratio_row(data, threads, &ours, peer, best.as_deref())).collect()
}

fn ratio_row(data: &PairData, threads: usize, ours: &[Entry], peer: &Entry, best: Option<&str>) -> Option<Row> {
    let choice = choose(ours, peer, data.accuracy)?;
    Some(Row {
        name: "pair_ratio".into(),
        params: BTreeMap::from([
            ("data".to_owned(), json!(data.name)),
            ("threads".into(), json!(threads)),
            ("peer_method".into(), json!(peer.method)),
        ]),
        unit: "1".into(),
        summary: choice.ours.time.over(&peer.time),
        provenance: Provenance::Measured,
        extra: BTreeMap::from([
            ("method".to_owned(), json!(choice.ours.method)),
            ("same_accuracy".into(), json!(choice.same_accuracy)),
            ("fastest_peer".into(), json!(best == Some(peer.method.as_str()))),
            ("ours_ms".into(), json!(choice.ours.time.p50)),
            ("peer_ms".into(), json!(peer.time.p50)),
            ("translation_error_m".into(), json!(choice.ours.translation_error_m)),
            ("rotation_error_deg".into(), json!(choice.ours.rotation_error_deg)),
            ("peer_translation_error_m".into(), json!(peer.translation_error_m)),
            ("peer_rotation_error_deg".into(), json!(peer.rotation_error_deg)),
        ]),
    })
}

#[cfg(test)]
mod tests {
    use mirador_core::geometry::Pose;
    use nalgebra::{Translation3, UnitQuaternion};
    use serde_json::Value;

    use super::super::data::Accuracy;
    use super::*;

    fn data() -> PairData {
        let truth = Pose::from_parts(Translation3::new(1.0, 0.0, 0.0), UnitQuaternion::identity());
        let accuracy = Accuracy { translation_m: 0.0, rotation_deg: Some(0.0) };
        let (target, source) = (Vec::new(), Vec::new());
        PairData { name: "d".into(), target, source, truth, accuracy, correspondence_m: 1.0 }
    }

    fn samples(ms: f64, x: f64) -> Vec<Sample> {
        let pose = Pose::from_parts(Translation3::new(x, 0.0, 0.0), UnitQuaternion::identity());
        let parts = BTreeMap::from([("align".to_owned(), ms / 2.0)]);
        vec![Sample { ms, parts, pose, iterations: Some(4), overlap: Some(0.9) }; 3]
    }

    fn entrant(method: &str, peer: bool) -> Entrant {
        Entrant { method: method.into(), threads: 2, version: peer.then(|| "1.0".into()) }
    }

    #[test]
    fn a_row_has_the_agreed_keys() {
        let row = pair_row(&data(), &entrant("m", true), &samples(8.0, 1.5)).unwrap();
        assert_eq!(
            serde_json::to_value(row).unwrap(),
            json!({"name": "pair", "params": {"method": "m", "data": "d", "threads": 2, "peer": true}, "unit": "ms",
                   "n": 3, "p50": 8.0, "p90": 8.0, "p99": 8.0, "p99_9": 8.0, "max": 8.0, "samples": [8.0, 8.0, 8.0],
                   "provenance": "measured",
                   "translation_error_m": 0.5, "rotation_error_deg": 0.0, "iterations": 4, "overlap": 0.9,
                   "parts": {"align": 4.0}, "version": "1.0"})
        );
        assert_eq!(pair_row(&data(), &entrant("m", true), &[]), None);
    }

    #[test]
    fn an_unknown_rotation_is_null() {
        let mut data = data();
        data.accuracy.rotation_deg = None;
        let row = pair_row(&data, &entrant("m", false), &samples(8.0, 1.5)).unwrap();
        assert_eq!((&row.extra["rotation_error_deg"], &row.extra["translation_error_m"]), (&Value::Null, &json!(0.5)));
        assert!(!row.extra.contains_key("version"));
    }

    #[test]
    fn every_method_of_a_peer_has_its_ratio_and_the_fastest_is_marked() {
        let measured = vec![
            (entrant("crude", false), samples(1.0, 1.2)),
            (entrant("good", false), samples(5.0, 1.01)),
            (entrant("fast peer", true), samples(10.0, 1.1)),
            (entrant("slow peer", true), samples(20.0, 1.001)),
        ];
        let rows = ratio_rows(&data(), 2, &measured);
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[0].summary.p50, 0.5);
        assert_eq!((&rows[0].extra["method"], &rows[0].extra["same_accuracy"]), (&json!("good"), &json!(true)));
        assert_eq!((&rows[0].extra["fastest_peer"], &rows[1].extra["fastest_peer"]), (&json!(true), &json!(false)));
        assert_eq!(rows[1].extra["same_accuracy"], json!(false));
        assert!(ratio_rows(&data(), 1, &measured).is_empty());
    }
}
