//! `trace.json`: the work of every process as Chrome trace events, for ui.perfetto.dev or chrome://tracing.
//!
//! Format: "Trace Event Format" of the Chromium project, JSON object form: complete events (X), flows (s, f) and names (M);
//! times in microseconds.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::run_data::RunData;
use super::scan_path::{FEEDS, ScanPath};
use super::work::ServiceWork;

/// All work of the scans from number `first` on.
#[must_use]
pub fn chrome_trace(data: &RunData, first: u32) -> Value {
    let numbers = data.scans.iter().map(super::run_data::ScanRecord::number).filter(|scan| *scan >= first);
    let paths: Vec<ScanPath<'_>> = numbers.filter_map(|scan| ScanPath::of(data, scan)).collect();
    let zero = paths.iter().flat_map(|path| &path.works).map(|work| woken_from(work)).min().unwrap_or(0);
    let clock = Clock(zero);
    let mut events = names(&paths);
    for path in &paths {
        for (work, is_critical) in path.works.iter().zip(&path.is_critical) {
            events.extend(delays(work, &clock));
            events.push(work_event(work, *is_critical, &clock));
        }
        events.extend(flows(path, &clock));
    }
    json!({"traceEvents": events, "displayTimeUnit": "ms", "otherData": {"clock": "CLOCK_MONOTONIC", "zero_ns": zero}})
}

/// When a thread began to be woken for a work [ns]: with that its first event begins.
fn woken_from(work: &ServiceWork) -> u64 {
    let delay = work.span.delay();
    work.span.began_ns.saturating_sub(delay.taking).saturating_sub(delay.wake_up)
}

/// Times from the first event on.
struct Clock(u64);

impl Clock {
    fn us(&self, ns: u64) -> f64 {
        ns.saturating_sub(self.0) as f64 / 1e3
    }
}

/// Names of the processes and threads, processes in the order of the data flow.
fn names(paths: &[ScanPath<'_>]) -> Vec<Value> {
    let mut processes: BTreeMap<u32, (&str, usize)> = BTreeMap::new();
    let mut threads: BTreeMap<(u32, u32), &str> = BTreeMap::new();
    for work in paths.iter().flat_map(|path| &path.works) {
        let place = processes.len();
        processes.entry(work.pid).or_insert((&work.service, place));
        threads.insert((work.pid, work.span.thread), if work.span.thread == 0 { "main" } else { "intake" });
    }
    let process = processes.iter().flat_map(|(pid, (service, place))| {
        [
            json!({"ph": "M", "name": "process_name", "pid": pid, "args": {"name": service}}),
            json!({"ph": "M", "name": "process_sort_index", "pid": pid, "args": {"sort_index": place}}),
        ]
    });
    let thread = threads.iter().map(
        |((pid, tid), name)| json!({"ph": "M", "name": "thread_name", "pid": pid, "tid": tid, "args": {"name": name}}),
    );
    process.chain(thread).collect()
}

fn complete(work: &ServiceWork, name: &str, category: &str, [from, to]: [u64; 2], clock: &Clock, args: Value) -> Value {
    json!({"ph": "X", "name": name, "cat": category, "pid": work.pid, "tid": work.span.thread, "ts": clock.us(from),
           "dur": to.saturating_sub(from) as f64 / 1e3, "args": args})
}

fn work_event(work: &ServiceWork, is_critical: bool, clock: &Clock) -> Value {
    let (span, delay) = (&work.span, work.span.delay());
    let us = |ns: u64| ns as f64 / 1e3;
    let args = json!({"scan": span.scan, "critical_path": is_critical, "waiting_us": us(delay.waiting),
                      "wake_up_us": us(delay.wake_up), "taking_us": us(delay.taking)});
    let category = if is_critical { "work,critical" } else { "work" };
    complete(work, work.stage(), category, [span.began_ns, span.ended_ns], clock, args)
}

/// Waking up and taking, in which the thread does nothing else. What waits for a busy thread is told with the work.
fn delays(work: &ServiceWork, clock: &Clock) -> Vec<Value> {
    let (span, delay) = (&work.span, work.span.delay());
    let args = json!({"scan": span.scan, "before": work.stage()});
    let part = |name, length: u64, from: u64| {
        (length > 0).then(|| complete(work, name, "delay", [from, from + length], clock, args.clone()))
    };
    let woke = span.began_ns.saturating_sub(delay.taking);
    let wake_up = part("wake-up", delay.wake_up, woken_from(work));
    wake_up.into_iter().chain(part("taking", delay.taking, woke)).collect()
}

/// Arrows from what made something to what took it.
fn flows(path: &ScanPath<'_>, clock: &Clock) -> Vec<Value> {
    let mut events = Vec::new();
    for (number, (from, to)) in FEEDS.iter().enumerate() {
        let (Some(from), Some(to)) = (path.work(from), path.work(to)) else { continue };
        if to.span.began_ns < from.span.ended_ns {
            continue;
        }
        let id = u64::from(path.scan) * FEEDS.len() as u64 + number as u64;
        let end = |ph: &str, work: &ServiceWork, ns: u64| {
            json!({"ph": ph, "bp": "e", "id": id, "name": "feeds", "cat": "flow", "pid": work.pid, "tid": work.span.thread,
                   "ts": clock.us(ns)})
        };
        // An arrow belongs to the work that its time lies in.
        events.push(end("s", from, from.span.ended_ns.saturating_sub(1)));
        events.push(end("f", to, to.span.began_ns));
    }
    events
}

#[cfg(test)]
mod tests {
    use super::super::scan_path::tests::data;
    use super::*;

    fn events(first: u32) -> Vec<Value> {
        chrome_trace(&data(), first)["traceEvents"].as_array().unwrap().clone()
    }

    #[test]
    fn every_work_is_an_event_with_process_time_and_whether_it_is_critical() {
        let events = events(0);
        let of = |category: &str| {
            let is = |event: &&Value| event["cat"].as_str().is_some_and(|cat| cat.starts_with(category));
            events.iter().filter(is).collect::<Vec<_>>()
        };
        assert_eq!(of("work").len(), 18);
        assert_eq!(of("work,critical").len(), 11);
        let surface = of("work").into_iter().find(|event| event["name"] == "surface").unwrap();
        // From the beginning of the first scan, at 10 ms.
        assert_eq!((surface["ts"].as_f64(), surface["dur"].as_f64()), (Some(91_000.0), Some(29_000.0)));
        assert_eq!((&surface["args"]["critical_path"], &surface["args"]["wake_up_us"]), (&json!(false), &json!(990.0)));
        // What is asleep does not work: delays end where their work begins.
        let taking =
            of("delay").into_iter().find(|e| e["name"] == "taking" && e["args"]["before"] == "surface").unwrap();
        assert_eq!(taking["ts"].as_f64().unwrap() + taking["dur"].as_f64().unwrap(), 91_000.0);
    }

    #[test]
    fn the_events_of_a_thread_follow_each_other_also_where_all_begins_with_a_wake_up() {
        let mut data = data();
        // Without the work of acquisition the first thing is that somebody is woken. In the second scan of these data the thread
        // that scores is told to sleep while it still meshes, which no real one is.
        data.work.spans.retain(|work| work.service != "acquisition" && work.span.scan == 0);
        let events = chrome_trace(&data, 0)["traceEvents"].as_array().unwrap().clone();
        let mut slices: BTreeMap<(u64, u64), Vec<[f64; 2]>> = BTreeMap::new();
        for event in events.iter().filter(|event| event["ph"] == "X") {
            let number = |key: &str| event[key].as_u64().unwrap();
            let (begin, length) = (event["ts"].as_f64().unwrap(), event["dur"].as_f64().unwrap());
            slices.entry((number("pid"), number("tid"))).or_default().push([begin, begin + length]);
        }
        assert!(slices.values().map(Vec::len).sum::<usize>() >= 8);
        for slices in slices.values_mut() {
            slices.sort_by(|a, b| a[0].total_cmp(&b[0]));
            assert!(slices.windows(2).all(|pair| pair[1][0] >= pair[0][1] - 1e-6), "{slices:?}");
        }
    }

    #[test]
    fn processes_are_named_and_arrows_have_two_ends() {
        let events = events(0);
        let names: Vec<&str> = events
            .iter()
            .filter(|event| event["name"] == "process_name")
            .filter_map(|event| event["args"]["name"].as_str())
            .collect();
        for service in ["acquisition", "alignment", "analysis", "planning"] {
            assert!(names.contains(&service), "{names:?}");
        }
        let ends = |ph: &str| {
            let mut ids: Vec<u64> = events.iter().filter(|e| e["ph"] == ph).filter_map(|e| e["id"].as_u64()).collect();
            ids.sort_unstable();
            ids
        };
        assert!(!ends("s").is_empty());
        assert_eq!(ends("s"), ends("f"));
    }

    #[test]
    fn scans_before_the_first_are_left_out_and_no_work_is_no_events() {
        let all = events(1);
        assert!(all.iter().filter(|e| e["ph"] == "X").all(|e| e["args"]["scan"] == 1));
        assert_eq!(chrome_trace(&RunData::default(), 0)["traceEvents"], json!([]));
    }
}
