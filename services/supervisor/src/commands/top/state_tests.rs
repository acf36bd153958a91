use mirador_ipc_schema::messages::WorkSpan;

use super::*;

const MS: u64 = 1_000_000;

/// Reports a service at a time; the closure sets what matters.
fn report(state: &mut State, name: &str, at_ms: u64, incarnation: u32, set: impl FnOnce(&mut ServiceHealth)) {
    let header = Header { sent_ns: at_ms * MS, incarnation, ..Header::default() };
    let mut health =
        ServiceHealth { service: text::pack(name), pid: 100, state: SERVICE_RUNNING, ..ServiceHealth::default() };
    set(&mut health);
    state.take_health(&header, &health);
}

fn service(state: &State, at_ms: u64, name: &str) -> Service {
    let snapshot = state.snapshot(at_ms * MS, "test", &[]);
    snapshot.services.into_iter().find(|s| s.service == name).unwrap()
}

fn plan(scan: u64, scan_sent_ms: u64, sent_ms: u64) -> ViewPlanMeta {
    ViewPlanMeta {
        header: Header { id: scan, sent_ns: sent_ms * MS, ..Header::default() },
        scan_sent_ns: scan_sent_ms * MS,
        map_ns: 3 * MS,
        planning_ns: 4 * MS,
        decision: DECISION_GO,
        reason_code: text::pack("best_utility"),
        ..ViewPlanMeta::default()
    }
}

#[test]
fn rates_are_those_of_the_last_second() {
    let mut state = State::default();
    // A second at full load with 100 messages in, then a second at half load with 40 in and 20 out.
    for step in 0..=40_u64 {
        let (busy, calm) = (step.min(20), step.saturating_sub(20));
        report(&mut state, "analysis", 1000 + step * 50, 0, |h| {
            h.cpu_ns = busy * 50 * MS + calm * 25 * MS;
            h.received_messages = busy * 5 + calm * 2;
            h.sent_messages = calm;
        });
    }
    let row = service(&state, 3000, "analysis");
    assert!((row.cpu_percent.unwrap() - 50.0).abs() < 1e-9, "{row:?}");
    assert!((row.messages_in_per_second.unwrap() - 40.0).abs() < 1e-9, "{row:?}");
    assert!((row.messages_out_per_second.unwrap() - 20.0).abs() < 1e-9, "{row:?}");
}

#[test]
fn one_report_gives_no_rate() {
    let mut state = State::default();
    report(&mut state, "analysis", 1000, 0, |h| h.cpu_ns = 500 * MS);
    assert_eq!(service(&state, 1000, "analysis").cpu_percent, None);
}

#[test]
fn the_window_holds_about_a_second_however_long_it_runs() {
    let mut state = State::default();
    for step in 0..10_000_u64 {
        report(&mut state, "planning", step * 50, 0, |_| {});
    }
    assert_eq!(state.services["planning"].window.len(), 21);
}

#[test]
fn a_service_that_falls_silent_is_shown_so_and_has_no_rates() {
    let mut state = State::default();
    report(&mut state, "planning", 0, 0, |_| {});
    report(&mut state, "planning", 1000, 0, |h| h.cpu_ns = 100 * MS);
    let at = |ms| service(&state, ms, "planning");
    assert_eq!((at(1900).state, at(1900).cpu_percent.is_some()), ("running", true));
    assert_eq!((at(2001).state, at(2001).cpu_percent), ("silent", None));
    assert_eq!(at(6001).state, "gone");
}

#[test]
fn a_failure_is_told_before_the_silence_after_it() {
    let mut state = State::default();
    report(&mut state, "planning", 1000, 0, |h| {
        h.state = SERVICE_FAILED;
        h.message = text::pack("no map");
    });
    let row = service(&state, 3000, "planning");
    assert_eq!((row.state, row.message.as_str()), ("failed", "no map"));
}

#[test]
fn restarts_are_counted_by_incarnation_or_process_whichever_is_more() {
    let mut state = State::default();
    report(&mut state, "alignment", 1000, 2, |_| {});
    assert_eq!(service(&state, 1000, "alignment").restarts, 2, "those before the first look");
    report(&mut state, "alignment", 2000, 3, |h| h.pid = 101);
    assert_eq!(service(&state, 2000, "alignment").restarts, 3);
    // A foreign program that does not count its starts.
    for (at, pid) in [(1000, 7), (2000, 8), (3000, 9)] {
        report(&mut state, "foreign", at, 0, |h| h.pid = pid);
    }
    assert_eq!(service(&state, 3000, "foreign").restarts, 2);
}

#[test]
fn a_restart_never_gives_a_rate_across_two_processes() {
    let mut state = State::default();
    report(&mut state, "alignment", 1000, 0, |h| h.cpu_ns = 9_000 * MS);
    report(&mut state, "alignment", 1500, 1, |h| {
        h.pid = 101;
        h.cpu_ns = MS;
    });
    assert_eq!(service(&state, 1500, "alignment").cpu_percent, None);
    report(&mut state, "alignment", 2000, 1, |h| {
        h.pid = 101;
        h.cpu_ns = 251 * MS;
    });
    assert!((service(&state, 2000, "alignment").cpu_percent.unwrap() - 50.0).abs() < 1e-9);
}

#[test]
fn the_last_words_of_the_dead_do_not_replace_their_successor() {
    let mut state = State::default();
    report(&mut state, "alignment", 2000, 1, |h| h.pid = 101);
    report(&mut state, "alignment", 1900, 0, |h| h.pid = 100);
    let row = service(&state, 2000, "alignment");
    assert_eq!((row.pid, row.restarts), (101, 1));
}

#[test]
fn stages_have_the_last_latency_and_the_median() {
    let mut state = State::default();
    for (scan, end_to_end) in [(0, 30), (1, 10), (2, 20)] {
        state.take_plan(&plan(scan, 1000, 1000 + end_to_end), 5);
        state.take_alignment(&AlignmentMeta { prepare_ns: 2 * MS, align_ns: 5 * MS, ..AlignmentMeta::default() });
    }
    report(&mut state, "analysis", 1000, 0, |h| (h.finished_scans, h.last_work_ns) = (4, 99 * MS));
    report(&mut state, "analysis", 1050, 0, |h| (h.finished_scans, h.last_work_ns) = (5, 8 * MS));
    report(&mut state, "analysis", 1100, 0, |h| (h.finished_scans, h.last_work_ns) = (5, 8 * MS));
    let stages = state.snapshot(0, "test", &[]).stages;
    let rows: Vec<_> = stages.iter().map(|s| (s.stage, s.last_ms.round(), s.p50_ms.round(), s.scans)).collect();
    assert_eq!(
        rows,
        [
            ("alignment", 7.0, 7.0, 3),
            ("analysis", 8.0, 8.0, 1),
            ("map", 3.0, 3.0, 3),
            ("planning", 4.0, 4.0, 3),
            ("end_to_end", 20.0, 20.0, 3),
        ]
    );
}

#[test]
fn the_work_of_a_service_is_told_apart_and_told_once() {
    let mut state = State::default();
    let span = WorkSpan {
        stage: text::pack("surface"),
        input_ns: 10 * MS,
        asleep_ns: 5 * MS,
        woke_ns: 11 * MS,
        began_ns: 12 * MS,
        ended_ns: 20 * MS,
        ..WorkSpan::default()
    };
    report(&mut state, "analysis", 1000, 0, |h| (h.span_count, h.spans[0]) = (1, span));
    // A heartbeat tells of no work.
    report(&mut state, "analysis", 1050, 0, |h| h.spans[0] = span);
    let work = &state.snapshot(0, "test", &[]).work["surface"];
    assert_eq!((work.service.as_str(), work.computing.n), ("analysis", 1));
    let ms = [work.waiting, work.wake_up, work.taking, work.computing].map(|q| q.max);
    assert_eq!(ms, [Some(0.0), Some(1.0), Some(1.0), Some(8.0)]);
}

#[test]
fn faults_and_switches_are_rates_and_totals() {
    let mut state = State::default();
    for step in 0..=20_u64 {
        report(&mut state, "analysis", 1000 + step * 50, 0, |h| {
            (h.minor_faults, h.major_faults) = (step * 2, step);
            (h.voluntary_switches, h.involuntary_switches) = (step * 5, step * 5);
        });
    }
    let row = service(&state, 2000, "analysis");
    assert!((row.faults_per_second.unwrap() - 60.0).abs() < 1e-9, "{row:?}");
    assert!((row.switches_per_second.unwrap() - 200.0).abs() < 1e-9, "{row:?}");
    assert_eq!((row.usage.minor_faults, row.usage.involuntary_switches), (40, 100));
}

#[test]
fn progress_is_what_planning_has_done_or_everybody_without_it() {
    let mut state = State::default();
    assert_eq!(state.snapshot(0, "test", &[]).run.state, "unknown");
    report(&mut state, "acquisition", 1000, 0, |h| h.finished_scans = 9);
    report(&mut state, "alignment", 1000, 0, |h| h.finished_scans = 7);
    state.take_clock(&ClockMeta { scans_expected: 20, lockstep: 1, ..ClockMeta::default() });
    let run = state.snapshot(0, "test", &[]).run;
    assert_eq!((run.state, run.lockstep, run.scans_done, run.scans_expected), ("running", Some(true), 7, Some(20)));
    state.take_plan(&plan(5, 0, 10), 0);
    state.take_clock(&ClockMeta { state: CLOCK_ENDED, ..ClockMeta::default() });
    let run = state.snapshot(0, "test", &[]).run;
    assert_eq!((run.state, run.scans_done, run.scans_expected), ("ended", 6, None));
}

#[test]
fn services_stand_in_the_order_of_the_data_flow() {
    let mut state = State::default();
    for name in ["recorder", "zebra", "planning", "ant", "acquisition"] {
        report(&mut state, name, 1000, 0, |_| {});
    }
    let snapshot = state.snapshot(1000 * MS, "test", &[]);
    let names: Vec<&str> = snapshot.services.iter().map(|s| s.service.as_str()).collect();
    assert_eq!(names, ["acquisition", "planning", "recorder", "ant", "zebra"]);
}

#[test]
fn a_process_that_has_not_reported_is_listed_and_waited_for() {
    let mut state = State::default();
    report(&mut state, "planning", 1000, 0, |_| {});
    let peer = |name: &str, pid| Peer { name: name.into(), pid, alive: true };
    let mut peers = vec![peer("supervisor", 1), peer("planning", 100)];
    assert!(state.has_heard(&peers));
    peers.push(peer("foreign", 5));
    assert!(!state.has_heard(&peers));
    let snapshot = state.snapshot(1000 * MS, "test", &peers);
    assert_eq!(snapshot.supervisor_pid, Some(1));
    let rows: Vec<_> = snapshot.services.iter().map(|s| (s.service.as_str(), s.state)).collect();
    assert_eq!(rows, [("planning", "running"), ("foreign", "unheard")]);
}
