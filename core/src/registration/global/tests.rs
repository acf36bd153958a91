//! Recovery without a prior, and the thousand trials.

use std::time::Instant;

use nalgebra::{Point3, Vector3};

use super::trials::{Draws, Outcome, Tally, Tolerance};
use super::*;
use crate::geometry::Pose;
use crate::registration::coarse::{CoarseAligner, CoarseConfig, CoarseScan, Keyframe, Relocalisation, SearchRange};
use crate::registration::test_scenes::{data, read_pose, read_tum, read_xyz32};
use crate::registration::{PreparedScan, Registration, RegistrationConfig, Registry};
use crate::scan::{Point, ScanView};

/// A scan prepared for everything.
struct Prepared {
    prepared: Box<dyn PreparedScan>,
    coarse: CoarseScan,
    features: Features,
}

/// Everything that takes part.
struct Bench {
    coarse: CoarseAligner,
    global: GlobalAligner,
    registration: Box<dyn Registration>,
}

impl Bench {
    fn new() -> Self {
        Self {
            coarse: CoarseAligner::new(CoarseConfig::default()).unwrap(),
            global: GlobalAligner::new(GlobalConfig::default()).unwrap(),
            registration: Registry::default()
                .create("point_to_plane", &RegistrationConfig { threads: 2, ..RegistrationConfig::default() })
                .unwrap(),
        }
    }

    fn prepare(&self, points: &[Point]) -> Prepared {
        let prepared = self.registration.prepare(ScanView::unordered(points)).unwrap();
        let coarse = self.coarse.prepare(prepared.points(), 0.25);
        let features = self.global.prepare(&coarse);
        Prepared { prepared, coarse, features }
    }

    /// From a prior.
    fn relocalise(&mut self, target: &Prepared, source: &Prepared, prior: &Pose) -> Relocalisation {
        let (target, source) = (target.keyframe(), source.keyframe());
        self.coarse.relocalise(&mut *self.registration, target, source, prior, &SearchRange::default()).unwrap()
    }

    /// From nothing.
    fn locate(&mut self, target: &Prepared, source: &Prepared) -> Relocalisation {
        self.global.locate(&self.coarse, &mut *self.registration, target.global(), source.global())
    }
}

impl Prepared {
    fn keyframe(&self) -> Keyframe<'_> {
        Keyframe { prepared: &*self.prepared, coarse: &self.coarse }
    }

    fn global(&self) -> GlobalKeyframe<'_> {
        GlobalKeyframe { keyframe: self.keyframe(), features: &self.features }
    }
}

/// The points seen by a scanner that stands at `pose` in the frame they are given in.
fn seen_from(points: &[Point], pose: &Pose) -> Vec<Point> {
    let inverse = pose.inverse();
    let moved = points.iter().map(|p| inverse * Point3::from(p.position().coords));
    moved.map(|p| Point::new(p.x as f32, p.y as f32, p.z as f32)).collect()
}

/// The points in a mirror: a place that does not exist.
fn mirrored(points: &[Point]) -> Vec<Point> {
    points.iter().map(|p| Point::new(p.x, -p.y, p.z)).collect()
}

/// All 45 scans with their poses, or `None` after saying so.
fn handheld(test: &str) -> Option<(Vec<Vec<Point>>, Vec<Pose>)> {
    let folder = data(test, "handheld")?;
    let scans = (0..45).map(|k| read_xyz32(&folder.join(format!("scan{:03}.xyz32.bin", 4 * k)))).collect();
    Some((scans, read_tum(&folder.join("poses.tum"))))
}

/// Target, source, target_from_source.
fn synth_pair(test: &str) -> Option<(Vec<Point>, Vec<Point>, Pose)> {
    let folder = data(test, "synth_pair")?;
    let scan = |name: &str| read_xyz32(&folder.join(format!("{name}.xyz32.bin")));
    Some((scan("target"), scan("source"), read_pose(&folder.join("target_from_source.txt"))))
}

#[test]
fn scans_are_found_again_without_a_prior_whichever_way_they_are_turned() {
    let mut bench = Bench::new();
    let Some((target, source, truth)) = synth_pair("global synth_pair") else { return };
    let turned = Pose::new(Vector3::new(0.0, 0.0, 0.0), Vector3::new(0.2, -0.1, 2.5));
    let (target, source) = (bench.prepare(&target), bench.prepare(&seen_from(&source, &turned)));
    let answer = bench.locate(&target, &source);
    assert_eq!(Outcome::of(&answer, Some(&(truth * turned)), Tolerance::default()), Outcome::Recovered, "{answer:?}");

    let Some((scans, poses)) = handheld("global handheld") else { return };
    let [a, b] = [20, 21].map(|k| bench.prepare(&scans[k]));
    let answer = bench.locate(&a, &b);
    let truth = poses[20].inverse() * poses[21];
    assert_eq!(Outcome::of(&answer, Some(&truth), Tolerance::default()), Outcome::Recovered, "{answer:?}");
    let mirror = bench.prepare(&mirrored(&scans[21]));
    assert!(bench.locate(&a, &mirror).trusted().is_none());
}

/// One row of the experiment.
struct Row {
    name: &'static str,
    tally: Tally,
    milliseconds: Vec<f64>,
    /// The largest score and the like of what was refused, the least of what was trusted.
    lines: Vec<String>,
}

impl Row {
    fn new(name: &'static str) -> Self {
        Self { name, tally: Tally::default(), milliseconds: Vec::new(), lines: Vec::new() }
    }

    fn add(&mut self, label: &str, truth: Option<&Pose>, tolerance: Tolerance, ask: impl FnOnce() -> Relocalisation) {
        let begin = Instant::now();
        let answer = ask();
        self.milliseconds.push(begin.elapsed().as_secs_f64() * 1e3);
        let outcome = Outcome::of(&answer, truth, tolerance);
        self.tally.add(outcome);
        let e = &answer.verdict.evidence;
        let error = match (&answer.alignment, truth) {
            (Some(alignment), Some(truth)) => {
                (truth.inverse() * alignment.target_from_source).translation.vector.norm()
            }
            _ => f64::INFINITY,
        };
        self.lines.push(format!(
            "T {} {label} {outcome:?} score {:.3} con {:.3} {:.3} ov {:.3} {:.3} eig {:.4} res {:.3} m {} {} margin {:.3} tried {} exp {:.3} {:.3} vis {} {} err {error:.3} doubt {:?}",
            self.name, e.score(), e.forward.contradiction(), e.backward.contradiction(), e.forward.overlap(),
            e.backward.overlap(), e.least_eigenvalue, e.residual_rms_m, e.forward.matched, e.backward.matched,
            answer.margin, answer.tried, e.forward.explained(), e.backward.explained(), e.forward.visible, e.backward.visible, answer.verdict.doubt
        ));
    }

    fn printed(mut self) -> Self {
        if self.milliseconds.is_empty() {
            return self;
        }
        for line in &self.lines {
            println!("{line}");
        }
        self.milliseconds.sort_by(f64::total_cmp);
        let at = |q: usize| self.milliseconds[(self.milliseconds.len() * q / 100).min(self.milliseconds.len() - 1)];
        println!(
            "ROW {:<44} trials {:>4} recovered {:>4} refused {:>4} false {:>2} | p50 {:.1} ms p99 {:.1} ms",
            self.name,
            self.tally.trials(),
            self.tally.recovered,
            self.tally.refused,
            self.tally.false_accepts,
            at(50),
            at(99)
        );
        self
    }
}

/// The truth of the recording drifts by 0.14 m between visits of one place: the residual of the aligned scans is 0.05 m
/// where the truth leaves 0.08 m. Only neighbours are judged to 0.1 m.
const REVISITS: Tolerance = Tolerance { translation_m: 0.3, rotation: 0.035 };

#[test]
#[ignore = "the thousand trials: a minute or two"]
fn a_thousand_trials_recover_and_never_trust_a_false_pose() {
    let seed = std::env::var("SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(1);
    let scale = std::env::var("TRIALS").ok().and_then(|v| v.parse().ok()).unwrap_or(100_usize);
    let only = std::env::var("ROWS").unwrap_or_default();
    let wanted = |name: &str| only.is_empty() || name.contains(&only);
    let many = |count: usize| (count * scale / 100).max(1);
    let mut bench = Bench::new();
    let mut draws = Draws::new(seed);
    let range = SearchRange::default();
    let Some((target, source, synth_truth)) = synth_pair("trials") else { return };
    let Some((clouds, poses)) = handheld("trials") else { return };
    let synth = [bench.prepare(&target), bench.prepare(&source)];
    let scans: Vec<Prepared> = clouds.iter().map(|points| bench.prepare(points)).collect();
    let mirrors: Vec<Prepared> = clouds.iter().map(|points| bench.prepare(&mirrored(points))).collect();
    let over = Pose::new(Vector3::zeros(), Vector3::x() * std::f64::consts::PI);
    let upset: Vec<Prepared> = clouds.iter().map(|points| bench.prepare(&seen_from(points, &over))).collect();
    let truth_of = |t: usize, s: usize| poses[t].inverse() * poses[s];
    let strict = Tolerance::default();
    let mut rows = Vec::new();
    let error = |draws: &mut Draws, k: usize| {
        if k.is_multiple_of(2) { draws.error_at_the_border(&range) } else { draws.error_within(&range) }
    };

    let mut row = Row::new("prior: synth_pair");
    for k in 0..many(220) {
        let prior = synth_truth * error(&mut draws, k);
        if wanted(row.name) {
            row.add("", Some(&synth_truth), strict, || bench.relocalise(&synth[0], &synth[1], &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("prior: handheld neighbours");
    for k in 0..many(220) {
        let t = k % 44;
        let truth = truth_of(t, t + 1);
        let prior = truth * error(&mut draws, k / 44);
        if wanted(row.name) {
            row.add(&format!("{t}-{}", t + 1), Some(&truth), strict, || {
                bench.relocalise(&scans[t], &scans[t + 1], &prior)
            });
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("false: handheld, prior at random");
    let two = |draws: &mut Draws| {
        let t = (draws.share() * 45.0) as usize % 45;
        (t, (t + 8 + (draws.share() * 30.0) as usize) % 45)
    };
    let wide = SearchRange { translation_m: 15.0, yaw: std::f64::consts::PI, ..range };
    for _ in 0..many(250) {
        let (t, s) = two(&mut draws);
        let truth = truth_of(t, s);
        let prior = truth * draws.error_within(&wide);
        if wanted(row.name) {
            row.add(&format!("{t}-{s}"), Some(&truth), REVISITS, || bench.relocalise(&scans[t], &scans[s], &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("false: neighbours, prior at random");
    for k in 0..many(100) {
        let t = k % 44;
        let truth = truth_of(t, t + 1);
        let prior = truth * draws.error_within(&wide);
        if wanted(row.name) {
            row.add(&format!("{t}-{}", t + 1), Some(&truth), strict, || {
                bench.relocalise(&scans[t], &scans[t + 1], &prior)
            });
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("false: neighbour mirrored");
    for k in 0..many(100) {
        let t = k % 44;
        let prior = truth_of(t, t + 1) * error(&mut draws, k);
        if wanted(row.name) {
            row.add(&format!("{t}"), None, strict, || bench.relocalise(&scans[t], &mirrors[t + 1], &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("false: neighbour upside down");
    for k in 0..many(100) {
        let t = k % 44;
        let prior = truth_of(t, t + 1) * error(&mut draws, k);
        if wanted(row.name) {
            row.add(&format!("{t}"), None, strict, || bench.relocalise(&scans[t], &upset[t + 1], &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("false: handheld against synth_pair");
    for k in 0..many(100) {
        let prior = draws.error_within(&wide);
        if wanted(row.name) {
            row.add(&format!("{}", k % 45), None, strict, || bench.relocalise(&synth[k % 2], &scans[k % 45], &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("poor: neighbour, what one side or the ground shows");
    for k in 0..many(100) {
        let t = k % 44;
        let truth = truth_of(t, t + 1);
        let prior = truth * error(&mut draws, k);
        if wanted(row.name) {
            let poor = bench.prepare(&poorer(&clouds[t + 1], k, draws.signed() * std::f64::consts::PI));
            row.add(&format!("{t} {}", k % 3), Some(&truth), strict, || bench.relocalise(&scans[t], &poor, &prior));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("no prior: synth_pair");
    for _ in 0..many(60) {
        let turned =
            draws.error_within(&SearchRange { translation_m: 0.0, height_m: 0.0, tilt: 0.3, yaw: 3.1, ..range });
        if wanted(row.name) {
            let source = bench.prepare(&seen_from(&source, &turned));
            row.add("", Some(&(synth_truth * turned)), strict, || bench.locate(&synth[0], &source));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("no prior: handheld neighbours");
    for t in 0..44 {
        let truth = truth_of(t, t + 1);
        if wanted(row.name) {
            row.add(&format!("{t}"), Some(&truth), strict, || bench.locate(&scans[t], &scans[t + 1]));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("no prior: handheld, any two");
    for _ in 0..many(150) {
        let (t, s) = two(&mut draws);
        let truth = truth_of(t, s);
        if wanted(row.name) {
            row.add(&format!("{t}-{s}"), Some(&truth), REVISITS, || bench.locate(&scans[t], &scans[s]));
        }
    }
    rows.push(row.printed());
    let mut row = Row::new("no prior, false: mirrored or synth_pair");
    for k in 0..many(100) {
        if wanted(row.name) {
            let t = k % 45;
            if k.is_multiple_of(2) {
                row.add(&format!("{t}"), None, strict, || bench.locate(&scans[t], &mirrors[(t + 1) % 45]));
            } else {
                row.add(&format!("{t}"), None, strict, || bench.locate(&synth[k / 2 % 2], &scans[t]));
            }
        }
    }
    rows.push(row.printed());
    rows.retain(|row| row.tally.trials() > 0);
    assert!(rows.iter().all(|row| row.tally.false_accepts == 0));
    for row in rows.iter().filter(|row| row.name.starts_with("prior")) {
        assert!(row.tally.recovered as f64 >= 0.95 * row.tally.trials() as f64, "{}", row.name);
    }
}

/// A part of a scan: a sector of 90 degrees, what is near, or what is low.
fn poorer(points: &[Point], kind: usize, direction: f64) -> Vec<Point> {
    let keep = |p: &&Point| match kind % 3 {
        0 => {
            let turn = (f64::from(p.y).atan2(f64::from(p.x)) - direction).rem_euclid(std::f64::consts::TAU);
            turn < std::f64::consts::FRAC_PI_2
        }
        1 => p.range() < 6.0,
        _ => p.z < -1.0,
    };
    points.iter().filter(keep).copied().collect()
}

#[test]
#[ignore = "prints times; run it alone"]
fn times_of_every_step() {
    let mut bench = Bench::new();
    let Some((target, source, synth_truth)) = synth_pair("times") else { return };
    let Some((clouds, poses)) = handheld("times") else { return };
    let cases = [
        ("synth_pair", bench.prepare(&target), bench.prepare(&source), synth_truth),
        ("handheld 8-9", bench.prepare(&clouds[8]), bench.prepare(&clouds[9]), poses[8].inverse() * poses[9]),
        ("handheld 30-31", bench.prepare(&clouds[30]), bench.prepare(&clouds[31]), poses[30].inverse() * poses[31]),
    ];
    for (name, target, source, truth) in &cases {
        let mut step = |what: &str, work: &mut dyn FnMut(&mut Bench, usize) -> usize| {
            let mut times: Vec<f64> = (0..30)
                .map(|k| {
                    let begin = Instant::now();
                    std::hint::black_box(work(&mut bench, k));
                    begin.elapsed().as_secs_f64() * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("{name}: {what}: p50 {:.2} ms, max {:.2} ms", times[15], times[29]);
        };
        let ranges = [(0.5, 2.0), (1.0, 5.0), (2.0, 10.0), (5.0, 45.0)];
        println!(
            "{name}: {} points, {} bytes, features {} bytes",
            target.coarse.points().len(),
            target.coarse.bytes(),
            target.features.bytes()
        );
        step("prepare", &mut |bench, _| bench.coarse.prepare(source.prepared.points(), 0.25).bytes());
        step("verify", &mut |bench, _| {
            usize::from(bench.coarse.verify(&target.coarse, &source.coarse, truth).is_trusted())
        });
        step("the cubes of a target", &mut |bench, k| {
            // Another target in between makes the aligner forget.
            let other = if k % 2 == 0 { &source.coarse } else { &target.coarse };
            let none = SearchRange { translation_m: 0.0, height_m: 0.0, yaw: 0.0, tilt: 0.0, ..SearchRange::default() };
            bench.coarse.align(other, &source.coarse, truth, &none).unwrap().evaluations
        });
        for (metres, degrees) in ranges {
            let range = SearchRange {
                translation_m: metres,
                yaw: f64::to_radians(degrees),
                tilt: f64::to_radians(if degrees < 4.0 { 0.0 } else { f64::min(degrees, 5.0) }),
                ..SearchRange::default()
            };
            let mut draws = Draws::new(5);
            step(&format!("align {metres} m {degrees} deg"), &mut |bench, _| {
                let prior = truth * draws.error_within(&range);
                bench.coarse.align(&target.coarse, &source.coarse, &prior, &range).unwrap().evaluations
            });
        }
        step("features", &mut |bench, _| bench.global.prepare(&source.coarse).len());
        step("candidates", &mut |bench, _| bench.global.candidates(&target.features, &source.features).len());
        step("global align", &mut |bench, _| {
            bench.global.align(&bench.coarse, target.global(), source.global()).hypotheses.len()
        });
    }
}
