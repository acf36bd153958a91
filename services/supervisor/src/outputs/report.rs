//! `report.html`: one page that needs nothing beside it.

use base64::Engine;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use mirador_core::simulation::ModelDistance;
use mirador_ipc_schema::messages::DECISION_STOP;
use mirador_ipc_schema::text;

use super::facts::RunFacts;
use super::latency::STAGES;
use super::run_data::{RunData, ScanRecord};
use super::summary::Summary;
use super::work::PARTS;
use super::{OutputError, plots, progress_plot, scan_path, scan_picture};

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:960px;margin:2em auto;padding:0 1em}\
h1{font-size:1.6em;margin-bottom:.2em}h2{font-size:1.15em;margin-top:2em;border-bottom:1px solid #ddd}\
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums;font-size:.92em}\
th,td{padding:.25em .6em;text-align:right;border-bottom:1px solid #eee;vertical-align:top}\
th{background:#f6f6f6;font-weight:600}td.t,th.t{text-align:left}tr.bad td{color:#b3261e}\
img,svg{max-width:100%;height:auto}pre{background:#f6f6f6;padding:1em;overflow:auto;font-size:.85em}\
.note{color:#666}.one{white-space:nowrap}.wide{overflow-x:auto}";

/// Renders the report.
pub(super) fn render(
    data: &RunData,
    facts: &RunFacts,
    summary: &Summary,
    map_png: &[u8],
) -> Result<String, OutputError> {
    let map = format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(map_png));
    let curves = progress_plot::curves(data)?;
    let (latency_plot, top_view) = (plots::latency(data)?, plots::top_view(data)?);
    let one_scan = scan_path::typical(data).and_then(|path| Some((path.scan, scan_picture::picture(&path)?)));
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (facts.title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (facts.title) }
                (ending(summary))
                (figures(summary))
                h2 { "Map" }
                img src=(map) alt="Navigability and quality of the map, seen from above";
                p.note { "Grey is unknown. Blue: where scans were taken. Purple: candidates of the last plan, magenta the chosen one." }
                h2 { "Trajectory" }
                (PreEscaped(top_view))
                @if let Some(curves) = &curves {
                    h2 { "Progress" }
                    (PreEscaped(curves))
                }
                h2 { "Latency" }
                (latency_table(summary))
                (PreEscaped(latency_plot))
                @if !summary.work_ms.is_empty() {
                    h2 { "Where the time goes" }
                    (work_table(data, summary))
                }
                @if let Some((scan, picture)) = &one_scan {
                    h2 { "Scan " (scan) ", from its last beam to its plan" }
                    p.note {
                        "The scan whose plan took the middle time. All scans are in " code { "trace.json" } ", for ui.perfetto.dev "
                        "or chrome://tracing."
                    }
                    (picture)
                }
                h2 { "Alignment" }
                (alignment_table(data))
                h2 { "Decisions" }
                (decision_table(data))
                h2 { "Services" }
                (service_table(facts))
                h2 { "Configuration" }
                details { summary { "The configuration as used" } pre { (facts.config) } }
            }
        }
    };
    Ok(page.into_string())
}

fn ending(summary: &Summary) -> Markup {
    html! {
        p {
            @match (&summary.stop_reason, &summary.stop_reason_text) {
                (Some(code), Some(words)) => { "Ended: " (words) " (" code { (code) } ")." },
                _ => { "The recording does not say why the run ended." },
            }
            @if let (Some(code), Some(words)) = (&summary.last_decision, &summary.last_decision_text) {
                " The last decision: " (words) " (" code { (code) } ")."
            }
            @if !summary.recording_complete { " The recording was cut off; what is shown is what was saved of it." }
        }
    }
}

fn figures(summary: &Summary) -> Markup {
    let share = |value: Option<f64>| value.map_or("unknown".to_owned(), |v| format!("{:.1} %", 100.0 * v));
    let mut rows = vec![
        ("Scans", format!("{} ({} aligned, {} not)", summary.scans, summary.aligned, summary.unaligned)),
        ("Points", grouped(summary.points)),
        ("Distance", distance(summary)),
        ("Coverage", share(summary.coverage)),
        ("Mean quality", share(summary.quality)),
    ];
    rows.push(match summary.errors {
        Some(e) => (
            "Error against the truth",
            format!("{:.4} m, {:.3}° (RMSE of {} poses, at most {:.4} m)", e.ate_rmse_m, e.ate_rmse_deg, e.n, e.max_m),
        ),
        None => ("Error against the truth", "no truth".to_owned()),
    });
    if let Some(model) = summary.model_error {
        let ModelDistance { points, median_m, p95_m } = model;
        rows.push((
            "Model from the true surfaces",
            format!(
                "{:.1} mm (median of {} points, 95 of 100 below {:.0} mm)",
                1e3 * median_m,
                grouped(points as u64),
                1e3 * p95_m
            ),
        ));
    }
    rows.push(("Duration", format!("{:.1} s", summary.wall_time_s)));
    rows.push(("Restarts, messages lost", format!("{}, {}", summary.restarts, summary.lost_messages)));
    rows.push(("Payload bytes copied", grouped(summary.copied_payload_bytes)));
    if summary.mission_s.is_some() {
        rows.push((
            "Targets given up",
            if summary.given_up.is_empty() { "none".into() } else { summary.given_up.join("; ") },
        ));
    }
    html! { table { @for (name, value) in &rows { tr { th.t { (name) } td.t { (value) } } } } }
}

fn distance(summary: &Summary) -> String {
    match summary.mission_s {
        Some(seconds) => format!(
            "{:.2} m driven in {:.0} min {:02.0} s",
            summary.distance_m,
            (seconds / 60.0).floor(),
            seconds % 60.0
        ),
        None => format!("{:.2} m", summary.distance_m),
    }
}

fn latency_table(summary: &Summary) -> Markup {
    html! {
        table {
            tr {
                th.t { "Stage [ms]" } th { "p50" } th { "p90" } th { "p99" } th { "p99.9" } th { "max" } th { "n" }
            }
            @for stage in &STAGES {
                @let q = summary.latency_ms.get(stage.name).copied().unwrap_or_default();
                tr {
                    td.t { (stage.name.replace('_', " ")) }
                    @for value in [q.p50, q.p90, q.p99, q.p99_9, q.max] { td { (milliseconds(value)) } }
                    td { (q.n) }
                }
            }
        }
    }
}

/// The work of every service, in the order in which a scan passes it.
fn work_table(data: &RunData, summary: &Summary) -> Markup {
    let times = data.work.times();
    html! {
        div.wide { table {
            tr {
                th.t { "Work [ms]" } th.t { "Service" }
                @for part in PARTS { th { (part.replace('_', "-")) " p50" } th { "p99" } }
                th { "max" } th { "n" }
            }
            @for (service, stage, _) in &times {
                @if let Some(work) = summary.work_ms.get(*stage) {
                    tr {
                        td.t { (stage) } td.t { (service) }
                        @for q in [work.waiting, work.wake_up, work.taking, work.computing] {
                            td { (milliseconds(q.p50)) } td { (milliseconds(q.p99)) }
                        }
                        td { (milliseconds(work.computing.max)) }
                        td { (work.computing.n) }
                    }
                }
            }
        } }
        p.note {
            "Waiting: the thread was busy with something else. Wake-up: it slept. Taking: awake, until the work began. "
            "All times were measured in this run."
        }
    }
}

fn alignment_table(data: &RunData) -> Markup {
    html! {
        div.wide { table {
            tr {
                th { "Scan" } th.t { "Status" } th { "To" } th { "Overlap" } th { "Residual [mm]" } th { "Iterations" }
                th { "Points" } th.t { "Method" } th.t { "Reason" }
            }
            @for record in &data.scans { (alignment_row(record)) }
        } }
    }
}

fn alignment_row(record: &ScanRecord) -> Markup {
    let reason = record.reason();
    let target = record.alignment.map(|a| a.target_scan).filter(|t| *t != u32::MAX && record.status() != "first");
    html! {
        tr.bad[reason.is_some()] {
            td { (record.number()) }
            td.t { (record.status()) @if record.corrected.is_some() { ", corrected" } }
            td { @if let Some(target) = target { (target) } }
            @match &record.alignment {
                Some(a) => {
                    td { (format!("{:.3}", a.overlap)) }
                    td { (format!("{:.2}", 1e3 * a.residual_m)) }
                    td { (a.iterations) }
                    td { (grouped(u64::from(record.scan.returns))) }
                    td.t { (text::unpack(&a.method)) }
                },
                None => { td {} td {} td {} td { (grouped(u64::from(record.scan.returns))) } td {} },
            }
            td.t { (reason.unwrap_or_default()) }
        }
    }
}

fn decision_table(data: &RunData) -> Markup {
    html! {
        div.wide { table {
            tr {
                th { "Scan" } th.t { "Decision" } th { "A" } th { "Q" } th { "O" } th { "C" } th { "Utility" }
                th { "Path [m]" } th { "Known cells" } th.t { "Why" }
            }
            @for (record, (plan, chosen)) in data.scans.iter().filter_map(|s| Some((s, s.plan.as_ref()?))) {
                tr {
                    td { (record.number()) }
                    @match chosen {
                        Some(c) => {
                            td.t.one { (format!("go to ({:.2}, {:.2})", c.position[0], c.position[1])) }
                            @for value in [c.information, c.quality, c.zones, c.cost, c.utility] {
                                td { (format!("{value:.3}")) }
                            }
                        },
                        None => {
                            td.t { @if plan.decision == DECISION_STOP { "stop" } @else { "stay" } }
                            td {} td {} td {} td {} td {}
                        },
                    }
                    td { (format!("{:.2}", plan.path_length_m)) }
                    td { (plan.cells_known) }
                    td.t { (text::unpack(&plan.reason)) }
                }
            }
        } }
    }
}

fn service_table(facts: &RunFacts) -> Markup {
    html! {
        div.wide { table {
            tr {
                th.t { "Service" } th { "Restarts" } th { "Memory [MB]" } th { "CPU [s]" }
                th { "Faults, minor" } th { "major" } th { "Switches, voluntary" } th { "forced" } th { "Sent" } th { "Received" }
                th { "Lost" } th { "Undelivered" } th { "Copied [bytes]" }
            }
            @for s in &facts.services {
                tr.bad[s.lost_messages + s.undelivered_messages > 0] {
                    td.t { (s.name) }
                    td { (s.restarts) }
                    td { (format!("{:.1}", s.resident_bytes as f64 / 1e6)) }
                    @let used = s.usage;
                    td { (format!("{:.2}", used.cpu_ns as f64 / 1e9)) }
                    @for value in [used.minor_faults, used.major_faults, used.voluntary_switches, used.involuntary_switches] {
                        td { (grouped(value)) }
                    }
                    @for value in [s.sent_messages, s.received_messages, s.lost_messages, s.undelivered_messages, s.copied_payload_bytes] {
                        td { (grouped(value)) }
                    }
                }
            }
        } }
    }
}

fn milliseconds(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), |ms| format!("{ms:.2}"))
}

/// A number with thin spaces between its thousands.
fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::with_capacity(digits.len() * 2);
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_stand_apart() {
        assert_eq!(grouped(7), "7");
        assert_eq!(grouped(1_234_567), "1\u{202f}234\u{202f}567");
    }
}
