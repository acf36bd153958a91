//! The way of one scan through the processes as a picture: who did what when, and what the plan waited for.

use maud::{Markup, html};

use super::scan_path::ScanPath;
use super::work::ServiceWork;

const WIDTH: f64 = 920.0;
const LABELS: f64 = 150.0;
const LANE: f64 = 36.0;
const BAR: f64 = 20.0;
const TOP: f64 = 14.0;
/// Room for a letter of a label [pixels].
const LETTER: f64 = 6.6;
const CRITICAL: &str = "#c81e3c";
const WAKE_UP: &str = "#f2b134";
const TAKING: &str = "#e2761b";

/// Colour of a kind of work.
fn colour(stage: &str) -> &'static str {
    match stage {
        "scan" => "#9aa5b1",
        "prepare" => "#9467bd",
        "align" => "#7a4fa3",
        "surface" => "#1f77b4",
        "scores" => "#17879b",
        "map" => "#2ca02c",
        "plan" => "#1b7a1b",
        _ => "#c3cad2",
    }
}

/// What is shown: a moment before the scan is there to a moment after its plan is.
struct Window {
    zero: u64,
    from: f64,
    to: f64,
}

impl Window {
    /// Milliseconds from the last beam.
    fn ms(&self, ns: u64) -> f64 {
        (ns as f64 - self.zero as f64) / 1e6
    }

    fn x(&self, ms: f64) -> f64 {
        LABELS + (ms.clamp(self.from, self.to) - self.from) / (self.to - self.from) * (WIDTH - LABELS - 12.0)
    }
}

/// The picture, with a table of the critical path below it; nothing for a scan without a plan.
pub(super) fn picture(path: &ScanPath<'_>) -> Option<Markup> {
    let (zero, length) = (path.scan_sent_ns()?, path.end_to_end()? as f64 / 1e6);
    let window = Window { zero, from: -0.06 * length, to: 1.3 * length };
    let is_shown = |work: &&ServiceWork| window.ms(work.span.began_ns) < window.to;
    let mut lanes: Vec<(&str, u32)> = Vec::new();
    for work in path.works.iter().copied().filter(is_shown) {
        if !lanes.contains(&lane_of(work)) {
            lanes.push(lane_of(work));
        }
    }
    let height = TOP + LANE * lanes.len() as f64 + 40.0;
    let y = |work: &ServiceWork| {
        let lane = lanes.iter().position(|lane| *lane == lane_of(work)).unwrap_or(0);
        TOP + LANE * lane as f64 + 8.0
    };
    Some(html! {
        svg viewBox=(format!("0 0 {WIDTH} {height}")) role="img" width=(WIDTH) font-family="sans-serif" font-size="12" {
            title { "Scan " (path.scan) " from its last beam to its plan" }
            (axis(&window, height))
            @for (k, (service, thread)) in lanes.iter().enumerate() {
                text x="4" y=(number(TOP + LANE * k as f64 + 8.0 + 0.5 * BAR + 4.0)) fill="#333" {
                    (service) @if *thread > 0 { ", intake" }
                }
            }
            @for work in path.works.iter().copied().filter(is_shown) { (delays(work, &window, y(work))) }
            @for (work, is_critical) in path.works.iter().copied().zip(&path.is_critical).filter(|(w, _)| is_shown(w)) {
                (bar(work, *is_critical, &window, y(work)))
            }
            (links(path, &window, &y))
        }
        (key())
        (table(path, &window))
    })
}

fn lane_of(work: &ServiceWork) -> (&str, u32) {
    (&work.service, work.span.thread)
}

fn number(value: f64) -> String {
    format!("{value:.1}")
}

/// Without the last digits that a product of tenths has.
fn round(ms: f64) -> f64 {
    (ms * 1000.0).round() / 1000.0
}

fn axis(window: &Window, height: f64) -> Markup {
    let step = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0]
        .into_iter()
        .find(|step| (window.to - window.from) / step <= 12.0)
        .unwrap_or(1000.0);
    let ticks: Vec<f64> = (0..=12).map(|k| f64::from(k) * step).take_while(|ms| *ms <= window.to).collect();
    html! {
        @for ms in ticks {
            @let x = number(window.x(ms));
            line x1=(x) x2=(x) y1=(number(TOP)) y2=(number(height - 34.0)) stroke="#e4e7ea" {}
            text x=(x) y=(number(height - 18.0)) text-anchor="middle" fill="#666" { (round(ms)) }
        }
        text x=(number(WIDTH - 12.0)) y=(number(height - 3.0)) text-anchor="end" fill="#666" { "ms after the last beam" }
    }
}

fn bar(work: &ServiceWork, is_critical: bool, window: &Window, y: f64) -> Markup {
    let (from, to) = (window.ms(work.span.began_ns), window.ms(work.span.ended_ns));
    let (x, width) = (window.x(from), (window.x(to) - window.x(from)).max(1.0));
    let label = work.stage();
    html! {
        rect x=(number(x)) y=(number(y)) width=(number(width)) height=(number(BAR)) fill=(colour(label))
            stroke=[is_critical.then_some(CRITICAL)] stroke-width=[is_critical.then_some("2")] {
            title { (label) ": " (format!("{:.3}", to - from)) " ms, from " (format!("{from:.3}")) " ms on" }
        }
        @if LETTER * label.len() as f64 + 4.0 < width {
            @let is_light = colour(label) == "#c3cad2" || label == "scan";
            text x=(number(x + 4.0)) y=(number(y + 14.0)) fill=(if is_light { "#222" } else { "#fff" }) { (label) }
        }
    }
}

/// What lies between an input and the work on it, in front of its bar.
fn delays(work: &ServiceWork, window: &Window, y: f64) -> Markup {
    let delay = work.span.delay();
    let woke = work.span.began_ns.saturating_sub(delay.taking);
    let slept = woke.saturating_sub(delay.wake_up);
    let part = |from: u64, to: u64| (window.x(window.ms(from)), window.x(window.ms(to)) - window.x(window.ms(from)));
    let (wake, taking) = (part(slept, woke), part(woke, work.span.began_ns));
    let waiting = part(slept.saturating_sub(delay.waiting), slept);
    html! {
        @if waiting.1 > 0.3 {
            line x1=(number(waiting.0)) x2=(number(waiting.0 + waiting.1)) y1=(number(y + BAR + 4.0)) y2=(number(y + BAR + 4.0))
                stroke="#777" stroke-width="2" stroke-dasharray="3 2" {}
        }
        @for ((x, width), fill) in [(wake, WAKE_UP), (taking, TAKING)] {
            @if width > 0.3 {
                rect x=(number(x)) y=(number(y + 4.0)) width=(number(width)) height=(number(BAR - 8.0)) fill=(fill) {}
            }
        }
    }
}

/// The critical path as a line from work to work.
fn links(path: &ScanPath<'_>, window: &Window, y: &dyn Fn(&ServiceWork) -> f64) -> Markup {
    let critical: Vec<&ServiceWork> = path.critical().collect();
    html! {
        @for pair in critical.windows(2) {
            @let (a, b) = (pair[0], pair[1]);
            @if lane_of(a) != lane_of(b) {
                line x1=(number(window.x(window.ms(a.span.ended_ns)))) y1=(number(y(a) + 0.5 * BAR))
                    x2=(number(window.x(window.ms(b.span.began_ns)))) y2=(number(y(b) + 0.5 * BAR))
                    stroke=(CRITICAL) stroke-width="1.5" {}
            }
        }
    }
}

fn key() -> Markup {
    let entries = [
        (CRITICAL, "outlined: on the critical path"),
        (WAKE_UP, "waking up"),
        (TAKING, "taking the message"),
        ("#777", "dashed: waiting for a busy thread"),
    ];
    html! {
        p.note {
            @for (fill, words) in entries {
                span style=(format!("display:inline-block;width:1.2em;height:.7em;margin:0 .4em 0 .9em;background:{fill}")) {}
                (words)
            }
        }
    }
}

fn table(path: &ScanPath<'_>, window: &Window) -> Markup {
    let ms = |ns: u64| format!("{:.3}", ns as f64 / 1e6);
    html! {
        table {
            tr {
                th.t { "Critical path" } th.t { "Service" } th { "From [ms]" } th { "To" } th { "Waiting" } th { "Wake-up" }
                th { "Taking" } th { "Computing" }
            }
            @for work in path.critical() {
                @let (span, delay) = (&work.span, work.span.delay());
                tr {
                    td.t { (work.stage()) } td.t { (work.service) }
                    td { (format!("{:.3}", window.ms(span.began_ns))) } td { (format!("{:.3}", window.ms(span.ended_ns))) }
                    @for part in [delay.waiting, delay.wake_up, delay.taking, span.computing()] { td { (ms(part)) } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::scan_path::tests::data;
    use super::*;

    #[test]
    fn every_process_has_a_lane_and_the_critical_path_is_outlined() {
        let data = data();
        let page = picture(&ScanPath::of(&data, 0).unwrap()).unwrap().into_string();
        for words in ["acquisition", "alignment, intake", "analysis", "planning", "Scan 0 from its last beam"] {
            assert!(page.contains(words), "{words}");
        }
        // Scan, prepare, align, scores, map and plan are outlined.
        assert_eq!(page.matches("stroke-width=\"2\">").count(), 6, "{page}");
        assert!(page.contains("plan: 20.000 ms, from 70.000 ms on"), "{page}");
        assert!(!page.contains("NaN"));
    }

    #[test]
    fn a_scan_without_a_plan_has_no_picture() {
        let mut data = data();
        data.work.spans.retain(|work| work.stage() != "plan");
        assert!(picture(&ScanPath::of(&data, 0).unwrap()).is_none());
    }
}
