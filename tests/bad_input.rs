//! What a user can get wrong: one line that says what to do, the right exit code, and nothing left behind.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};

use mirador_ipc_schema::budget;
use mirador_ipc_schema::topics::Sizes;
use support::observer::Observer;
use support::{Finished, Stage, finish, living, say_skipped, signal, small_tour, summary};

/// Runs the program and expects it to refuse: this exit code, and one line with all these words in it.
fn refused(stage: &Stage, arguments: &[&str], code: i32, words: &[&str]) -> String {
    let line = assert_refused(&stage.run(arguments), code, words);
    stage.assert_nothing_left();
    line
}

fn assert_refused(finished: &Finished, code: i32, words: &[&str]) -> String {
    let lines: Vec<&str> = finished.stderr.lines().collect();
    assert_eq!(lines.len(), 1, "one line and no more:\n{}", finished.stderr);
    let line = lines[0];
    assert!(line.starts_with("error: "), "{line}");
    for word in words {
        assert!(line.contains(word), "'{word}' is missing in: {line}");
    }
    assert_eq!(finished.status.code(), Some(code), "{line}");
    line.to_owned()
}

/// The wall, floor and pillars around a scanner at `x`, in its own frame [m].
fn room(x: f64) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for i in 0..20 {
        for j in 0..20 {
            let (u, v, w) = (-4.0 + 0.42 * f64::from(i), -4.0 + 0.42 * f64::from(j), -1.0 + 0.13 * f64::from(j));
            points.extend([[u - x, v, -1.0], [4.0 - x, u, w], [u - x, 4.0, w], [-4.0 - x, 0.9 * u, w]]);
        }
    }
    points
}

const ROOM_POINTS: usize = 1600;

/// A cloud as 3DTK writes it: centimetres, left-handed.
fn tdtk(points: &[[f64; 3]]) -> String {
    let mut text = String::new();
    for [x, y, z] in points {
        writeln!(text, "{:.2} {:.2} {:.2}", -y * 100.0, z * 100.0, x * 100.0).unwrap();
    }
    text
}

/// A cloud as PLY in text, its header promising `promised` points.
fn ply(points: &[[f64; 3]], promised: usize) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {promised}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    );
    for [x, y, z] in points {
        writeln!(text, "{x:.4} {y:.4} {z:.4}").unwrap();
    }
    text
}

/// Four scans of the room from places 0.2 m apart; `encode` writes the scan of a number.
fn record(folder: &Path, ending: &str, encode: impl Fn(usize, &[[f64; 3]]) -> String) {
    fs::create_dir_all(folder).unwrap();
    for scan in 0..4 {
        let points = room(0.2 * scan as f64);
        assert_eq!(points.len(), ROOM_POINTS);
        fs::write(folder.join(format!("scan{scan:03}.{ending}")), encode(scan, &points)).unwrap();
    }
}

fn good_scans(stage: &Stage) {
    record(&stage.path("scans"), "3d", |_, points| tdtk(points));
}

#[test]
fn a_path_that_is_not_there() {
    let stage = Stage::new();
    refused(&stage, &["replay", "gone"], 2, &["gone", "no such file", "check the spelling"]);
    refused(&stage, &["up", "gone.toml"], 2, &["gone.toml", "cannot be read"]);
    refused(&stage, &["explain", "gone"], 1, &["gone"]);
}

#[test]
fn a_path_that_holds_no_scans() {
    let stage = Stage::new();
    fs::write(stage.path("notes.txt"), "bring batteries").unwrap();
    refused(&stage, &["replay", "notes.txt"], 2, &["notes.txt", "not a known cloud format", ".pcd", ".laz"]);
    fs::create_dir(stage.path("folder")).unwrap();
    refused(&stage, &["replay", "folder"], 2, &["folder", "no scans", ".3d", ".ply"]);
    fs::write(stage.path("folder/notes.txt"), "bring batteries").unwrap();
    refused(&stage, &["replay", "folder"], 2, &["folder", "no scans", ".3d", ".ply"]);
}

#[test]
fn a_path_that_may_not_be_read() {
    let stage = Stage::new();
    good_scans(&stage);
    fs::set_permissions(stage.path("scans"), fs::Permissions::from_mode(0o000)).unwrap();
    let own = stage.run(&["replay", "scans"]);
    if own.status.success() {
        // The rights of root are not asked for; another user's are.
        let nobody = "65534";
        let mut command = Command::new("setpriv");
        command.args(["--reuid", nobody, "--clear-groups", env!("CARGO_BIN_EXE_mirador")]);
        command.args(["replay", "scans", "--domain", stage.domain().name()]).current_dir(stage.path("."));
        fs::set_permissions(stage.path("."), fs::Permissions::from_mode(0o755)).unwrap();
        let ran = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        match ran.map(finish) {
            Ok(finished) if !finished.stderr.starts_with("setpriv") => {
                assert_refused(&finished, 2, &["scans", "cannot be read", "check that you may read it"]);
            }
            _ => say_skipped("a_path_that_may_not_be_read", "this is root, and setpriv cannot become another user"),
        }
    } else {
        assert_refused(&own, 2, &["scans", "cannot be read", "check that you may read it"]);
    }
    fs::set_permissions(stage.path("scans"), fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn a_folder_of_two_formats() {
    let stage = Stage::new();
    good_scans(&stage);
    fs::write(stage.path("scans/other.ply"), ply(&room(0.0), ROOM_POINTS)).unwrap();
    refused(&stage, &["replay", "scans"], 2, &["other.ply", "scan000.3d", "one format"]);
}

#[test]
fn a_scan_without_points() {
    let stage = Stage::new();
    good_scans(&stage);
    fs::write(stage.path("scans/scan002.3d"), "# nothing was seen\n").unwrap();
    refused(&stage, &["replay", "scans"], 2, &["scan002.3d", "no point", "leave the file out"]);
}

#[test]
fn a_graph_file_with_a_mistake_is_answered_with_file_line_key_and_what_is_allowed() {
    let stage = Stage::new();
    let cases: [(&str, &[&str]); 9] = [
        ("[services.alignmnt]", &["graph.toml:2:", "alignmnt", "`alignment`", "`acquisition`", "`recorder`"]),
        (
            "[alignment]\nregistration = \"magic\"",
            &["graph.toml:3:", "alignment.registration", "magic", "point_to_plane", "point_to_point"],
        ),
        ("[graph]\nlockstop = true", &["graph.toml:3:", "lockstop", "`lockstep`", "`domain`"]),
        ("[services.planning]\nthreads = \"two\"", &["graph.toml:3:", "threads", "two", "expected usize"]),
        ("[services.planning]\nthreads = 1000", &["graph.toml:3:", "services.planning.threads", "1000", "1 to 256"]),
        ("[services.planning]\nrestart = \"often\"", &["graph.toml:3:", "restart", "often", "`on-failure`", "`never`"]),
        ("[acquisition]\nrounds = 0", &["graph.toml:2:", "acquisition.rounds", "1 to 10000"]),
        ("[graph]\nmax_points = 9223372036854775807", &["graph.toml:3:", "graph.max_points", "0", "1000000000"]),
        ("[graph", &["graph.toml:2:"]),
    ];
    for (text, words) in cases {
        fs::write(stage.path("graph.toml"), format!("config_version = 1\n{text}\n")).unwrap();
        refused(&stage, &["up", "graph.toml"], 2, words);
    }
    fs::write(stage.path("graph.toml"), "config_version = 7\n").unwrap();
    refused(&stage, &["up", "graph.toml"], 2, &["graph.toml:1:", "config_version", "7", "write 1"]);
}

#[test]
fn a_graph_that_runs_nothing() {
    let stage = Stage::new();
    fs::write(stage.path("graph.toml"), "config_version = 1\n").unwrap();
    refused(&stage, &["up", "graph.toml"], 2, &["runs nothing", "[services.acquisition]"]);
}

#[test]
fn a_setting_with_a_mistake() {
    let stage = Stage::new();
    let line = refused(
        &stage,
        &["--set", "graph.lockstep=true", "--set", "alignment.registratoin=x"],
        2,
        &["--set alignment.registratoin=x", "`registration`"],
    );
    assert!(!line.contains("lockstep=true") && !line.contains("graph.domain"), "only the wrong one is named: {line}");
    refused(&stage, &["--set", "graph.lockstep"], 2, &["--set graph.lockstep", "KEY=VALUE"]);
    refused(&stage, &["--set", "graph.lockstep=perhaps"], 2, &["--set graph.lockstep=perhaps", "boolean"]);
    refused(&stage, &["tour", "moon"], 2, &["moon", "simple"]);
    refused(&stage, &["run", "alignmnt"], 2, &["alignmnt", "alignment", "recorder"]);
}

#[test]
fn a_bad_domain_name() {
    let stage = Stage::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_mirador"));
    command.args(["--domain", "../other"]).current_dir(stage.path(".")).stdin(Stdio::null());
    let finished = finish(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    assert_refused(&finished, 2, &["graph.domain", "../other", "a-z"]);
}

#[test]
fn a_domain_that_is_in_use_and_an_output_that_is_being_written() {
    let stage = Stage::new();
    let mut arguments = small_tour();
    arguments.extend(["--set", "acquisition.rounds=1000", "--quiet"].map(str::to_owned));
    let child = stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    observer.until_finished("recorder", 2);
    drop(observer);
    // The same command in the same folder: the run that is under way must not notice.
    let words = ["domain", stage.domain().name(), "in use", "--domain"];
    assert_refused(&stage.run(&arguments), 2, &words);
    assert!(!stage.path("mirador-out.1").exists(), "the output of the running graph was moved away");
    assert_eq!(living(stage.domain()).len(), 6);
    signal(child.id(), "INT");
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert_eq!(finished.stderr, "");
    assert!(summary(&stage.path("mirador-out"))["scans"].as_u64().unwrap() >= 2);
    stage.assert_nothing_left();
}

#[test]
fn an_output_folder_of_somebody_else() {
    let stage = Stage::new();
    fs::create_dir(stage.path("thesis")).unwrap();
    fs::write(stage.path("thesis/chapter1.tex"), "In the beginning").unwrap();
    refused(&stage, &["--out", "thesis"], 2, &["thesis", "not an output of mirador", "--out"]);
    assert_eq!(fs::read_dir(stage.path("thesis")).unwrap().count(), 1, "nothing was written there");
    refused(&stage, &["--out", "thesis/chapter1.tex"], 2, &["chapter1.tex", "--out"]);
    refused(&stage, &["--out", "/proc/out"], 1, &["/proc/out", "cannot be made"]);
}

#[test]
fn an_output_is_kept_when_the_next_run_cannot_begin() {
    let stage = Stage::new();
    good_scans(&stage);
    stage.run_well(&["replay", "scans", "--quiet"]);
    refused(&stage, &["replay", "gone"], 2, &["gone"]);
    refused(&stage, &["--set", "graph.max_points=900000000"], 2, &["/dev/shm"]);
    assert!(stage.path("mirador-out/summary.json").is_file());
    assert!(!stage.path("mirador-out.1").exists());
}

/// Runs the program with another `/dev/shm`; `None` when this machine does not allow it.
fn with_shared_memory(stage: &Stage, bytes: u64, arguments: &[String]) -> Option<Finished> {
    let script = "mount -t tmpfs -o size=$0 tmpfs /dev/shm || exit 77; exec \"$@\"";
    let mut command = Command::new("unshare");
    command.args(["--mount", "sh", "-c", script, &bytes.to_string(), env!("CARGO_BIN_EXE_mirador")]);
    command.args(arguments).args(["--domain", stage.domain().name()]).current_dir(stage.path("."));
    let ran = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let finished = ran.ok().map(finish)?;
    let allowed = finished.status.code() != Some(77) && !finished.stderr.starts_with("unshare");
    allowed.then_some(finished)
}

#[test]
fn shared_memory_that_is_too_small_is_told_before_anything_starts() {
    let stage = Stage::new();
    let arguments: Vec<String> = small_tour().into_iter().chain(["--quiet".to_owned()]).collect();
    let points = 136 * 180;
    let services = ["acquisition", "alignment", "analysis", "planning", "recorder"];
    let needed = budget::total(&budget::of_graph(&services, &Sizes { scan_points: points }));
    let Some(finished) = with_shared_memory(&stage, needed / 2, &arguments) else {
        say_skipped("shared_memory_that_is_too_small", "mounting a small /dev/shm is not permitted here");
        return;
    };
    assert_refused(&finished, 2, &["/dev/shm", "MB", "--shm-size=", "graph.max_points"]);
    assert!(!stage.path("mirador-out").exists());
    stage.assert_nothing_left();
    // What the budget promises is enough; one page less than that is refused.
    let just_enough = needed.next_multiple_of(4096);
    let finished = with_shared_memory(&stage, just_enough - 4096, &arguments).unwrap();
    assert_refused(&finished, 2, &["/dev/shm"]);
    let finished = with_shared_memory(&stage, just_enough, &arguments).unwrap();
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    assert_eq!(summary(&stage.path("mirador-out"))["scans"], 8);
}

#[test]
fn a_scan_that_is_larger_than_its_slots() {
    let stage = Stage::new();
    good_scans(&stage);
    let words = ["1600 points", "hold 1000", "raise graph.max_points to 1600", "0"];
    refused(&stage, &["replay", "scans", "--set", "graph.max_points=1000"], 2, &words);
}

#[test]
fn poses_that_do_not_fit_the_scans() {
    let stage = Stage::new();
    good_scans(&stage);
    fs::write(stage.path("scans/three.tum"), "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n").unwrap();
    let words = ["three.tum", "3", "4 scans", "one line per scan"];
    refused(&stage, &["replay", "scans", "--poses", "three.tum"], 2, &words);
    refused(&stage, &["replay", "scans", "--truth", "three.tum"], 2, &words);
    refused(&stage, &["replay", "scans", "--poses", "gone.tum"], 2, &["gone.tum", "no such file"]);
    fs::write(stage.path("scans/words.tum"), "north south\n").unwrap();
    refused(&stage, &["replay", "scans", "--poses", "words.tum"], 2, &["words.tum", "line 1"]);
}

#[test]
fn a_grid_that_does_not_fit_the_points() {
    let stage = Stage::new();
    good_scans(&stage);
    let words = ["scan000.3d", "1600 points", "30x40", "1200", "--grid"];
    refused(&stage, &["replay", "scans", "--grid", "30x40"], 2, &words);
    refused(&stage, &["replay", "scans", "--grid", "wide"], 2, &["wide", "ROWSxCOLS"]);
    let words = ["range_max_m", "greater than"];
    refused(&stage, &["replay", "scans", "--min-range", "9", "--max-range", "3"], 2, &words);
}

/// A folder whose third scan turns out to be broken when it is read. The run must fail by the name of the file and
/// leave what came before it.
fn breaks_in_the_middle(ending: &str, folder: &str, third: impl Fn(&[[f64; 3]]) -> String, words: &[&str]) {
    let stage = Stage::new();
    let encode = |points: &[[f64; 3]]| if ending == "3d" { tdtk(points) } else { ply(points, ROOM_POINTS) };
    record(&stage.path(folder), ending, |scan, points| if scan == 2 { third(points) } else { encode(points) });
    let finished = stage.run(&["replay", folder, "--quiet"]);
    stage.assert_nothing_left();
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    let errors: Vec<&str> = finished.stderr.lines().filter(|l| l.starts_with("error:")).collect();
    assert_eq!(errors.len(), 1, "{}", finished.stderr);
    for word in words {
        assert!(errors[0].contains(word), "'{word}' is missing in: {}", errors[0]);
    }
    assert!(finished.stderr.contains("mirador-out"), "it says where the rest is: {}", finished.stderr);
    let out = stage.path("mirador-out");
    assert_eq!(summary(&out)["scans"], 2);
    assert_eq!(summary(&out)["recording_complete"], true);
    let trajectory = fs::read_to_string(out.join("trajectory.tum")).unwrap();
    let poses = trajectory.lines().filter(|l| !l.starts_with("# timestamp")).count();
    assert_eq!(poses, 2, "{trajectory}");
    assert!(fs::metadata(out.join("model.ply")).unwrap().len() > 2 * ROOM_POINTS as u64);
}

#[test]
fn a_word_in_the_third_scan_ends_the_run_with_the_scans_before_it() {
    let with_word = |points: &[[f64; 3]]| {
        let mut lines: Vec<String> = tdtk(points).lines().map(str::to_owned).collect();
        lines[499] = "12.5 fog 3.0".to_owned();
        lines.join("\n")
    };
    breaks_in_the_middle("3d", "scans", with_word, &["scan002.3d", "line 500", "fog", "number"]);
}

#[test]
fn a_third_scan_that_ends_too_early_ends_the_run_with_the_scans_before_it() {
    // Long numbers: the file is as large as so many points can need at least, and yet some are missing.
    let cut = |points: &[[f64; 3]]| ply(&points[..1000], ROOM_POINTS);
    breaks_in_the_middle("ply", "scans", cut, &["scan002.ply", "ends too early", "600 more", "incomplete"]);
}

#[test]
fn the_error_of_a_scan_is_whole_however_long_its_path_is() {
    let cut = |points: &[[f64; 3]]| ply(&points[..1000], ROOM_POINTS);
    let folder = format!("{}/{}", "a".repeat(120), "b".repeat(120));
    breaks_in_the_middle("ply", &folder, cut, &["scan002.ply", "ends too early", "600 more", "incomplete"]);
}
