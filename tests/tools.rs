//! The command line beside the runs: conversions, help, services, graph files, foreign programs.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use mirador_core::formats::{read_cloud, read_poses};
use mirador_core::scan::Point;
use support::{Finished, Stage, data, small_tour, summary};

/// A wrong command line is answered by one line on standard error, nothing else.
fn expect_one_line(finished: &Finished, codes: &[i32]) -> String {
    let code = finished.status.code().unwrap();
    assert!(codes.contains(&code), "exit code {code}: {}", finished.stderr);
    assert_eq!(finished.stderr.trim_end().lines().count(), 1, "{}", finished.stderr);
    finished.stderr.trim_end().to_owned()
}

fn farthest_apart(a: &[Point], b: &[Point]) -> f32 {
    assert_eq!(a.len(), b.len());
    let distance = |(a, b): (&Point, &Point)| (a.x - b.x).abs().max((a.y - b.y).abs()).max((a.z - b.z).abs());
    a.iter().zip(b).map(distance).fold(0.0, f32::max)
}

#[test]
fn a_cloud_survives_the_round_through_all_formats() {
    let Some(original) = data("tools", "3dtk_dat/scan000.3d") else { return };
    let stage = Stage::new();
    let convert = |from: &str, to: &str| {
        let finished = stage.run_well(&["convert", from, to]);
        assert!(finished.stdout.contains("81360 read, 81360 written"), "{}", finished.stdout);
        read_cloud(&stage.path(to)).unwrap()
    };
    let first = read_cloud(&original).unwrap();
    let ply = convert(&original.display().to_string(), "a.ply");
    let pcd = convert("a.ply", "b.pcd");
    let las = convert("b.pcd", "c.las");
    let back = convert("c.las", "d.ply");
    assert_eq!(farthest_apart(&first.points, &ply.points), 0.0, "f32 into f32");
    assert_eq!(farthest_apart(&first.points, &pcd.points), 0.0, "f32 into f32");
    // LAS counts in steps, a tenth of a millimetre here.
    assert!(
        farthest_apart(&first.points, &las.points) <= 6e-5 + 1e-6,
        "{}",
        farthest_apart(&first.points, &las.points)
    );
    assert_eq!(farthest_apart(&las.points, &back.points), 0.0);
    let quiet = stage.run_well(&["convert", "a.ply", "e.laz", "--quiet"]);
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
    assert_eq!(farthest_apart(&read_cloud(&stage.path("e.laz")).unwrap().points, &las.points), 0.0);
}

#[test]
fn an_order_given_on_the_command_line_is_kept_by_pcd() {
    let Some(original) = data("tools", "3dtk_dat/scan000.3d") else { return };
    let stage = Stage::new();
    let original = original.display().to_string();
    stage.run_well(&["convert", &original, "a.pcd", "--grid", "226x360"]);
    let grid = read_cloud(&stage.path("a.pcd")).unwrap().grid.unwrap();
    assert_eq!((grid.rows, grid.cols), (226, 360));
    let refused = stage.run(&["convert", &original, "a.ply", "--grid", "226x360"]);
    assert!(expect_one_line(&refused, &[2]).contains(".pcd"));
    let wrong = stage.run(&["convert", &original, "b.pcd", "--grid", "12x12"]);
    assert!(!wrong.status.success() && !stage.path("b.pcd").exists());
}

#[test]
fn pose_files_become_tum() {
    let (Some(tdtk), Some(handheld)) = (data("tools", "3dtk_dat"), data("tools", "handheld/odometry.tum")) else {
        return;
    };
    let stage = Stage::new();
    for (number, source) in [tdtk, handheld].iter().enumerate() {
        let name = format!("{number}.tum");
        stage.run_well(&["convert", &source.display().to_string(), &name]);
        let (before, after) = (read_poses(source).unwrap(), read_poses(&stage.path(&name)).unwrap());
        assert_eq!(before.len(), after.len());
        for (a, b) in before.iter().zip(&after) {
            let error = a.map_from_scanner.inverse() * b.map_from_scanner;
            assert!(error.translation.vector.norm() < 1e-6 && error.rotation.angle() < 1e-6, "{error:?}");
        }
    }
}

#[test]
fn a_conversion_that_cannot_be_done_is_one_line_and_leaves_nothing() {
    let stage = Stage::new();
    fs::write(stage.path("a.xyz32.bin"), 1.0_f32.to_le_bytes().repeat(9)).unwrap();
    let message = expect_one_line(&stage.run(&["convert", "a.xyz32.bin", "b.docx"]), &[2]);
    assert!(message.contains("b.docx") && message.contains(".ply"), "{message}");
    fs::write(stage.path("a.docx"), "x").unwrap();
    let message = expect_one_line(&stage.run(&["convert", "a.docx", "b.ply"]), &[2]);
    assert!(message.contains("a.docx") && message.contains("known"), "{message}");
    let message = expect_one_line(&stage.run(&["convert", "nowhere.ply", "b.ply"]), &[1, 2]);
    assert!(message.contains("nowhere.ply"), "{message}");
    let message = expect_one_line(&stage.run(&["convert", "a.xyz32.bin", "a.xyz32.bin"]), &[2]);
    assert!(message.contains("same file"), "{message}");
    let names: Vec<_> = fs::read_dir(stage.path("")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn help_and_version_are_no_errors_and_an_unknown_command_is() {
    let stage = Stage::new();
    let help = stage.run_well(&["--help"]).stdout;
    for word in ["replay", "up", "run", "top", "bench", "explain", "convert", "doctor", "--out", "--domain", "--set"] {
        assert!(help.contains(word), "{word}");
    }
    for hidden in ["exec-child", "bench-peer"] {
        assert!(!help.contains(hidden), "{hidden}");
    }
    let version = stage.run_well(&["--version"]).stdout;
    assert_eq!(version.trim_end(), format!("mirador {}", env!("CARGO_PKG_VERSION")));
    for wrong in [vec!["dance"], vec!["replay"], vec!["--nonsense"], vec!["up"]] {
        let finished = stage.run(&wrong);
        assert_eq!(finished.status.code(), Some(2), "{wrong:?}: {}", finished.stderr);
        assert!(finished.stderr.starts_with("error: ") && finished.stdout.is_empty(), "{}", finished.stderr);
    }
    assert!(!stage.path("mirador-out").exists());
}

#[test]
fn an_unknown_service_is_told_the_known_ones() {
    let stage = Stage::new();
    let message = expect_one_line(&stage.run(&["run", "nosuchservice"]), &[2]);
    for name in ["nosuchservice", "acquisition", "alignment", "analysis", "planning", "recorder"] {
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn the_saved_configuration_gives_itself_again() {
    let stage = Stage::new();
    let mut arguments: Vec<String> = ["--out", "first"].map(str::to_owned).to_vec();
    arguments.extend(small_tour());
    arguments.extend(["--set", "acquisition.max_scans=2", "--set", "planning.seed=7"].map(str::to_owned));
    stage.run_well(&arguments);
    let saved = |out: &str| fs::read_to_string(stage.path(out).join("config.toml")).unwrap();
    assert!(saved("first").contains("max_scans = 2") && saved("first").contains("seed = 7"));
    stage.run_well(&["tour", "--config", "first/config.toml", "--out", "second"]);
    assert_eq!(saved("first"), saved("second"));
    stage.run_well(&["up", "first/config.toml", "--out", "third"]);
    assert_eq!(saved("first"), saved("third"));
}

#[test]
fn the_saved_configuration_of_a_replay_gives_itself_again() {
    let Some(scans) = data("tools", "handheld") else { return };
    let stage = Stage::new();
    let scans = scans.display().to_string();
    let replay =
        ["replay", &scans, "--max-scans", "2", "--poses", "odometry.tum", "--max-range", "30", "--out", "first"];
    stage.run_well(&replay);
    let saved = |out: &str| fs::read_to_string(stage.path(out).join("config.toml")).unwrap();
    stage.run_well(&["replay", &scans, "--config", "first/config.toml", "--out", "second"]);
    assert_eq!(saved("first"), saved("second"));
    stage.run_well(&["up", "first/config.toml", "--out", "third"]);
    assert_eq!(saved("first"), saved("third"));
    assert_eq!(summary(&stage.path("third"))["aligned"], 2);
}

#[test]
fn what_would_change_the_scans_of_a_recording_is_refused() {
    let stage = Stage::new();
    for option in [["--grid", "2x3"], ["--poses", "p.tum"], ["--min-range", "1"], ["--max-range", "9"]] {
        let message = expect_one_line(&stage.run(&["replay", "run.mcap", option[0], option[1]]), &[2]);
        assert!(message.contains(option[0]) && message.contains("run.mcap"), "{message}");
    }
}

/// A graph of the built-in scene, seen with few beams, and whatever is added.
fn graph_file(stage: &Stage, more: &str) -> String {
    let text = format!(
        "config_version = 1\n\
         [services.acquisition]\n[services.alignment]\nthreads = 2\n[services.analysis]\n[services.planning]\n\
         [services.recorder]\n\
         [acquisition]\nsource = \"scene\"\nscene = \"simple\"\nmax_scans = 3\n\
         [acquisition.scanner]\nbeams = 136\nbeam_step_deg = 2.0\nsweeps = 180\n\
         {more}"
    );
    fs::write(stage.path("graph.toml"), text).unwrap();
    "graph.toml".to_owned()
}

fn script(stage: &Stage, name: &str, text: &str) -> String {
    let path = stage.path(name);
    fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path.display().to_string()
}

/// Whether a process runs; one that has ended and waits for its parent does not.
fn is_alive(pid: &str) -> bool {
    let status = fs::read_to_string(Path::new("/proc").join(pid.trim()).join("status")).unwrap_or_default();
    status.lines().any(|line| line.starts_with("State:") && !line.contains("zombie"))
}

#[test]
fn a_graph_file_is_launched_as_written() {
    let stage = Stage::new();
    let graph = graph_file(&stage, "");
    stage.run_well(&["up", &graph, "--out", "out"]);
    let summary = summary(&stage.path("out"));
    assert_eq!((&summary["scans"], &summary["aligned"]), (&3.into(), &3.into()));
    assert_eq!(summary["title"], "graph");
    assert!(summary["coverage"].as_f64().is_some() && summary["errors"]["n"] == 3, "a scene knows its truth");
    let both = stage.run(&["up", &graph, "--config", &graph]);
    assert!(expect_one_line(&both, &[2]).contains("--config"));
}

#[test]
fn a_foreign_program_is_started_with_the_graph_and_stopped_with_it() {
    let stage = Stage::new();
    // A child of its own: the whole family is to be gone at the end.
    let path = script(
        &stage,
        "driver.sh",
        "(trap '' TERM; sleep 600) &\necho $! >> \"$MIRADOR_RUN_DIR/pids\"\necho $$ >> \"$MIRADOR_RUN_DIR/pids\"\n\
         echo \"$1 $MIRADOR_INCARNATION\" > \"$MIRADOR_RUN_DIR/seen\"\necho spoken >&2\nwait",
    );
    let graph =
        graph_file(&stage, &format!("[programs.driver]\ncommand = [\"{path}\", \"an argument\"]\ncores = [0]\n"));
    let finished = stage.run_well(&["up", &graph, "--out", "out"]);
    assert!(finished.stderr.is_empty(), "{}", finished.stderr);
    let out = stage.path("out");
    assert_eq!(fs::read_to_string(out.join("seen")).unwrap(), "an argument 0\n");
    let pids = fs::read_to_string(out.join("pids")).unwrap();
    assert_eq!(pids.lines().count(), 2, "started once: {pids}");
    for pid in pids.lines() {
        support::eventually("the family of the program is gone", || !is_alive(pid));
    }
    assert_eq!(fs::read_to_string(out.join("logs/driver.log")).unwrap(), "spoken\n");
    let summary = summary(&out);
    assert_eq!((&summary["aligned"], &summary["restarts"]), (&3.into(), &0.into()));
}

#[test]
fn a_foreign_program_stays_on_its_cores() {
    let stage = Stage::new();
    let path =
        script(&stage, "driver.sh", "grep Cpus_allowed_list /proc/self/status > \"$MIRADOR_RUN_DIR/cores\"\nsleep 600");
    let graph = graph_file(&stage, &format!("[programs.driver]\ncommand = [\"{path}\"]\ncores = [0]\n"));
    stage.run_well(&["up", &graph, "--out", "out"]);
    let cores = fs::read_to_string(stage.path("out/cores")).unwrap();
    assert_eq!(cores.split_whitespace().last(), Some("0"), "{cores}");
}

#[test]
fn a_foreign_program_that_ends_well_does_not_end_the_run() {
    let stage = Stage::new();
    let path = script(&stage, "once.sh", "echo done > \"$MIRADOR_RUN_DIR/once\"");
    let graph = graph_file(&stage, &format!("[programs.once]\ncommand = [\"{path}\"]\n"));
    stage.run_well(&["up", &graph, "--out", "out"]);
    assert_eq!(fs::read_to_string(stage.path("out/once")).unwrap(), "done\n");
    assert_eq!(summary(&stage.path("out"))["aligned"], 3);
}

#[test]
fn a_foreign_program_that_ignores_the_wish_to_end_is_killed() {
    let stage = Stage::new();
    let path =
        script(&stage, "deaf.sh", "trap '' TERM\necho $$ > \"$MIRADOR_RUN_DIR/pid\"\nwhile true; do sleep 1; done");
    let graph = graph_file(&stage, &format!("[programs.deaf]\ncommand = [\"{path}\"]\n"));
    stage.run_well(&["up", &graph, "--out", "out"]);
    let pid = fs::read_to_string(stage.path("out/pid")).unwrap();
    assert!(!is_alive(&pid), "process {pid} is left");
    assert_eq!(summary(&stage.path("out"))["aligned"], 3);
}

#[test]
fn a_foreign_program_that_cannot_be_started_ends_the_run_and_is_named() {
    let stage = Stage::new();
    let graph = graph_file(&stage, "[programs.driver]\ncommand = [\"/nowhere/driver\"]\nmax_restarts = 0\n");
    let finished = stage.run(&["up", &graph, "--out", "out", "--quiet"]);
    let said = finished.stderr.lines().next().unwrap_or_default().to_owned();
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
    assert!(said.contains("driver ended") && said.contains("/nowhere/driver"), "{said}");
    stage.assert_nothing_left();
}
