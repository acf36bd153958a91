use std::collections::BTreeMap;

use super::*;
use crate::outputs::{Latencies, Usage};

fn work() -> WorkQuantiles {
    let of = |ns: &[u64]| Latencies::of(ns.iter().copied()).quantiles();
    WorkQuantiles {
        service: "analysis".into(),
        waiting: of(&[]),
        wake_up: of(&[30_000, 45_000]),
        taking: of(&[2_000, 3_000]),
        computing: of(&[5_000_000, 6_000_000]),
    }
}

fn snapshot() -> Snapshot {
    Snapshot {
        domain: "mirador".into(),
        supervisor_pid: Some(10),
        run: Run { state: "running", lockstep: Some(true), scans_done: 3, scans_expected: Some(12), scans_failed: 0 },
        services: vec![
            Service {
                service: "alignment".into(),
                pid: 11,
                state: "running",
                restarts: 1,
                finished_scans: 3,
                cpu_percent: Some(99.96),
                resident_bytes: 123_456_789,
                faults_per_second: Some(3.0),
                switches_per_second: Some(45.67),
                usage: Usage::default(),
                messages_in_per_second: Some(20.04),
                messages_out_per_second: Some(21.0),
                lost_messages: 2,
                undelivered_messages: 0,
                copied_payload_bytes: 1_234_567,
                last_work_ms: 41.26,
                heard_ms_ago: Some(20.0),
                message: "waiting\x1b[2J\nfor the target".into(),
            },
            Service {
                service: "foreign".into(),
                pid: 4_194_304,
                state: "unheard",
                restarts: 0,
                finished_scans: 0,
                cpu_percent: None,
                resident_bytes: 0,
                faults_per_second: None,
                switches_per_second: None,
                usage: Usage::default(),
                messages_in_per_second: None,
                messages_out_per_second: None,
                lost_messages: 0,
                undelivered_messages: 0,
                copied_payload_bytes: 0,
                last_work_ms: 0.0,
                heard_ms_ago: None,
                message: String::new(),
            },
        ],
        stages: vec![Stage {
            stage: "end_to_end",
            last_ms: 12.34,
            p50_ms: 11.0,
            p90_ms: 12.0,
            p99_ms: 12.34,
            p99_9_ms: 12.34,
            max_ms: 12.34,
            scans: 3,
        }],
        work: BTreeMap::from([("surface".to_owned(), work())]),
        provenance: "measured",
        decision: Some(Decision {
            scan: 2,
            decision: "go",
            reason_code: "best_utility".into(),
            reason: "candidate 4".into(),
            strategy: "weighted".into(),
            candidates: 7,
            path_length_m: 3.21,
            end_to_end_ms: 12.34,
        }),
        registration: None,
        notes: vec!["not shown: clock".into()],
    }
}

#[test]
fn a_graph_is_a_table_that_can_be_read() {
    let expected = "\
domain mirador | supervisor 10 | running | lockstep | scans 3 of 12

service        pid  state    restarts  scans  cpu %  memory MB  faults/s  switches/s  in/s  out/s  lost  copied  work ms  message
alignment       11  running         1      3  100.0      123.5       3.0        45.7  20.0   21.0     2  1.2 MB     41.3  waiting [2J for the target
foreign    4194304  unheard         -      -      -          -         -           -     -      -     -       -        -

stage       last ms  p50 ms   p90   p99  p99.9   max  scans
end to end     12.3    11.0  12.0  12.3   12.3  12.3      3

work     service   waiting ms  p99  wake-up ms    p99  taking ms    p99  computing ms    p99  times
surface  analysis           -    -       0.030  0.045      0.002  0.003         5.000  6.000      2

decision  scan 2: go (best_utility) candidate 4 | 7 candidates, path 3.2 m, 12.3 ms, strategy weighted
note      not shown: clock
";
    assert_eq!(render(&snapshot()), expected);
}

#[test]
fn a_graph_that_was_not_heard_is_said_to_be_so() {
    let mut empty = snapshot();
    empty.services.clear();
    empty.stages.clear();
    empty.decision = None;
    empty.run.scans_expected = None;
    let text = render(&empty);
    assert!(text.contains("no service has been heard") && text.contains("| scans 3\n"), "{text}");
}

#[test]
fn how_an_external_registration_does_is_a_line_of_its_own() {
    let mut asked = snapshot();
    let mut status = mirador_ipc_schema::messages::RegistrationStatus { questions: 4, ..Default::default() };
    (status.answered, status.fallbacks, status.fallback) = (3, 1, mirador_ipc_schema::text::pack("gicp"));
    status.faults[mirador_ipc_schema::messages::REGISTRATION_NOT_RIGID] = 1;
    (status.total_answer_ns, status.max_answer_ns) = (6_000_000, 4_000_000);
    status.last_fault = mirador_ipc_schema::text::pack("its pose is not a rigid motion");
    asked.registration = Some(crate::outputs::RegistrationTotals::default().plus(&status));
    let line = "external registration: 3 of 4 answered in 2.0 ms, 4.0 ms at most; 1 by gicp: 1 not rigid; last: its pose is \
                not a rigid motion\n";
    assert!(render(&asked).contains(line), "{}", render(&asked));
}

#[test]
fn what_was_not_delivered_is_said_beside_the_message() {
    let mut loud = snapshot();
    loud.services[0].undelivered_messages = 4;
    assert!(render(&loud).contains("4 undelivered; waiting"));
}

#[test]
fn bytes_are_short() {
    let words: Vec<String> = [0, 999, 1_000, 1_500_000, 2_000_000_000].into_iter().map(bytes).collect();
    assert_eq!(words, ["0 B", "999 B", "1.0 kB", "1.5 MB", "2.0 GB"]);
}

#[test]
fn the_keys_of_json_stay_as_they_are() {
    let json: serde_json::Value = serde_json::to_value(snapshot()).unwrap();
    let keys = |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>().join(" ");
    // In the order of the alphabet, whatever map serde_json was built with.
    let sorted = |value: &serde_json::Value| {
        let mut words: Vec<String> = keys(value).split(' ').map(str::to_owned).collect();
        words.sort();
        words.join(" ")
    };
    assert_eq!(sorted(&json), "decision domain notes provenance registration run services stages supervisor_pid work");
    assert_eq!(sorted(&json["run"]), "lockstep scans_done scans_expected scans_failed state");
    assert_eq!(
        sorted(&json["services"][0]),
        "copied_payload_bytes cpu_ns cpu_percent faults_per_second finished_scans heard_ms_ago involuntary_switches \
         last_work_ms lost_messages major_faults message messages_in_per_second messages_out_per_second minor_faults pid \
         resident_bytes restarts service state switches_per_second undelivered_messages voluntary_switches"
    );
    assert_eq!(sorted(&json["stages"][0]), "last_ms max_ms p50_ms p90_ms p99_9_ms p99_ms scans stage");
    assert_eq!(
        sorted(&json["decision"]),
        "candidates decision end_to_end_ms path_length_m reason reason_code scan strategy"
    );
    assert!(json["services"][1]["cpu_percent"].is_null(), "what is not known is null");
}
