//! `mirador replan` beside a running graph.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::process::Stdio;

use mirador_ipc_schema::messages::ViewPlanMeta;
use mirador_ipc_schema::{text, topics};
use mirador_recorder::{RUN_FILE, RunReader};
use support::observer::Observer;
use support::{Stage, finish, signal, small_tour};

/// Between two scans of a graph in real time, the map it has is decided on again: by another strategy and other weights.
#[test]
fn a_running_graph_decides_again_on_the_map_it_has() {
    let stage = Stage::new();
    // The scans of a scene are half a minute apart, so this graph waits for its second one until it is stopped.
    let mut arguments = small_tour();
    arguments.extend(
        ["--set", "graph.lockstep=false", "--set", "acquisition.speed=1", "--out", "run", "--quiet"].map(String::from),
    );
    let graph = stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut observer = Observer::join(stage.domain());
    observer.until("planning has finished a scan", |seen| {
        seen.get("planning").is_some_and(|health| health.finished_scans >= 1)
    });
    drop(observer);

    let asked = stage.run(&["replan", "--strategy", "frontier", "--weights", "0.9,0.05,0.05,0.02"]);
    assert!(asked.status.success(), "{}\n{}", asked.stdout, asked.stderr);
    assert!(asked.stdout.contains("frontier") && asked.stdout.contains("0.9"), "{}", asked.stdout);
    let again = stage.run(&["replan"]);
    assert!(again.status.success() && again.stdout.contains("multi_criteria"), "{}\n{}", again.stdout, again.stderr);
    let wrong = stage.run(&["replan", "--strategy", "fronteer"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(wrong.stderr.contains("multi_criteria, coverage_tour"), "{}", wrong.stderr);

    signal(graph.id(), "INT");
    assert_eq!(finish(graph).status.code(), Some(130));
    stage.assert_nothing_left();
    // All three decisions are recorded, on one scan and one map.
    let mut plans: Vec<ViewPlanMeta> = Vec::new();
    let mut reader = RunReader::open(&stage.path("run").join(RUN_FILE)).unwrap();
    reader.for_each::<topics::ViewPlan>(|meta, _| plans.push(*meta)).unwrap();
    let strategies: Vec<_> = plans.iter().map(|plan| text::unpack(&plan.strategy)).collect();
    assert_eq!(strategies, ["multi_criteria", "frontier", "multi_criteria"]);
    assert!(plans.iter().all(|plan| plan.header.scan() == 0 && plan.map_revision == plans[0].map_revision));
    assert_eq!(plans[1].weights, [0.9, 0.05, 0.05, 0.02]);
    assert_eq!((plans[2].weights, plans[2].chosen), (plans[0].weights, plans[0].chosen));
}

#[test]
fn without_a_graph_replan_says_so() {
    let stage = Stage::new();
    let finished = stage.run(&["replan"]);
    assert_eq!(finished.status.code(), Some(1));
    assert!(finished.stderr.contains("no graph is running"), "{}", finished.stderr);
}
