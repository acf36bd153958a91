//! A snapshot as a table for people.

use super::view::{Decision, Run, Service, Snapshot, Stage};
use crate::outputs::WorkQuantiles;

/// Shown where nothing is known.
const UNKNOWN: &str = "-";

/// The snapshot as aligned text.
pub(super) fn render(snapshot: &Snapshot) -> String {
    let mut out = headline(snapshot);
    out.push('\n');
    if snapshot.services.is_empty() {
        out.push_str("no service has been heard\n");
    } else {
        let rows: Vec<Vec<String>> = snapshot.services.iter().map(service_row).collect();
        out.push_str(&aligned(&SERVICE_COLUMNS, &rows));
    }
    if !snapshot.stages.is_empty() {
        let rows: Vec<Vec<String>> = snapshot.stages.iter().map(stage_row).collect();
        out.push('\n');
        out.push_str(&aligned(&STAGE_COLUMNS, &rows));
    }
    if !snapshot.work.is_empty() {
        let rows: Vec<Vec<String>> = snapshot.work.iter().map(work_row).collect();
        out.push('\n');
        out.push_str(&aligned(&WORK_COLUMNS, &rows));
    }
    if let Some(decision) = &snapshot.decision {
        out.push_str(&format!("\ndecision  {}\n", decision_line(decision)));
    }
    if let Some(registration) = &snapshot.registration {
        out.push_str(&format!("\n{}\n", printable(&registration.to_string())));
    }
    for note in &snapshot.notes {
        out.push_str(&format!("note      {}\n", printable(note)));
    }
    out
}

/// A column: its head, and whether its cells are words (to the left) or numbers (to the right).
struct Column(&'static str, Side);

#[derive(PartialEq)]
enum Side {
    Left,
    Right,
}
use Side::{Left, Right};

const SERVICE_COLUMNS: [Column; 15] = [
    Column("service", Left),
    Column("pid", Right),
    Column("state", Left),
    Column("restarts", Right),
    Column("scans", Right),
    Column("cpu %", Right),
    Column("memory MB", Right),
    Column("faults/s", Right),
    Column("switches/s", Right),
    Column("in/s", Right),
    Column("out/s", Right),
    Column("lost", Right),
    Column("copied", Right),
    Column("work ms", Right),
    Column("message", Left),
];

const STAGE_COLUMNS: [Column; 8] = [
    Column("stage", Left),
    Column("last ms", Right),
    Column("p50 ms", Right),
    Column("p90", Right),
    Column("p99", Right),
    Column("p99.9", Right),
    Column("max", Right),
    Column("scans", Right),
];

/// Medians tell how it usually is, 99th percentiles how bad it gets.
const WORK_COLUMNS: [Column; 11] = [
    Column("work", Left),
    Column("service", Left),
    Column("waiting ms", Right),
    Column("p99", Right),
    Column("wake-up ms", Right),
    Column("p99", Right),
    Column("taking ms", Right),
    Column("p99", Right),
    Column("computing ms", Right),
    Column("p99", Right),
    Column("times", Right),
];

fn headline(snapshot: &Snapshot) -> String {
    let Run { state, lockstep, scans_done, scans_expected, scans_failed } = &snapshot.run;
    let mut parts = vec![format!("domain {}", snapshot.domain)];
    parts.extend(snapshot.supervisor_pid.map(|pid| format!("supervisor {pid}")));
    parts.push((*state).to_owned());
    parts.extend(lockstep.map(|lockstep| if lockstep { "lockstep".into() } else { "timed".into() }));
    parts.push(match scans_expected {
        Some(expected) => format!("scans {scans_done} of {expected}"),
        None => format!("scans {scans_done}"),
    });
    if *scans_failed > 0 {
        parts.push(format!("unreadable {scans_failed}"));
    }
    parts.join(" | ") + "\n"
}

fn service_row(s: &Service) -> Vec<String> {
    // A process that has not reported has no figures, not zeros.
    let heard = |text: String| if s.heard_ms_ago.is_some() { text } else { UNKNOWN.to_owned() };
    vec![
        printable(&s.service),
        s.pid.to_string(),
        s.state.to_owned(),
        heard(s.restarts.to_string()),
        heard(s.finished_scans.to_string()),
        rate(s.cpu_percent),
        heard(format!("{:.1}", s.resident_bytes as f64 / 1e6)),
        rate(s.faults_per_second),
        rate(s.switches_per_second),
        rate(s.messages_in_per_second),
        rate(s.messages_out_per_second),
        heard(s.lost_messages.to_string()),
        heard(bytes(s.copied_payload_bytes)),
        heard(format!("{:.1}", s.last_work_ms)),
        message(s),
    ]
}

/// What the service says, and what it could not deliver: rare, so it has no column.
fn message(s: &Service) -> String {
    let said = printable(&s.message);
    match (s.undelivered_messages, said.is_empty()) {
        (0, _) => said,
        (n, true) => format!("{n} undelivered"),
        (n, false) => format!("{n} undelivered; {said}"),
    }
}

fn stage_row(s: &Stage) -> Vec<String> {
    let name = s.stage.replace('_', " ");
    let times = [s.last_ms, s.p50_ms, s.p90_ms, s.p99_ms, s.p99_9_ms, s.max_ms].map(|ms| format!("{ms:.1}"));
    [vec![name], times.to_vec(), vec![s.scans.to_string()]].concat()
}

fn work_row((stage, work): (&String, &WorkQuantiles)) -> Vec<String> {
    let ms = |value: Option<f64>| value.map_or_else(|| UNKNOWN.to_owned(), |ms| format!("{ms:.3}"));
    let parts = [work.waiting, work.wake_up, work.taking, work.computing].map(|q| [ms(q.p50), ms(q.p99)]);
    [vec![printable(stage), printable(&work.service)], parts.concat(), vec![work.computing.n.to_string()]].concat()
}

fn decision_line(d: &Decision) -> String {
    let mut line = format!("scan {}: {} ({})", d.scan, d.decision, printable(&d.reason_code));
    if !d.reason.is_empty() {
        line = format!("{line} {}", printable(&d.reason));
    }
    format!(
        "{line} | {} candidates, path {:.1} m, {:.1} ms, strategy {}",
        d.candidates,
        d.path_length_m,
        d.end_to_end_ms,
        printable(&d.strategy)
    )
}

fn rate(value: Option<f64>) -> String {
    value.map_or_else(|| UNKNOWN.to_owned(), |v| format!("{v:.1}"))
}

/// Bytes in the unit that keeps them short.
fn bytes(n: u64) -> String {
    match n {
        0..1_000 => format!("{n} B"),
        1_000..1_000_000 => format!("{:.1} kB", n as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.1} GB", n as f64 / 1e9),
    }
}

/// Texts come from other processes: whatever would move the cursor is shown as a blank.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// The columns, each as wide as its widest cell; without blanks at the end of a line.
fn aligned(columns: &[Column], rows: &[Vec<String>]) -> String {
    let width = |i: usize, head: &str| {
        let cells = rows.iter().filter_map(|row| row.get(i)).map(|cell| cell.chars().count());
        cells.chain([head.chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = columns.iter().enumerate().map(|(i, column)| width(i, column.0)).collect();
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded: Vec<String> = cells
            .zip(columns.iter().zip(&widths))
            .map(|(cell, (column, &width))| match column.1 {
                Left => format!("{cell:<width$}"),
                Right => format!("{cell:>width$}"),
            })
            .collect();
        padded.join("  ").trim_end().to_owned() + "\n"
    };
    let mut out = line(&mut columns.iter().map(|c| c.0));
    for row in rows {
        out.push_str(&line(&mut row.iter().map(String::as_str)));
    }
    out
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
