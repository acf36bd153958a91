//! Properties of the comparison as a whole, over files.

use std::path::PathBuf;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use serde_json::{Value, json};

use super::*;

/// What a machine does to a time: log-normal scatter, and now and then something else that runs.
fn times(rng: &mut ChaCha8Rng, middle: f64, n: usize) -> Vec<f64> {
    (0..n)
        .map(|_| {
            let normal: f64 = StandardNormal.sample(rng);
            let disturbed: f64 = Exp1.sample(rng);
            let spike = if disturbed > 3.0 { 0.5 * disturbed } else { 0.0 };
            middle * (0.08 * normal).exp() * (1.0 + spike)
        })
        .collect()
}

fn report(rows: &[(&str, &str, Vec<f64>)]) -> Value {
    let row = |(name, unit, samples): &(&str, &str, Vec<f64>)| {
        let summary = serde_json::to_value(crate::Summary::of(samples).unwrap()).unwrap();
        let mut row = json!({"name": "work", "params": {"what": name}, "unit": unit, "provenance": "measured"});
        row.as_object_mut().unwrap().extend(summary.as_object().unwrap().clone());
        row
    };
    let machine = json!({"cpu": "a", "cores": 2, "os": "b", "commit": "c"});
    json!({"bench": "stages", "machine": machine, "rows": rows.iter().map(row).collect::<Vec<_>>()})
}

struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn put(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    fn compare(&self, old: &Value, new: &Value) -> Result<Comparison, CompareError> {
        let (old, new) = (self.put("old.json", &old.to_string()), self.put("new.json", &new.to_string()));
        compare(&old, &new, &CompareOptions::default())
    }
}

fn rows(seed: u64, slower: f64, n: usize) -> Value {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut of = |middle: f64| times(&mut rng, middle, n);
    report(&[("a", "ms", of(5.0)), ("b", "ms", of(0.3 * slower)), ("c", "us", of(40.0)), ("d", "ms", of(900.0))])
}

#[test]
fn a_report_is_no_regression_against_itself() {
    let files = Files::new();
    for n in [8, 11, 100, 1500] {
        let comparison = files.compare(&rows(1, 1.0, n), &rows(1, 1.0, n)).unwrap();
        assert!(!comparison.is_regression() && comparison.of(Verdict::Alike).count() == 4, "{comparison:?}");
        assert!(comparison.rows.iter().all(|row| row.change.unwrap().ratio == 1.0), "{comparison:?}");
    }
}

#[test]
fn a_fifth_more_is_found_in_noise_and_the_rest_is_left_alone() {
    let files = Files::new();
    for seed in 0..30 {
        let comparison = files.compare(&rows(seed, 1.0, 100), &rows(1000 + seed, 1.2, 100)).unwrap();
        let slower: Vec<&Value> = comparison.of(Verdict::Slower).map(|row| &row.params["what"]).collect();
        assert_eq!(slower, ["b"], "seed {seed}");
        let change = comparison.rows[0].change.unwrap();
        assert!(change.interval[0] > 1.05 && change.ratio > 1.1 && change.ratio < 1.3, "seed {seed}: {change:?}");
        // The other way round it is faster, and no regression.
        let back = files.compare(&rows(1000 + seed, 1.2, 100), &rows(seed, 1.0, 100)).unwrap();
        assert!(!back.is_regression() && back.of(Verdict::Faster).count() == 1, "seed {seed}");
    }
}

#[test]
fn noise_alone_is_flagged_no_more_often_than_stated() {
    let files = Files::new();
    // Without any threshold, where the stated rate is all there is to go by.
    let strict = CompareOptions { threshold: 0.0, alpha: 0.05 };
    let (mut flagged, runs) = (0, 400_u32);
    for seed in 0..u64::from(runs) {
        let (old, new) = (rows(2 * seed, 1.0, 40), rows(2 * seed + 1, 1.0, 40));
        let (old, new) = (files.put("old.json", &old.to_string()), files.put("new.json", &new.to_string()));
        let comparison = compare(&old, &new, &strict).unwrap();
        flagged += u32::from(comparison.rows.iter().any(|row| row.verdict < Verdict::Alike));
    }
    // 5 % of 400 are 20; three standard deviations of the count are 13.
    assert!(flagged <= 33, "{flagged} of {runs}");
}

#[test]
fn samples_that_resemble_their_neighbours_are_not_taken_for_many() {
    // A machine that drifts slowly by some percent: a first-order process with a memory of some twenty samples.
    let drifting = |seed: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut drift = 0.0;
        let samples = (0..1000).map(|_| {
            let step: f64 = StandardNormal.sample(&mut rng);
            drift = 0.95 * drift + 0.01 * step;
            10.0 * f64::exp(drift)
        });
        report(&[("a", "ms", samples.collect())])
    };
    let files = Files::new();
    let flagged = (0..100).filter(|k| files.compare(&drifting(2 * k), &drifting(2 * k + 1)).unwrap().is_regression());
    assert!(flagged.count() <= 3);
}

#[test]
fn a_rate_is_slower_when_it_falls() {
    let files = Files::new();
    let rate = |seed, middle| report(&[("rays", "1/s", times(&mut ChaCha8Rng::seed_from_u64(seed), middle, 40))]);
    let comparison = files.compare(&rate(1, 1e7), &rate(2, 0.7e7)).unwrap();
    assert!(comparison.is_regression() && comparison.rows[0].change.unwrap().ratio > 1.2, "{comparison:?}");
    assert!(!files.compare(&rate(2, 0.7e7), &rate(1, 1e7)).unwrap().is_regression());
}

#[test]
fn rows_of_one_side_and_rows_that_cannot_be_judged_are_named() {
    let files = Files::new();
    let series = |n| times(&mut ChaCha8Rng::seed_from_u64(3), 1.0, n);
    let old = report(&[("a", "ms", series(20)), ("few", "ms", series(5)), ("gone", "ms", series(20))]);
    let mut new = report(&[("a", "ms", series(20)), ("few", "ms", series(5)), ("fresh", "ms", series(20))]);
    new["machine"]["cores"] = 64.into();
    new["rows"][0]["translation_error_m"] = 0.5.into();
    let mut old = old;
    old["rows"][0]["translation_error_m"] = 0.1.into();
    let comparison = files.compare(&old, &new).unwrap();
    assert_eq!(comparison.only_old, ["work (what gone)"]);
    assert_eq!(comparison.only_new, ["work (what fresh)"]);
    assert_eq!(comparison.of(Verdict::NotJudged).map(|row| row.reason).collect::<Vec<_>>(), [Some(Reason::TooFew)]);
    let mut text = Vec::new();
    print(&comparison, &mut text).unwrap();
    let text = String::from_utf8(text).unwrap();
    for part in ["DIFFERENT MACHINES", "cores: 2 -> 64", "translation_error_m 0.10 -> 0.50", "fewer than 8 samples"] {
        assert!(text.contains(part), "{part}\n{text}");
    }
}

#[test]
fn sizes_that_turned_out_otherwise_do_not_part_rows() {
    let files = Files::new();
    let (mut old, mut new) = (rows(1, 1.0, 20), rows(1, 1.0, 20));
    old["rows"][0]["params"]["points"] = 1000.into();
    new["rows"][0]["params"]["points"] = 1010.into();
    assert!(files.compare(&old, &new).unwrap().only_old.is_empty());
}

#[test]
fn what_cannot_be_compared_is_said_with_file_and_field() {
    let files = Files::new();
    let good = rows(1, 1.0, 20);
    let refused = |new: &Value| files.compare(&good, new).unwrap_err().to_string();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut new = good.clone();
        change(&mut new);
        refused(&new)
    };
    let other = changed(&|new| new["bench"] = "ipc".into());
    assert!(other.contains("\"stages\"") && other.contains("\"ipc\"") && other.contains("new.json"), "{other}");
    let missing = changed(&|new| drop(new["rows"][2].as_object_mut().unwrap().remove("p50")));
    assert!(missing.contains("new.json") && missing.contains("rows[2]") && missing.contains("p50"), "{missing}");
    let negative = changed(&|new| new["rows"][1]["samples"][7] = (-1.0).into());
    assert!(negative.contains("rows[1].samples[7]"), "{negative}");
    let null = changed(&|new| new["rows"][1]["samples"][7] = Value::Null);
    assert!(null.contains("rows[1]"), "{null}");
    let unit = changed(&|new| new["rows"][0]["unit"] = "us".into());
    assert!(unit.contains("\"ms\"") && unit.contains("\"us\"") && unit.contains("what a"), "{unit}");
    let twice = changed(&|new| new["rows"][1]["params"]["what"] = "a".into());
    assert!(twice.contains("rows[0] and rows[1]"), "{twice}");
    let no_rows = changed(&|new| drop(new.as_object_mut().unwrap().remove("rows")));
    assert!(no_rows.contains("rows: it is missing"), "{no_rows}");
    let strangers = changed(&|new| {
        for row in new["rows"].as_array_mut().unwrap() {
            row["name"] = "other".into();
        }
    });
    assert!(strangers.contains("no row with the same name"), "{strangers}");
    let no_samples = changed(&|new| {
        for row in new["rows"].as_array_mut().unwrap() {
            row.as_object_mut().unwrap().remove("samples");
        }
    });
    assert!(no_samples.contains("no `samples`"), "{no_samples}");
}

#[test]
fn a_file_that_is_none_and_options_out_of_range_are_refused() {
    let files = Files::new();
    let good = files.put("good.json", &rows(1, 1.0, 20).to_string());
    let options = CompareOptions::default();
    let error = compare(&good, &files.0.path().join("nowhere.json"), &options).unwrap_err().to_string();
    assert!(error.contains("nowhere.json"), "{error}");
    let torn = files.put("torn.json", "{\"bench\": ");
    let error = compare(&torn, &good, &options).unwrap_err().to_string();
    assert!(error.contains("torn.json") && error.contains("line 1"), "{error}");
    let negative = CompareOptions { threshold: -0.1, ..options };
    assert!(compare(&good, &good, &negative).unwrap_err().to_string().contains("--threshold -0.1"));
    let certain = CompareOptions { alpha: f64::NAN, ..options };
    assert!(compare(&good, &good, &certain).unwrap_err().to_string().contains("--alpha"));
}
