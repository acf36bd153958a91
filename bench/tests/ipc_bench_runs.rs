//! The message benchmark between two real processes over real shared memory, small. No timing is judged.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

use std::time::Duration;

use mirador_bench::ipc::{BenchError, IpcOptions, Payload, Wake, run};
use mirador_ipc_schema::{Domain, StopSignal};
use serde_json::json;

const MESSAGES: u64 = 20;
const SMALL: usize = 64;
const LARGE: usize = 16 * 1000;

/// A few messages in the domain `name-PID`.
fn options(name: &str) -> IpcOptions {
    IpcOptions {
        payloads: [SMALL, LARGE].map(|bytes| Payload { bytes, messages: MESSAGES, written_before: 0 }).to_vec(),
        wakes: vec![Wake::Event, Wake::Poll],
        loaded: vec![false],
        subscribers: vec![1],
        copies: true,
        pace: Duration::from_micros(300),
        warm_up: 30,
        domain: Some(format!("{name}-{}", std::process::id())),
        peer_command: vec![env!("CARGO_BIN_EXE_mirador-bench-ipc").into(), "peer".into()],
        stop: StopSignal::default(),
    }
}

/// The domain that [`options`] names.
fn domain(options: &IpcOptions) -> Domain {
    let name = options.domain.as_deref().unwrap_or_default();
    Domain::new(name).unwrap_or_else(|error| panic!("{error}"))
}

fn assert_nothing_is_left(options: &IpcOptions) {
    let domain = domain(options);
    assert_eq!(domain.segments(), Vec::<std::path::PathBuf>::new());
    assert!(!domain.root().exists(), "{} is left", domain.root().display());
}

#[test]
fn every_case_has_its_rows_and_no_message_is_lost() {
    let options = options("t-rows");
    let report = run(&options).unwrap();
    assert_nothing_is_left(&options);

    let expected: Vec<(&str, &str)> = ["mirador", "iceoryx2"]
        .into_iter()
        .flat_map(|transport| [(transport, "event"), (transport, "poll")])
        .chain([("unix_socket", "event"), ("pipe", "event")])
        .collect();
    for bytes in [SMALL, LARGE] {
        for (transport, wake) in &expected {
            for name in ["hop", "payload_write", "send_call"] {
                let params = [
                    ("transport", json!(transport)),
                    ("wake", json!(wake)),
                    ("payload_bytes", json!(bytes)),
                    ("subscribers", json!(1)),
                ];
                let rows = report.find(name, &params);
                assert_eq!(rows.len(), 1, "{name} {transport} {wake} {bytes}");
                let row = rows[0];
                let s = &row.summary;
                // A message that was lost or came out of turn would have ended the run.
                assert_eq!(s.n as u64, MESSAGES);
                assert_eq!(row.unit, "us");
                assert!(s.p50 <= s.p90 && s.p90 <= s.p99 && s.p99 <= s.max, "{s:?}");
                assert!(s.max > 0.0 && s.max < 20e6, "{s:?}");
            }
        }
        for wake in ["event", "poll"] {
            let hop = |transport| {
                let params = [("transport", json!(transport)), ("wake", json!(wake)), ("payload_bytes", json!(bytes))];
                report.find("hop", &params)[0].summary.p50
            };
            let params = [("wake", json!(wake)), ("payload_bytes", json!(bytes))];
            let ratio = report.find("hop_ratio", &params)[0].summary.p50;
            assert_eq!(ratio, hop("mirador") / hop("iceoryx2"));
        }
    }
    // Waking up with events only, transport always, both in place only.
    for name in ["wake_up", "transport"] {
        for transport in ["mirador", "iceoryx2"] {
            let rows = report.find(name, &[("transport", json!(transport)), ("wake", json!("event"))]);
            assert!(rows.len() == 2 && rows.iter().all(|row| row.summary.n as u64 == MESSAGES), "{name} {transport}");
        }
    }
    assert!(report.find("wake_up", &[("wake", json!("poll"))]).is_empty());
    assert_eq!(report.rows.len(), 2 * (3 * expected.len() + 2 + 2 + 4));
    assert!(report.machine.cores >= 1);
}

#[test]
fn a_second_process_that_fails_is_reported_and_leaves_nothing() {
    for command in
        [&["false"][..], &["/no/such/program"], &[env!("CARGO_BIN_EXE_mirador-bench-ipc"), "peer", "rubbish"]]
    {
        let options =
            IpcOptions { peer_command: command.iter().map(ToString::to_string).collect(), ..options("t-fail") };
        let error = run(&options).unwrap_err();
        assert!(matches!(error, BenchError::Peer { .. }), "{error}");
        assert!(error.to_string().contains(command[0]), "{error}");
        assert_nothing_is_left(&options);
    }
}

#[test]
fn a_run_that_is_stopped_leaves_nothing() {
    let options = options("t-stop");
    options.stop.set();
    let error = run(&options).unwrap_err();
    assert!(matches!(error, BenchError::Interrupted), "{error}");
    assert_nothing_is_left(&options);
}

#[test]
fn the_domain_of_another_graph_is_neither_used_nor_removed() {
    let options = options("t-used");
    let domain = domain(&options);
    domain.config().unwrap();
    let error = run(&options).unwrap_err();
    assert!(matches!(error, BenchError::DomainInUse { .. }), "{error}");
    assert!(domain.root().is_dir());
    domain.remove_all().unwrap();
}

#[test]
fn several_subscribers_each_have_every_message() {
    let options = IpcOptions { subscribers: vec![3], ..options("t-many") };
    let report = run(&options).unwrap();
    assert_nothing_is_left(&options);
    for transport in ["mirador", "iceoryx2", "unix_socket", "pipe"] {
        let of = |name: &str| {
            let is_wanted = |row: &&mirador_bench::Row| {
                row.name == name && row.params["transport"] == transport && row.params["wake"] == "event"
            };
            report.rows.iter().filter(is_wanted).map(|row| row.summary.n as u64).collect::<Vec<_>>()
        };
        assert_eq!((of("hop"), of("hop_last")), (vec![3 * MESSAGES; 2], vec![MESSAGES; 2]), "{transport}");
    }
}
