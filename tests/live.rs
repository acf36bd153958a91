//! A run live in a viewer: what a client of the WebSocket sees is what the recording has.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Stdio};

use foxglove::Decode;
use foxglove::messages::{Grid, PointCloud, PosesInFrame, SceneUpdate};
use mirador_ipc_schema::text;
use support::observer::Observer;
use support::viewer::Viewer;
use support::{Stage, finish, small_tour};

/// The small tour with the gateway at this port; 0 for any.
fn live(stage: &Stage, port: u16, more: &[&str]) -> Child {
    let mut arguments = small_tour();
    let port = format!("gateway.port={port}");
    let settings = [&["--live", "--set", port.as_str()], more].concat();
    arguments.extend(settings.iter().map(|s| (*s).to_owned()));
    stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// What the gateway says of itself, once `part` is in it.
fn said(stage: &Stage, part: &str) -> String {
    let mut said = String::new();
    let mut observer = Observer::join(stage.domain());
    observer.until(&format!("the gateway says {part}"), |seen| {
        said = seen.get("gateway").map_or(String::new(), |health| text::unpack(&health.message).to_owned());
        said.contains(part)
    });
    said
}

/// The drawings of a recording by channel.
fn recorded(out: &Path) -> BTreeMap<String, Vec<Vec<u8>>> {
    let bytes = fs::read(out.join("run.mcap")).unwrap();
    let mut drawings: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        drawings.entry(message.channel.topic.clone()).or_default().push(message.data.to_vec());
    }
    drawings
}

fn decode<M: Decode>(bytes: &[u8]) -> M {
    M::decode(bytes).ok().unwrap()
}

#[test]
fn a_viewer_sees_live_what_the_recording_has() {
    let stage = Stage::new();
    // By time, so that the viewer is there before the last scans.
    let child = live(&stage, 0, &["--set", "graph.lockstep=false", "--set", "acquisition.speed=4"]);
    let port = said(&stage, "ws://").rsplit(':').next().unwrap().parse().unwrap();
    let mut viewer = Viewer::connect(port);
    let mut seen: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    while let Some((channel, _, bytes)) = viewer.next() {
        seen.entry(channel).or_default().push(bytes);
    }
    let finished = finish(child);
    assert!(finished.status.success(), "{}\n{}", finished.stdout, finished.stderr);
    stage.assert_nothing_left();
    assert!(finished.stdout.contains("live at ws://127.0.0.1:0"), "{}", finished.stdout);

    let recorded = recorded(&stage.path("mirador-out"));
    let clouds: Vec<PointCloud> = recorded["/cloud"].iter().map(|bytes| decode(bytes)).collect();
    assert!(seen["/cloud"].len() >= 4, "{}", seen["/cloud"].len());
    for cloud in seen["/cloud"].iter().map(|bytes| decode::<PointCloud>(bytes)) {
        let same = |other: &PointCloud| other.data == cloud.data && other.pose == cloud.pose;
        assert!(clouds.iter().any(same), "one of the recorded scans, at its pose");
    }
    let poses = |drawings: &[Vec<u8>]| decode::<PosesInFrame>(drawings.last().unwrap()).poses;
    let last = poses(&seen["/poses"]);
    assert_eq!(last, poses(&recorded["/poses"]));
    let trajectory = fs::read_to_string(stage.path("mirador-out/trajectory.tum")).unwrap();
    let lines: Vec<&str> = trajectory.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!(last.len(), lines.len());
    for (pose, line) in last.iter().zip(lines) {
        let numbers: Vec<f64> = line.split(' ').map(|n| n.parse().unwrap()).collect();
        let position = pose.position.unwrap();
        let off = [(position.x, 1), (position.y, 2), (position.z, 3)].map(|(p, k)| (p - numbers[k]).abs());
        assert!(off.iter().all(|d| *d < 1e-5), "{position:?} is not {line}");
    }
    let grid = |drawings: &[Vec<u8>]| decode::<Grid>(drawings.last().unwrap()).data;
    assert_eq!(grid(&seen["/map"]), grid(&recorded["/map"]));
    let plan: SceneUpdate = decode(seen["/candidates"].last().unwrap());
    let terms: Vec<&str> = plan.entities[0].metadata.iter().map(|pair| pair.key.as_str()).collect();
    for term in ["u utility", "A information", "Q quality", "O zones", "C cost"] {
        assert!(terms.contains(&term), "{term} in {terms:?}");
    }
}

#[test]
fn a_port_that_is_taken_is_said_and_the_run_goes_on() {
    let stage = Stage::new();
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = other.local_addr().unwrap().port();
    let child = live(&stage, port, &[]);
    let said = said(&stage, "taken by another program");
    assert!(said.contains(&port.to_string()), "{said}");
    let finished = finish(child);
    assert!(finished.status.success(), "{}\n{}", finished.stdout, finished.stderr);
    let log = fs::read_to_string(stage.path("mirador-out/logs/gateway.log")).unwrap();
    assert!(log.contains("taken by another program") && log.contains("gateway.port"), "{log}");
    stage.assert_nothing_left();
}

#[test]
fn the_run_of_the_page_on_viewers() {
    let stage = Stage::new();
    support::page::run(&stage, "viewers.md", &[]);
    let recorded = recorded(&stage.path("my-run"));
    for channel in mirador_viewers::CHANNELS {
        assert!(recorded.contains_key(channel.topic) || channel.topic == "/log", "{} is empty", channel.topic);
    }
}
