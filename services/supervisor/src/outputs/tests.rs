use super::testing::{facts, record_run};
use super::*;
use mirador_core::geometry::Pose;
use mirador_core::simulation::{CompiledScene, Scene};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

struct Run {
    folder: tempfile::TempDir,
    summary: Value,
}

impl Run {
    fn new(facts: &RunFacts) -> Self {
        let folder = tempfile::tempdir().unwrap();
        record_run(folder.path());
        write_all(folder.path(), facts).unwrap();
        let summary = serde_json::from_slice(&fs::read(folder.path().join("summary.json")).unwrap()).unwrap();
        Self { folder, summary }
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(name)).unwrap()
    }
}

fn close(value: &Value, expected: f64) -> bool {
    value.as_f64().is_some_and(|v| (v - expected).abs() < 1e-9)
}

#[test]
fn the_summary_has_every_promised_key_with_the_value_computed_by_hand() {
    let run = Run::new(&facts());
    let s = &run.summary;
    assert_eq!(
        (&s["scans"], &s["aligned"], &s["unaligned"], &s["points"]),
        (&3.into(), &2.into(), &1.into(), &12.into())
    );
    assert_eq!((&s["stop_reason"], &s["stop_reason_text"]), (&"done".into(), &"the model is good enough".into()));
    assert!(close(&s["coverage"], 0.5) && close(&s["quality"], 0.5) && close(&s["distance_m"], 5.5), "{s}");
    assert_eq!((&s["copied_payload_bytes"], &s["lost_messages"], &s["restarts"]), (&16.into(), &3.into(), &2.into()));
    // Two poses, errors 0 and 0.2 m; the rotations agree.
    assert!(close(&s["errors"]["ate_rmse_m"], 0.02_f64.sqrt()), "{}", s["errors"]);
    assert!(s["errors"]["ate_rmse_deg"].as_f64().unwrap() < 1e-6 && s["errors"]["n"] == 2);
    let poses = s["poses"].as_array().unwrap();
    assert_eq!(poses.len(), 3);
    assert_eq!(
        (&poses[0]["status"], &poses[1]["status"], &poses[2]["status"]),
        (&"first".into(), &"accepted".into(), &"rejected".into())
    );
    assert_eq!((&poses[1]["scan"], &poses[1]["corrected"]), (&1.into(), &true.into()));
    assert!(close(&poses[1]["map_from_scanner"][3], 3.0) && close(&poses[1]["map_from_scanner"][7], 4.0));
    assert_eq!((&poses[1]["reason"], &poses[2]["reason"]), (&Value::Null, &"overlap 0.10 is below 0.30".into()));
}

#[test]
fn a_run_whose_input_ended_says_so_and_keeps_the_last_decision_apart() {
    let folder = tempfile::tempdir().unwrap();
    record_run(folder.path());
    let mut data = RunData::read(&mut RunReader::open(&folder.path().join(RUN_FILE)).unwrap()).unwrap();
    data.source = SourceEnd::Ended;
    let ended = |facts: &RunFacts| {
        let summary = Summary::of(&data, facts, None);
        assert_eq!(summary.last_decision.as_deref(), Some("done"));
        assert_eq!(summary.last_decision_text.as_deref(), Some("the model is good enough"));
        (summary.stop_reason.unwrap(), summary.stop_reason_text.unwrap())
    };
    assert_eq!(ended(&facts()).0, "input_ended");
    assert_eq!(ended(&RunFacts { interrupted: true, ..facts() }).0, "interrupted");
    let fault = RunFacts { fault: Some("planning ended (signal 9)".into()), ..facts() };
    assert_eq!(ended(&fault), ("fault".into(), "planning ended (signal 9)".into()));
}

#[test]
fn the_latency_of_every_stage_is_in_the_summary() {
    let run = Run::new(&facts());
    let stages = &run.summary["latency_ms"];
    let expected = [
        ("surface", 2.0, 3.0),
        ("alignment", 4.0, 5.0),
        ("scan_to_pose", 5.0, 5.0),
        ("analysis", 2.0, 2.0),
        ("map", 5.0, 5.0),
        ("planning", 6.0, 6.0),
        ("end_to_end", 21.0, 22.0),
    ];
    for (stage, p50, max) in expected {
        let q = &stages[stage];
        assert!(close(&q["p50"], p50) && close(&q["p99"], max) && close(&q["max"], max) && q["n"] == 3, "{stage}: {q}");
    }
    assert_eq!(stages.as_object().unwrap().len(), expected.len());
}

#[test]
fn what_cannot_be_known_is_null() {
    let unknown = RunFacts { truth: None, truth_cells: None, ..facts() };
    let run = Run::new(&unknown);
    assert!(run.summary["errors"].is_null() && run.summary["coverage"].is_null());
    let keys = run.summary.as_object().unwrap();
    assert!(keys.contains_key("errors") && keys.contains_key("coverage"));
    assert!(keys.contains_key("model_error") && run.summary["model_error"].is_null());
    assert!(run.text("report.html").contains("no truth"));
}

#[test]
fn the_model_is_measured_against_the_scene_with_the_first_scan_on_its_true_pose() {
    let scene = Arc::new(CompiledScene::new(Scene::builtin("plane").unwrap()).unwrap());
    let measured = |world_from_first: Pose| {
        let truth = Some(BTreeMap::from([(10, world_from_first)]));
        Run::new(&RunFacts { scene: Some(scene.clone()), truth, ..facts() })
    };
    // Four returns in each of the two aligned scans.
    let here = measured(Pose::identity());
    assert_eq!(here.summary["model_error"]["points"], 8);
    let median_m = |run: &Run| run.summary["model_error"]["median_m"].as_f64().unwrap();
    let raised = measured(Pose::translation(0.0, 0.0, 0.5));
    assert!((median_m(&raised) - median_m(&here) - 0.5).abs() < 1e-3, "{} {}", median_m(&raised), median_m(&here));
    assert!(here.text("report.html").contains("from the true surfaces"));
}

#[test]
fn a_model_that_cannot_be_written_is_an_error_and_all_else_is_there() {
    let folder = tempfile::tempdir().unwrap();
    record_run(folder.path());
    fs::create_dir(folder.path().join("model.ply")).unwrap();
    let error = write_all(folder.path(), &facts()).unwrap_err().to_string();
    assert!(error.contains("model.ply"), "{error}");
    for name in ["summary.json", "report.html", "map.png", "trajectory.tum"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

#[test]
fn a_run_without_scans_has_outputs_too() {
    let folder = tempfile::tempdir().unwrap();
    let config = mirador_recorder::RecorderConfig::default();
    mirador_recorder::RunWriter::create(&folder.path().join(RUN_FILE), &config).unwrap().finish().unwrap();
    let summary = write_all(folder.path(), &RunFacts { interrupted: true, ..RunFacts::default() }).unwrap();
    assert_eq!((summary.scans, summary.points, summary.stop_reason.as_deref()), (0, 0, Some("interrupted")));
    assert_eq!(summary.quality, None);
    assert_eq!(summary.latency_ms["surface"], Quantiles::default());
}

#[test]
fn the_trajectory_has_the_corrected_poses_of_the_aligned_scans() {
    let run = Run::new(&facts());
    let text = run.text("trajectory.tum");
    let lines: Vec<_> = text.lines().filter(|l| !l.starts_with('#')).collect();
    assert_eq!(lines.len(), 2);
    let fields: Vec<_> = lines[1].split(' ').collect();
    assert_eq!(fields.len(), 8);
    assert_eq!((fields[0], fields[1], fields[2]), ("2.500000001", "3.000000000", "4.000000000"));
    assert!(text.contains("# scan 2 is not aligned: overlap 0.10 is below 0.30"));
}

#[test]
fn the_model_holds_every_return_with_quality_scan_and_flag() {
    let run = Run::new(&facts());
    let bytes = fs::read(run.folder.path().join("model.ply")).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
    assert!(header.contains("\nelement vertex 12\n"), "{header}");
    assert!(header.contains("comment scan 2 is not aligned: overlap 0.10 is below 0.30\n"));
    let properties: Vec<_> = header.lines().filter_map(|l| l.strip_prefix("property ")).collect();
    let expected = ["float x", "float y", "float z", "float quality", "uint scan", "ushort intensity", "uchar aligned"];
    assert_eq!(properties, expected);
    let rows: Vec<&[u8]> = bytes[end..].chunks(23).collect();
    assert_eq!((rows.len(), bytes.len() - end), (12, 12 * 23));
    let float = |row: &[u8], at: usize| f32::from_le_bytes(row[at..at + 4].try_into().unwrap());
    let scan = |row: &[u8]| u32::from_le_bytes(row[16..20].try_into().unwrap());
    // The first point of scan 1, at its corrected pose (3, 4).
    assert_eq!((float(rows[4], 0), float(rows[4], 4), float(rows[4], 8)), (4.0, 4.0, 0.25));
    assert_eq!((u16::from_le_bytes([rows[4][20], rows[4][21]]), scan(rows[4]), rows[4][22]), (7, 1, 1));
    assert!((float(rows[4], 12) - 0.5).abs() < 1e-4);
    // The last point of every scan has no valid score; scan 2 is not aligned.
    assert_eq!((float(rows[11], 12), scan(rows[11]), rows[11][22]), (-1.0, 2, 0));
}

#[test]
fn the_map_is_a_png_of_the_right_size() {
    let run = Run::new(&facts());
    let file = fs::File::open(run.folder.path().join("map.png")).unwrap();
    let mut reader = png::Decoder::new(io::BufReader::new(file)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    // Known cells and all three poses, 1 m around: 11 m a side at 24 pixels a metre.
    assert_eq!((info.width, info.height), (3 * 16 + 2 * 264, 2 * 16 + 2 * 30 + 264));
}

#[test]
fn the_report_needs_nothing_beside_it_and_shows_the_decisions() {
    let run = Run::new(&facts());
    let page = run.text("report.html");
    for outside in ["src=\"http", "href=", "<script", "<link", "@import", "url(", "src=\"//"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("src=\"data:image/png;base64,"));
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(page.contains("Three &lt;scans&gt; &amp; a plan"), "the title is escaped");
    for shown in
        ["the model is good enough", "overlap 0.10 is below 0.30", "go to (3.10, 4.00)", "seed = 1", "planning"]
    {
        assert!(page.contains(shown), "{shown}");
    }
}

#[test]
fn a_folder_without_a_recording_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let error = write_all(folder.path(), &facts()).unwrap_err().to_string();
    assert!(error.contains("run.mcap"), "{error}");
}

#[test]
fn a_recording_that_was_cut_off_still_gives_every_output() {
    let folder = tempfile::tempdir().unwrap();
    record_run(folder.path());
    let path = folder.path().join(RUN_FILE);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let summary = write_all(folder.path(), &facts()).unwrap();
    assert!(!summary.recording_complete && summary.scans >= 1 && summary.scans <= 3, "{}", summary.scans);
    assert!(fs::read_to_string(folder.path().join("report.html")).unwrap().contains("cut off"));
}
