//! The comparison as one page that needs nothing beside it.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::plots::{COLOURS, share_within, success_over_distance};
use super::rows::{success_rate, summary};
use super::{AllPairs, Attempt, Entrant};
use crate::Summary;
use crate::registration::RegistrationBenchError;
use crate::report::number;

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1360px;margin:2em auto;padding:0 1em}\
h1{font-size:1.6em;margin-bottom:.2em}h2{font-size:1.15em;margin-top:2em;border-bottom:1px solid #ddd}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9em}\
th,td{padding:.25em .7em;text-align:right;border-bottom:1px solid #eee}\
th{background:#f6f6f6;font-weight:600;vertical-align:bottom}td.t,th.t{text-align:left}.note{color:#666;max-width:62em}\
.row{display:flex;flex-wrap:wrap;gap:6px}.row svg{max-width:100%;height:auto}.wide{overflow-x:auto}\
i{display:inline-block;width:1.1em;height:.7em;margin-right:.5em}td.best{font-weight:700;background:#eef7ee}\
tr.bad td{color:#b3261e}";

/// Renders the page.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn page(result: &AllPairs) -> Result<String, RegistrationBenchError> {
    let (machine, options) = (&result.report.machine, &result.options);
    let plots = [
        share_within(&result.entrants, "time", "from raw points to the pose [ms]", |a| Some(a.ms))?,
        share_within(&result.entrants, "translation error", "[m]", |a| a.translation_error_m)?,
        share_within(&result.entrants, "rotation error", "[deg]", |a| a.rotation_error_deg)?,
        success_over_distance(&result.entrants, options.max_distance_m)?,
    ];
    let title = format!("Registration on {}", result.name);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                @for line in &result.about { p.note { (line) } }
                p.note {
                    "A success is off by at most " (options.success_m) " m and " (options.success_deg) " degrees. Everything was "
                    "measured in this run, with " (options.threads) " threads: " (machine.cpu) ", " (machine.cores) " cores, "
                    (machine.os) ", commit " (machine.commit) "."
                }
                (table(&result.entrants))
                p.note { "Errors and iterations are medians, of successes and failures together; p90 is what one pair in ten exceeds." }
                div.row { @for plot in &plots { (PreEscaped(plot)) } }
                (failures(&result.entrants))
            }
        }
    };
    Ok(page.into_string())
}

fn figures(of: Option<Summary>) -> [String; 2] {
    of.map_or_else(|| ["–".into(), "–".into()], |s| [number(s.p50), number(s.p90)])
}

fn table(entrants: &[Entrant]) -> Markup {
    let best_rate = entrants.iter().map(|e| success_rate(&e.attempts)).fold(0.0, f64::max);
    let median = |e: &Entrant| summary(&e.attempts, |a| Some(a.ms)).map_or(f64::INFINITY, |s| s.p50);
    let fastest = entrants.iter().map(median).fold(f64::INFINITY, f64::min);
    html! {
        div.wide { table {
            tr {
                th.t { "Method" } th { "Success [%]" } th { "Time p50 [ms]" } th { "p90" } th { "p99" }
                th { "Translation error p50 [m]" } th { "p90" } th { "Rotation error p50 [deg]" } th { "p90" } th { "Iterations" }
                th { "Overlap" } th { "Without a pose" } th { "Pairs" }
            }
            @for (entrant, colour) in entrants.iter().zip(COLOURS.iter().cycle()) {
                @let attempts = &entrant.attempts;
                @let time = summary(attempts, |a| Some(a.ms));
                tr {
                    td.t {
                        i style=(format!("background:rgb({},{},{})", colour.0, colour.1, colour.2)) {}
                        (entrant.method)
                    }
                    td.best[success_rate(attempts) >= best_rate] { (format!("{:.1}", 100.0 * success_rate(attempts))) }
                    @match &time {
                        Some(t) => {
                            td.best[t.p50 <= fastest] { (number(t.p50)) } td { (number(t.p90)) } td { (number(t.p99)) }
                        },
                        None => { td {} td {} td {} },
                    }
                    @for figure in figures(summary(attempts, |a| a.translation_error_m)) { td { (figure) } }
                    @for figure in figures(summary(attempts, |a| a.rotation_error_deg)) { td { (figure) } }
                    td { (figures(summary(attempts, |a| a.iterations.map(f64::from)))[0]) }
                    td { (figures(summary(attempts, |a| a.overlap))[0]) }
                    td { (attempts.iter().filter(|a| a.translation_error_m.is_none()).count()) }
                    td { (attempts.len()) }
                }
            }
        } }
    }
}

/// The pairs that most methods fail on: what a user will want to look at.
fn failures(entrants: &[Entrant]) -> Markup {
    let pairs = entrants.first().map_or(&[][..], |entrant| &entrant.attempts);
    let failed_by = |k: usize| -> Vec<&str> {
        let failed = |e: &&Entrant| e.attempts.get(k).is_some_and(|a| !a.success);
        entrants.iter().filter(failed).map(|e| e.method.as_str()).collect()
    };
    let mut hardest: Vec<(&Attempt, Vec<&str>)> = pairs
        .iter()
        .enumerate()
        .map(|(k, pair)| (pair, failed_by(k)))
        .filter(|(_, failed)| !failed.is_empty())
        .collect();
    hardest.sort_by(|a, b| b.1.len().cmp(&a.1.len()).then(a.0.distance_m.total_cmp(&b.0.distance_m)));
    html! {
        @if !hardest.is_empty() {
            h2 { "Pairs that are failed on" }
            div.wide { table {
                tr { th { "Target" } th { "Source" } th { "Distance [m]" } th { "Failures" } th.t { "Methods" } }
                @for (pair, failed) in hardest.iter().take(20) {
                    tr.bad[failed.len() == entrants.len()] {
                        td { (pair.target) } td { (pair.source) } td { (format!("{:.2}", pair.distance_m)) } td { (failed.len()) }
                        td.t { (failed.join(", ")) }
                    }
                }
            } }
            @if hardest.len() > 20 { p.note { "The first 20 of " (hardest.len()) "; the others are in the JSON file." } }
        }
    }
}
