//! `experiment.html`: one page that needs nothing beside it.

use base64::Engine;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::curves::{COLOURS, Curve, plot};
use super::markdown::{self, Table};
use super::store::Store;
use super::{ExperimentError, Group, OWN, Results, RunRecord};
use crate::Machine;

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1360px;margin:2em auto;padding:0 1em}\
h1{font-size:1.6em;margin-bottom:.2em}h2{font-size:1.25em;margin-top:2.2em;border-bottom:1px solid #ddd}\
h3{font-size:1em;margin:1.6em 0 .3em}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.82em}\
th,td{padding:.2em .55em;text-align:right;border-bottom:1px solid #eee;vertical-align:top}\
th{background:#f6f6f6;font-weight:600;vertical-align:bottom}td.t,th.t{text-align:left}td.t{white-space:nowrap}\
tr.bad td:nth-last-child(2){color:#b3261e}tr.own td{background:#fdf3f5;font-weight:600}\
tr.literature td{color:#667;font-style:italic}.note{color:#666;max-width:62em}.wide{overflow-x:auto}\
.row{display:flex;flex-wrap:wrap;gap:6px}.row svg{max-width:100%;height:auto}\
.key{display:flex;flex-wrap:wrap;gap:.2em 1.4em;font-size:.85em;margin:.2em 0}\
.key i{display:inline-block;width:1.4em;height:.25em;margin:0 .4em .2em 0}\
.maps{display:grid;grid-template-columns:repeat(auto-fill,minmax(290px,1fr));gap:14px}\
figure{margin:0}figcaption{font-size:.85em;color:#444}figure svg{width:100%;height:auto;background:#e2e2e2}";

/// Renders the page.
pub(super) fn render(results: &Results, store: &Store) -> Result<String, ExperimentError> {
    let machine = Machine::here();
    let mut worlds = Vec::new();
    for world in &results.settings.worlds {
        worlds.push(section(results, world, store)?);
    }
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "mirador: experiments" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Experiments" }
                @for paragraph in markdown::explanation(results) { p.note { (paragraph) } }
                p.note { (machine.cpu) ", " (machine.cores) " cores, " (machine.os) ", commit " (machine.commit) }
                @if !results.is_complete() { p { strong { "Not finished: some runs are missing." } } }
                @for world in &worlds { (world) }
            }
        }
    };
    Ok(page.into_string())
}

fn section(results: &Results, world: &str, store: &Store) -> Result<Markup, ExperimentError> {
    let own = |group: &&Group| group.entry.strategy == OWN;
    let there: Vec<&Group> = results.of_world(world).filter(|group| !group.runs.is_empty()).collect();
    let with_own = |keep: &dyn Fn(&Group) -> bool| {
        let others = there.iter().copied().filter(|group| !own(group) && keep(group));
        let own = there.iter().copied().filter(|group| own(group));
        own.chain(others).collect::<Vec<_>>()
    };
    let experiments = with_own(&|group| !group.entry.experiment.is_empty());
    let baselines = with_own(&|group| !group.entry.is_weighted() && group.entry.experiment.is_empty());
    let mut plots = Vec::new();
    for (title, groups) in [("The source's experiments", experiments), ("The other strategies", baselines)] {
        // Mirador's own alone is on the other plot already.
        if groups.iter().any(|group| !own(group)) || plots.is_empty() && !groups.is_empty() {
            plots.push(curves(title, &groups)?);
        }
    }
    Ok(html! {
        h2 { (world) }
        @if let Some(ceiling) = markdown::ceiling(results, world) { p.note { (ceiling) } }
        (table(&markdown::entries(results, world)))
        @if let Some(matches) = markdown::matches(results, world) {
            h3 { (OWN) " at what the others ended with" }
            p.note { (markdown::MATCHED) }
            (table(&matches))
        }
        @for plot in &plots { (plot) }
        h3 { "Maps after the first seed's run" }
        p.note { "Colour: quality of the ground, from dark blue (0) to yellow (1); dark: obstacles; grey: unknown. Red: the way \
                  and its scans." }
        div.maps { @for map in there.iter().filter_map(|group| map(group, store)) { (map) } }
    })
}

fn table(table: &Table) -> Markup {
    html! {
        div.wide { table {
            tr { @for (k, head) in table.head.iter().enumerate() { th.t[k < table.words] { (head) } } }
            @for line in &table.lines {
                @let is_own = line.cells.iter().take(2).any(|cell| cell == OWN);
                tr.bad[line.is_bad].literature[line.is_literature].own[is_own] {
                    @for (k, cell) in line.cells.iter().enumerate() { td.t[k < table.words] { (cell) } }
                }
            }
        } }
    }
}

/// The three curves of some groups, with one key.
fn curves(title: &str, groups: &[&Group]) -> Result<Markup, ExperimentError> {
    let mut svgs = Vec::new();
    for curve in Curve::ALL {
        svgs.push(plot(groups, curve)?);
    }
    Ok(html! {
        h3 { (title) }
        div.key {
            @for (group, colour) in groups.iter().zip(COLOURS.iter().cycle()) {
                span {
                    i style=(format!("background:rgb({},{},{})", colour.0, colour.1, colour.2)) {}
                    (group.entry.label())
                }
            }
            span.note { "median, and from the lowest to the highest run" }
        }
        div.row { @for svg in &svgs { (PreEscaped(svg)) } }
    })
}

/// The map of the first run that has a picture, its way drawn over it.
fn map(group: &Group, store: &Store) -> Option<Markup> {
    let (run, frame) = group.runs.iter().find_map(|run| Some((run, run.picture?)))?;
    let png = store.bytes(&format!("runs/{}-{}.png", group.entry.id(), run.seed))?;
    let source = format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png));
    let (width, height) = (f64::from(frame.width), f64::from(frame.height));
    // In cells, y downwards.
    let place = |[x, y]: [f64; 2]| ((x - frame.min[0]) / frame.cell_m, height - (y - frame.min[1]) / frame.cell_m);
    let line: Vec<String> =
        run.ways.iter().flatten().map(|&at| place(at)).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let scale = width.max(height) / 300.0;
    Some(html! {
        figure {
            svg viewBox=(format!("0 0 {width} {height}")) role="img" {
                image href=(source) width=(width) height=(height) style="image-rendering:pixelated" {}
                polyline points=(line.join(" ")) fill="none" stroke="#c81e3c" stroke-width=(format!("{:.2}", 1.3 * scale)) {}
                @for at in scan_places(run) {
                    @let (x, y) = place(at);
                    circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r=(format!("{:.2}", 2.6 * scale)) fill="#fff"
                        stroke="#c81e3c" stroke-width=(format!("{:.2}", 1.2 * scale)) {}
                }
            }
            figcaption { (group.entry.label()) ", seed " (run.seed) ": " (run.steps.len()) " scans" }
        }
    })
}

fn scan_places(run: &RunRecord) -> Vec<[f64; 2]> {
    let starts = run.ways.iter().filter_map(|way| way.first().copied());
    let end = run.ways.last().and_then(|way| way.last().copied()).filter(|_| run.ways.len() < run.steps.len());
    starts.chain(end).collect()
}
