//! Loops are closed and older scans corrected in the running graph: what is said about it, what the outputs make of it,
//! and that a death in the middle changes nothing.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::process::Stdio;

use mirador_core::analysis::PointScore;
use mirador_core::geometry::pose_from_rows;
use mirador_core::information_map::{Condenser, InformationMap, MapConfig};
use mirador_core::scan::{Grid, Point, ScanView};
use mirador_ipc_schema::messages::{ALIGNMENT_REJECTED, MAP_CAUSE_CORRECTION, MapTile, PAIR_ACCEPTED, PAIR_LOOP};
use mirador_ipc_schema::{ScanId, topics};
use mirador_recorder::RunReader;
use support::observer::{Observer, kill_9};
use support::outputs::recording;
use support::{Stage, finish, small_tour, summary};

/// Every correction moves its scan in the map, however small.
const MOVE_ALL: [&str; 2] = ["planning.corrections.limits.min_shift_m=0", "planning.corrections.limits.min_turn_deg=0"];

/// Two rounds of the tour, whose second goes back over the first; every millimetre is corrected.
const SCANS: u32 = 16;

fn arguments(more: &[&str]) -> Vec<String> {
    let settings = ["acquisition.rounds=2", "alignment.global.correction_threshold_m=0.001"];
    let mut arguments = small_tour();
    arguments.extend(settings.iter().chain(more).flat_map(|s| ["--set".to_owned(), (*s).to_owned()]));
    arguments.push("--quiet".to_owned());
    arguments
}

#[test]
fn corrections_are_published_recorded_explained_and_used_in_the_outputs() {
    let stage = Stage::new();
    stage.run_well(&arguments(&[]));
    let out = stage.path("mirador-out");
    let mut reader = recording(&out);
    let (mut told, mut loops) = (BTreeMap::new(), 0);
    reader
        .for_each::<topics::LoopClosing>(|meta, pairs| {
            loops += pairs.iter().filter(|p| p.kind == PAIR_LOOP && p.status == PAIR_ACCEPTED).count();
            assert!(told.insert(meta.header.scan(), meta.corrections as usize).is_none(), "told twice");
        })
        .unwrap();
    assert_eq!(told.keys().copied().collect::<Vec<_>>(), (0..SCANS).collect::<Vec<_>>());
    assert!(loops > 0, "no loop was closed");
    let (mut sent, mut last) = (BTreeMap::new(), BTreeMap::new());
    reader
        .for_each::<topics::PoseCorrections>(|meta, corrections| {
            *sent.entry(meta.header.scan()).or_insert(0) += corrections.len();
            last.extend(corrections.iter().map(|c| (ScanId::unpack(c.id).scan, c.map_from_scanner)));
        })
        .unwrap();
    told.retain(|_, corrections| *corrections > 0);
    assert_eq!(sent, told, "what is told is what is sent");
    assert!(!last.is_empty(), "nothing was corrected: the test shows nothing");
    let trajectory = fs::read_to_string(out.join("trajectory.tum")).unwrap();
    // One line a scan behind the heading; a comment where it is not aligned.
    let lines: Vec<&str> = trajectory.lines().skip(1).collect();
    assert_eq!(lines.len(), SCANS as usize);
    let aligned = last.iter().filter(|(scan, _)| !lines[**scan as usize].starts_with('#'));
    let mut compared = 0;
    for (scan, pose) in aligned {
        let position = format!("{:.9} {:.9} {:.9}", pose[3], pose[7], pose[11]);
        assert!(lines[*scan as usize].contains(&position), "scan {scan}: {position} in {}", lines[*scan as usize]);
        compared += 1;
    }
    assert!(compared > 0);
    let explained = stage.run_well(&["explain", &out.display().to_string()]);
    assert!(explained.stdout.contains("loop with scan"), "{}", explained.stdout);
    assert!(explained.stdout.contains("poses corrected by up to"), "{}", explained.stdout);
}

#[test]
fn a_killed_alignment_corrects_the_same_to_the_last_bit() {
    let stage = Stage::new();
    stage.run_well(&[arguments(&[]), vec!["--out".to_owned(), "undisturbed".to_owned()]].concat());
    let child = stage.mirador(&arguments(&[])).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    let mut dead = Vec::new();
    for (witness, scans) in [("alignment", 9), ("planning", 11), ("analysis", 13), ("planning", 15)] {
        observer.until(&format!("{witness} has finished {scans} scans"), |seen| {
            let alive = seen.get("alignment").is_some_and(|h| !dead.contains(&h.pid));
            alive && seen.get(witness).is_some_and(|h| h.finished_scans >= scans)
        });
        let pid = observer.pid("alignment");
        kill_9(pid);
        dead.push(pid);
    }
    drop(observer);
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    assert_eq!(summary(&stage.path("mirador-out"))["restarts"], 4);
    for file in ["trajectory.tum", "model.ply"] {
        let [a, b] = ["undisturbed", "mirador-out"].map(|out| fs::read(stage.path(out).join(file)).unwrap());
        assert!(a == b, "{file} is another\n{}", finished.stderr);
    }
    stage.assert_nothing_left();
}

/// Tiles by column, row and level.
type Tiles = BTreeMap<(i32, i32, u32), Box<MapTile>>;

/// The tiles as they are at the end of a recording, by place and level.
fn final_tiles(reader: &mut RunReader) -> (Tiles, u32) {
    let (mut tiles, mut moved) = (BTreeMap::new(), 0);
    reader
        .for_each::<topics::InformationMap>(|meta, items| {
            // An update may come in several messages.
            moved += if meta.part == 0 && meta.cause == MAP_CAUSE_CORRECTION { meta.moved_scans } else { 0 };
            for tile in items {
                tiles.insert((tile.tile_x, tile.tile_y, tile.level), Box::new(*tile));
                let gone = |key: &(i32, i32, u32)| (key.0, key.1) == (tile.tile_x, tile.tile_y) && key.2 >= tile.levels;
                tiles.retain(|key, _| !gone(key));
            }
        })
        .unwrap();
    (tiles, moved)
}

/// The map made from scratch from what was recorded of every scan, each at the pose it has in the end.
fn map_from_scratch(reader: &mut RunReader) -> InformationMap {
    let mut last = BTreeMap::new();
    reader
        .for_each::<topics::PoseCorrections>(|_, corrections| {
            last.extend(corrections.iter().map(|c| (ScanId::unpack(c.id).scan, pose_from_rows(&c.map_from_scanner))));
        })
        .unwrap();
    let config = MapConfig::default();
    let mut map = InformationMap::new(config).unwrap();
    let mut condenser = Condenser::new();
    for number in 0..SCANS {
        let (mut points, mut scores, mut hypotheses) = (Vec::new(), Vec::new(), Vec::new());
        let scan = reader.read_about::<topics::Scan>(number, &mut points).unwrap().unwrap();
        reader.read_about::<topics::ScoredScan>(number, &mut scores).unwrap().unwrap();
        let alignment = reader.read_about::<topics::Alignment>(number, &mut hypotheses).unwrap().unwrap();
        if alignment.status == ALIGNMENT_REJECTED {
            continue;
        }
        let pose = pose_from_rows(&alignment.map_from_scanner).unwrap();
        let grid = Grid { rows: scan.rows as usize, cols: scan.cols as usize };
        let points: &[Point] = bytemuck::cast_slice(&points);
        let view = ScanView::ordered(points, grid).unwrap();
        let scores: &[PointScore] = bytemuck::cast_slice(&scores);
        let (evidence, _) = condenser.condense(view, scores, &pose, &config, 1).unwrap();
        map.add(evidence, &last.get(&number).copied().flatten().unwrap_or(pose)).unwrap();
    }
    map
}

#[test]
fn the_map_in_the_end_is_the_one_made_from_scratch_at_the_corrected_poses() {
    let stage = Stage::new();
    stage.run_well(&arguments(&MOVE_ALL));
    let mut reader = recording(&stage.path("mirador-out"));
    let (tiles, moved) = final_tiles(&mut reader);
    assert!(moved > 0, "no scan was moved: the test shows nothing");
    let map = map_from_scratch(&mut reader);
    let mut cells = 0;
    for (index, cell) in map.known_cells() {
        let tile = index.tile();
        for (k, level) in cell.levels(map.config().clearance_m).as_slice().iter().enumerate() {
            let sent = &tiles[&(tile.x, tile.y, k as u32)].cells[index.within_tile()];
            let evidence = &level.evidence;
            assert_eq!(u64::from(sent.measured), evidence.measured_count(), "{index:?}");
            assert_eq!(u64::from(sent.interpolated), evidence.interpolated_count(), "{index:?}");
            assert_eq!(sent.height.to_bits(), (evidence.height().unwrap() as f32).to_bits(), "{index:?}");
            assert_eq!(sent.quality, (evidence.quality().unwrap() * 65535.0 + 0.5) as u16, "{index:?}");
            cells += 1;
        }
    }
    let sent = tiles.values().flat_map(|tile| &tile.cells).filter(|cell| cell.flags & 1 != 0).count();
    assert_eq!(sent, cells, "cells that the map has not");
}

#[test]
fn a_killed_planning_ends_with_the_same_map() {
    let stage = Stage::new();
    stage.run_well(&[arguments(&MOVE_ALL), vec!["--out".to_owned(), "undisturbed".to_owned()]].concat());
    let child = stage.mirador(&arguments(&MOVE_ALL)).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    let mut dead = Vec::new();
    for (witness, scans) in [("planning", 9), ("alignment", 11), ("recorder", 13), ("alignment", 15)] {
        observer.until(&format!("{witness} has finished {scans} scans"), |seen| {
            let alive = seen.get("planning").is_some_and(|h| !dead.contains(&h.pid));
            alive && seen.get(witness).is_some_and(|h| h.finished_scans >= scans)
        });
        let pid = observer.pid("planning");
        kill_9(pid);
        dead.push(pid);
    }
    drop(observer);
    let finished = finish(child);
    assert_eq!(finished.status.code(), Some(0), "{}", finished.stderr);
    assert_eq!(summary(&stage.path("mirador-out"))["restarts"], 4);
    for file in ["trajectory.tum", "model.ply", "map.png"] {
        let [a, b] = ["undisturbed", "mirador-out"].map(|out| fs::read(stage.path(out).join(file)).unwrap());
        assert!(a == b, "{file} is another\n{}", finished.stderr);
    }
    let [(a, _), (b, _)] = ["undisturbed", "mirador-out"].map(|out| final_tiles(&mut recording(&stage.path(out))));
    let bytes = |tiles: &BTreeMap<(i32, i32, u32), Box<MapTile>>| {
        tiles.iter().map(|(key, tile)| (*key, bytemuck::bytes_of(&**tile).to_vec())).collect::<Vec<_>>()
    };
    assert!(bytes(&a) == bytes(&b), "the tiles are others");
    stage.assert_nothing_left();
}

#[test]
fn without_correction_nothing_is_corrected_and_the_graph_runs_all_the_same() {
    let stage = Stage::new();
    stage.run_well(&arguments(&["alignment.global.method=off"]));
    let reader = recording(&stage.path("mirador-out"));
    assert_eq!(reader.count::<topics::PoseCorrections>(), 0);
    assert_eq!(reader.count::<topics::LoopClosing>(), SCANS as usize);
}

#[test]
fn a_graph_without_planning_does_not_wait_for_a_plan() {
    let stage = Stage::new();
    fs::write(
        stage.path("graph.toml"),
        "config_version = 1\n[services.acquisition]\n[services.alignment]\n[services.analysis]\n[services.recorder]\n\
         [alignment]\nplan_patience_ms = 60000\n",
    )
    .unwrap();
    let graph = stage.path("graph.toml").display().to_string();
    stage.run_well(&[vec!["up".to_owned(), graph], arguments(&[]).split_off(1)].concat());
    assert_eq!(recording(&stage.path("mirador-out")).count::<topics::LoopClosing>(), SCANS as usize);
}

/// The world *simple* with a tour around the house that ends a little beyond where it began.
fn ring(stage: &Stage) -> String {
    let world = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../worlds/simple.toml")).unwrap();
    let (world, _) = world.split_once("[[poses]]").unwrap();
    let pose = |k: u32| {
        let angle = (f64::from(k) * 24.0 - 110.0).to_radians();
        let (x, y) = (1.0 + 12.5 * angle.cos(), 1.5 + 12.0 * angle.sin());
        format!("[[poses]]\nx_m = {x:.3}\ny_m = {y:.3}\nyaw_deg = {:.1}\n\n", angle.to_degrees() + 90.0)
    };
    let path = stage.path("ring.toml");
    fs::write(&path, world.to_owned() + &(0..RING).map(pose).collect::<String>()).unwrap();
    path.display().to_string()
}

/// Scans of the ring.
const RING: u32 = 17;

#[test]
fn a_tour_around_the_house_with_the_full_scanner_closes_a_verified_loop_and_is_corrected() {
    let stage = Stage::new();
    let scene = format!("acquisition.scene={}", ring(&stage));
    stage.run_well(&["tour", "--quiet", "--set", &scene, "--set", "alignment.global.correction_threshold_m=0.001"]);
    let out = stage.path("mirador-out");
    let summary = summary(&out);
    assert_eq!((&summary["scans"], &summary["aligned"]), (&RING.into(), &RING.into()), "{}", summary["poses"]);
    let mut loops = Vec::new();
    let mut corrected = 0;
    recording(&out)
        .for_each::<topics::LoopClosing>(|meta, pairs| {
            let closed = pairs.iter().filter(|p| p.kind == PAIR_LOOP && p.status == PAIR_ACCEPTED);
            loops.extend(closed.map(|p| (ScanId::unpack(p.target_id).scan, ScanId::unpack(p.source_id).scan)));
            corrected += meta.corrections;
        })
        .unwrap();
    // From the end of the round to its beginning, which no chain of neighbours sees.
    assert!(loops.iter().any(|(target, source)| source - target >= 12), "{loops:?}");
    assert!(corrected > 0, "nothing was corrected");
    // Before the loop the end of the round is half a metre off.
    let error = summary["errors"]["ate_rmse_m"].as_f64().unwrap();
    assert!(error < 0.15, "{}", summary["errors"]);
}
