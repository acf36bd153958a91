//! A scan that fits nowhere is flagged, and the run goes on without it.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::path::Path;

use mirador_ipc_schema::{text, topics};
use support::outputs::{Model, recording};
use support::{Finished, Stage, data, summary};

/// Names of four scans of the handheld recording in a row.
const HANDHELD: [&str; 4] = ["scan000", "scan004", "scan008", "scan012"];

/// A folder of scans with priors, in which one does not belong.
struct Folder {
    lines: Vec<String>,
    path: std::path::PathBuf,
}

impl Folder {
    fn new(stage: &Stage) -> Self {
        let path = stage.path("scans");
        fs::create_dir(&path).unwrap();
        Self { lines: Vec::new(), path }
    }

    /// The next scan, with the odometry of the handheld recording's scan `prior`.
    fn add(&mut self, content: &[u8], handheld: &Path, prior: usize) {
        let number = self.lines.len();
        fs::write(self.path.join(format!("scan{number:03}.xyz32.bin")), content).unwrap();
        let odometry = fs::read_to_string(handheld.join("odometry.tum")).unwrap();
        let poses: Vec<_> = odometry.lines().filter(|l| !l.starts_with('#')).collect();
        let (_, pose) = poses[prior].split_once(' ').unwrap();
        self.lines.push(format!("{number}.0 {pose}"));
    }

    fn add_handheld(&mut self, handheld: &Path, index: usize) {
        let content = fs::read(handheld.join(format!("{}.xyz32.bin", HANDHELD[index]))).unwrap();
        self.add(&content, handheld, index);
    }

    fn replay(self, stage: &Stage) -> Finished {
        fs::write(self.path.join("odometry.tum"), self.lines.join("\n")).unwrap();
        let path = self.path.display().to_string();
        stage.run_well(&["replay", &path, "--poses", "odometry.tum", "--out", "out"])
    }
}

fn xyz32(points: &[[f32; 3]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

/// Points without any surface, evenly in a box around the scanner; the same ones every time.
fn fog(count: usize) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1_u64 << 24) as f32
    };
    let points: Vec<_> = (0..count).map(|_| [60.0, 60.0, 40.0].map(|side: f32| side * (uniform() - 0.5))).collect();
    xyz32(&points)
}

/// Scan 2 of 4 is flagged everywhere, and scan 3 is aligned to scan 1.
fn expect_third_of_four_flagged(stage: &Stage, finished: &Finished) {
    let out = stage.path("out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"], &summary["unaligned"]), (&4.into(), &3.into(), &1.into()));
    assert!(finished.stdout.contains("4 scans, 3 aligned, 1 not aligned"), "{}", finished.stdout);
    let statuses: Vec<_> = summary["poses"].as_array().unwrap().iter().map(|p| p["status"].as_str().unwrap()).collect();
    assert_eq!(statuses, ["first", "accepted", "rejected", "accepted"]);
    let reason = summary["poses"][2]["reason"].as_str().unwrap();
    assert!(reason.contains(' ') && reason.len() > 15, "words: {reason}");
    assert_eq!((&summary["restarts"], &summary["lost_messages"]), (&0.into(), &0.into()));

    let model = Model::read(&out);
    let comment = format!("scan 2 is not aligned: {reason}");
    assert!(model.comments.contains(&comment), "{:?}", model.comments);
    assert!(model.points.iter().all(|p| (p.aligned == 0) == (p.scan == 2)));
    let mut reader = recording(&out);
    let mut returns = Vec::new();
    reader.for_each_meta::<topics::Scan>(|meta, _| returns.push(meta.returns as usize)).unwrap();
    for (scan, expected) in (0..).zip(&returns) {
        assert_eq!(model.points.iter().filter(|p| p.scan == scan).count(), *expected, "scan {scan}");
    }

    let trajectory = fs::read_to_string(out.join("trajectory.tum")).unwrap();
    assert_eq!(trajectory.lines().filter(|l| !l.starts_with('#')).count(), 3);
    assert!(trajectory.contains(&format!("# {comment}")), "{trajectory}");

    let mut hypotheses = Vec::new();
    let next = reader.read_about::<topics::Alignment>(3, &mut hypotheses).unwrap().unwrap();
    assert_eq!(next.target_scan, 1, "the last good one");
    let flagged = reader.read_about::<topics::Alignment>(2, &mut hypotheses).unwrap().unwrap();
    assert_eq!(text::unpack(&flagged.reason), reason);

    let explained = stage.run_well(&["explain", "out", "2"]).stdout;
    assert!(explained.contains("NOT ALIGNED") && explained.contains(reason), "{explained}");
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains(reason), "the report says it too");
}

#[test]
fn a_scan_of_nothing_but_fog_is_flagged_and_the_next_aligns_to_the_last_good_one() {
    let Some(handheld) = data("unaligned", "handheld") else { return };
    let stage = Stage::new();
    let mut folder = Folder::new(&stage);
    folder.add_handheld(&handheld, 0);
    folder.add_handheld(&handheld, 1);
    folder.add(&fog(30_000), &handheld, 1);
    folder.add_handheld(&handheld, 2);
    let finished = folder.replay(&stage);
    expect_third_of_four_flagged(&stage, &finished);
    // What does not belong is not in the map either: the model without the scan is as good.
    let with = summary(&stage.path("out"));
    assert!(with["poses"][3]["overlap"].as_f64().unwrap() > 0.5, "{}", with["poses"][3]);
}

#[test]
fn a_scan_of_another_place_is_flagged() {
    let Some(handheld) = data("unaligned", "handheld") else { return };
    let Some(street) = data("unaligned", "kitti00_first6") else { return };
    let stage = Stage::new();
    let mut folder = Folder::new(&stage);
    folder.add_handheld(&handheld, 0);
    folder.add_handheld(&handheld, 1);
    folder.add(&fs::read(street.join("000000.xyz32.bin")).unwrap(), &handheld, 1);
    folder.add_handheld(&handheld, 2);
    let finished = folder.replay(&stage);
    expect_third_of_four_flagged(&stage, &finished);
}

#[test]
fn a_scan_with_a_handful_of_points_is_flagged() {
    let Some(handheld) = data("unaligned", "handheld") else { return };
    let stage = Stage::new();
    let mut folder = Folder::new(&stage);
    folder.add_handheld(&handheld, 0);
    folder.add_handheld(&handheld, 1);
    folder.add(&xyz32(&[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]]), &handheld, 1);
    folder.add_handheld(&handheld, 2);
    let finished = folder.replay(&stage);
    expect_third_of_four_flagged(&stage, &finished);
}

#[test]
fn a_scan_whose_points_are_all_out_of_range_is_flagged() {
    let Some(handheld) = data("unaligned", "handheld") else { return };
    let stage = Stage::new();
    let mut folder = Folder::new(&stage);
    folder.add_handheld(&handheld, 0);
    folder.add_handheld(&handheld, 1);
    let far: Vec<_> = (0..500_u16).map(|i| [900.0 + f32::from(i), 0.0, 1.0]).collect();
    folder.add(&xyz32(&far), &handheld, 1);
    folder.add_handheld(&handheld, 2);
    let finished = folder.replay(&stage);
    expect_third_of_four_flagged(&stage, &finished);
}

#[test]
fn when_the_first_scan_is_no_use_the_second_defines_the_map() {
    let Some(handheld) = data("unaligned", "handheld") else { return };
    let stage = Stage::new();
    let mut folder = Folder::new(&stage);
    folder.add(&xyz32(&[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), &handheld, 0);
    folder.add_handheld(&handheld, 0);
    folder.add_handheld(&handheld, 1);
    folder.replay(&stage);
    let out = stage.path("out");
    let summary = summary(&out);
    let statuses: Vec<_> = summary["poses"].as_array().unwrap().iter().map(|p| p["status"].as_str().unwrap()).collect();
    assert_eq!(statuses, ["rejected", "first", "accepted"]);
    assert!(Model::read(&out).points.iter().all(|p| (p.aligned == 0) == (p.scan == 0)));
}
