//! The tables of `experiment.md`, which the page shows as well.

use std::collections::BTreeMap;

use super::matched::{Matched, matched};
use super::{Group, OWN, Results};
use crate::Summary;

/// A table: a head, and lines of as many cells; the first columns are words.
pub(super) struct Table {
    pub head: Vec<&'static str>,
    pub words: usize,
    pub lines: Vec<Line>,
}

/// A line of a table.
pub(super) struct Line {
    pub cells: Vec<String>,
    /// From a publication, not measured.
    pub is_literature: bool,
    /// Something went wrong in it.
    pub is_bad: bool,
}

/// Every entry of a world, the source's own figures below its experiments.
pub(super) fn entries(results: &Results, world: &str) -> Table {
    let head = vec![
        "experiment",
        "strategy",
        "weights A, Q, O, C",
        "seeds",
        "metres",
        "quality",
        "coverage",
        "scans",
        "mission [min]",
        "wall [s]",
        "plan [ms]",
        "model error [mm]",
        "pose error",
        "stopped",
        "given up",
    ];
    let mut lines = Vec::new();
    for group in results.of_world(world).filter(|group| !group.runs.is_empty()) {
        lines.push(line(group));
        lines.extend(literature(group));
    }
    Table { head, words: 3, lines }
}

fn line(group: &Group) -> Line {
    let entry = &group.entry;
    let middle = |summary: Option<Summary>, digits: usize, factor: f64| {
        summary.map_or("–".to_owned(), |s| format!("{:.digits$}", s.p50 * factor))
    };
    let error = |of: fn(&mirador_core::simulation::ModelDistance) -> f64| {
        Summary::of(&group.runs.iter().filter_map(|run| run.model_error.as_ref().map(of)).collect::<Vec<_>>())
    };
    let failures = group.failures();
    let cells = vec![
        if entry.experiment.is_empty() && entry.is_weighted() { entry.label() } else { entry.experiment.clone() },
        entry.strategy.clone(),
        entry.weights.map_or(String::new(), |weights| weights.map(|w| w.to_string()).join(", ")),
        group.runs.len().to_string(),
        middle(group.at_end(|step| step.metres), 0, 1.0),
        middle(group.at_end(|step| step.quality), 3, 1.0),
        middle(group.at_end(|step| step.coverage), 1, 100.0) + " %",
        middle(group.summary(|run| run.steps.len() as f64), 0, 1.0),
        middle(group.at_end(|step| step.mission_s), 1, 1.0 / 60.0),
        middle(group.summary(|run| run.wall_s), 1, 1.0),
        middle(group.of_steps(|step| step.planning_ms), 1, 1.0),
        format!("{} / {}", middle(error(|e| e.median_m), 1, 1e3), middle(error(|e| e.p95_m), 0, 1e3)),
        "–".into(),
        counted(group.stops()),
        given_up(group),
    ];
    Line { cells, is_literature: false, is_bad: failures > 0 }
}

/// The targets given up, in how many runs and at what.
fn given_up(group: &Group) -> String {
    let by_place = group.given_up();
    let (all, runs) =
        (by_place.values().sum::<usize>(), group.runs.iter().filter(|run| !run.given_up.is_empty()).count());
    if all == 0 { "0".into() } else { format!("{all} in {runs} runs ({})", counted(by_place)) }
}

fn counted(counts: BTreeMap<String, usize>) -> String {
    let words: Vec<String> = counts.iter().map(|(word, n)| format!("{} {n}", word.replace('_', " "))).collect();
    words.join(", ")
}

/// The source's own figures.
fn literature(group: &Group) -> Option<Line> {
    let known = group.entry.literature()?;
    let mut cells = vec![
        known.experiment.to_owned(),
        "source, in its own world".into(),
        String::new(),
        "1".into(),
        format!("{:.0}", known.metres),
        format!("{:.3}", known.quality),
        format!("{:.1} %", 100.0 * known.coverage),
        format!("{:.0}", known.scans),
    ];
    cells.resize(15, String::new());
    cells[13] = "literature".into();
    Some(Line { cells, is_literature: true, is_bad: false })
}

/// Mirador's own strategy against every other of a world, at what that one ended with.
pub(super) fn matches(results: &Results, world: &str) -> Option<Table> {
    let own = results.of_world(world).find(|group| group.entry.strategy == OWN && !group.runs.is_empty())?;
    let head = vec!["against", "coverage", "quality", "reached", "scans", "metres", "mission time"];
    let others = results.of_world(world).filter(|group| group.entry != own.entry && !group.runs.is_empty());
    let lines = others.map(|other| {
        let found = matched(own, other);
        let share = |ratios: &[f64]| Matched::median(ratios).map_or("–".to_owned(), |ratio| format!("{ratio:.2}"));
        let end = |summary: Option<Summary>| summary.map_or(f64::NAN, |s| s.p50);
        let cells = vec![
            other.entry.label(),
            format!("{:.1} %", 100.0 * end(other.at_end(|step| step.coverage))),
            format!("{:.3}", end(other.at_end(|step| step.quality))),
            format!("{} of {}", found.reached, found.pairs),
            share(&found.scans),
            share(&found.metres),
            share(&found.mission),
        ];
        Line { cells, is_literature: false, is_bad: 2 * found.reached < found.pairs }
    });
    let lines: Vec<Line> = others_or_none(lines.collect())?;
    Some(Table { head, words: 1, lines })
}

fn others_or_none(lines: Vec<Line>) -> Option<Vec<Line>> {
    (!lines.is_empty()).then_some(lines)
}

/// What the ceiling of a world is.
pub(super) fn ceiling(results: &Results, world: &str) -> Option<String> {
    let ceiling = results.ceilings.get(world)?;
    Some(format!(
        "Ceiling: {} scans, one every {} m all over the reachable cells, give a mean quality of {:.3} and know {:.1} % of \
         them.",
        ceiling.scans,
        ceiling.spacing_m,
        ceiling.quality,
        100.0 * ceiling.coverage
    ))
}

/// What the figures are.
pub(super) fn explanation(results: &Results) -> Vec<String> {
    let settings = &results.settings;
    let scanner = settings.scanner();
    let seeds = settings.all_seeds();
    vec![
        format!(
            "Kinematic mode: one process, true poses, a jump along each path. Scanner: {} beams by {} sweeps of {} deg, \
             1 cm noise, lost and mixed returns. Seeds {} to {}; at most {} scans a run; d_max {} m. Medians over the \
             seeds; model error as median / 95th percentile distance of a sample of all points to the nearest true \
             surface. Pose error: poses are true in this mode.",
            scanner.beams,
            scanner.sweeps,
            scanner.beam_step_deg,
            seeds.start,
            seeds.end.saturating_sub(1),
            settings.max_scans,
            settings.farthest_m,
        ),
        "Mission time is driving at 0.8 m/s and 14.4 s a scan. Coverage and quality are those of the truly reachable cells. \
         Where something stops the robot on its way it gives the target up, goes back a metre and scans there; five in a row \
         end the run as stuck. The source's figures belong to its own worlds, whose sizes are not known."
            .to_owned(),
    ]
}

/// What the ratios are.
pub(super) const MATCHED: &str = "How much of the other's effort coverage_tour needs until it has reached both the coverage \
    and the quality that the other ended with, run by run of the same seed, as the median; under 1 it needs less. A dash: in \
    most runs it ended before.";

/// All tables as text.
pub(super) fn render(results: &Results) -> String {
    let mut out = String::from("# Experiments\n\n");
    for paragraph in explanation(results) {
        out += &format!("{paragraph}\n\n");
    }
    if !results.is_complete() {
        out += "**Not finished: some runs are missing.**\n\n";
    }
    for world in &results.settings.worlds {
        out += &format!("## {world}\n\n");
        if let Some(ceiling) = ceiling(results, world) {
            out += &format!("{ceiling}\n\n");
        }
        out += &entries(results, world).markdown();
        if let Some(table) = matches(results, world) {
            out += &format!("\n{MATCHED}\n\n{}", table.markdown());
        }
        out += "\n";
    }
    out
}

impl Table {
    fn markdown(&self) -> String {
        let row = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
        let rules: Vec<&str> = (0..self.head.len()).map(|k| if k < self.words { "---" } else { "---:" }).collect();
        let mut out = row(&self.head) + &row(&rules);
        for line in &self.lines {
            let cells: Vec<String> = line
                .cells
                .iter()
                .map(|cell| if line.is_literature && !cell.is_empty() { format!("*{cell}*") } else { cell.clone() })
                .collect();
            out += &row(&cells.iter().map(String::as_str).collect::<Vec<_>>());
        }
        out
    }
}
