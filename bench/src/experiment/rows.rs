//! The rows of `experiment.json`.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::literature::SOURCE;
use super::matched::{Matched, matched};
use super::{Group, OWN, Results, RunRecord};
use crate::{BenchReport, Machine, Provenance, Row, Summary};

impl Results {
    /// All figures: one row for each figure of each entry, over the seeds.
    #[must_use]
    pub fn report(&self) -> BenchReport {
        let mut rows = Vec::new();
        for world in &self.settings.worlds {
            rows.extend(self.ceiling_row(world));
            let own = self.of_world(world).find(|group| group.entry.strategy == OWN);
            for group in self.of_world(world) {
                rows.extend(self.figures(group));
                rows.extend(literature(group));
                if let Some(own) = own.filter(|own| own.entry != group.entry) {
                    rows.extend(self.matched_rows(own, group));
                }
            }
        }
        BenchReport { bench: "experiment".into(), machine: Machine::here(), rows }
    }

    fn params(&self, group: &Group) -> BTreeMap<String, Value> {
        let mut params = params(group);
        params.extend([
            ("mode".to_owned(), json!("kinematic")),
            ("scanner".into(), json!(format!("{} deg", self.settings.scanner().beam_step_deg))),
        ]);
        params
    }

    fn figures(&self, group: &Group) -> Vec<Row> {
        let end = |of: fn(&crate::exploration::Step) -> f64| group.at_end(of);
        let error = |of: fn(&mirador_core::simulation::ModelDistance) -> f64| {
            Summary::of(&group.runs.iter().filter_map(|run| run.model_error.as_ref().map(of)).collect::<Vec<_>>())
        };
        let figures = [
            ("metres", "m", end(|step| step.metres)),
            ("quality", "1", end(|step| step.quality)),
            ("coverage", "1", end(|step| step.coverage)),
            ("scans", "1", group.summary(|run| run.steps.len() as f64)),
            ("known_cells", "1", end(|step| step.known_cells as f64)),
            ("mission_time", "s", end(|step| step.mission_s)),
            ("wall_time", "s", group.summary(|run| run.wall_s)),
            ("planning_time", "ms", group.of_steps(|step| step.planning_ms)),
            ("computing_time", "ms", group.of_steps(|step| step.computing_ms)),
            ("model_error_median", "m", error(|error| error.median_m)),
            ("model_error_p95", "m", error(|error| error.p95_m)),
        ];
        let row = |(name, unit, summary): (&str, &str, Option<Summary>)| {
            let mut extra = BTreeMap::new();
            if name == "scans" {
                extra = endings(group);
            }
            let params = self.params(group);
            summary.map(|summary| measured(name, unit, params, summary, extra))
        };
        figures.into_iter().filter_map(row).collect()
    }

    fn ceiling_row(&self, world: &str) -> Option<Row> {
        let ceiling = self.ceilings.get(world)?;
        let params = BTreeMap::from([
            ("world".to_owned(), json!(world)),
            ("scanner".into(), json!(format!("{} deg", self.settings.scanner().beam_step_deg))),
            ("spacing_m".into(), json!(ceiling.spacing_m)),
        ]);
        let extra =
            BTreeMap::from([("scans".to_owned(), json!(ceiling.scans)), ("coverage".into(), json!(ceiling.coverage))]);
        Some(measured("ceiling_quality", "1", params, Summary::of(&[ceiling.quality])?, extra))
    }

    /// Effort of mirador's own strategy until it reached what the other ended with, over the other's effort.
    fn matched_rows(&self, own: &Group, other: &Group) -> Vec<Row> {
        let found = matched(own, other);
        let ratios =
            [("matched_scans", &found.scans), ("matched_metres", &found.metres), ("matched_mission", &found.mission)];
        let row = |(name, ratios): (&str, &Vec<f64>)| {
            let reached: Vec<f64> = ratios.iter().copied().filter(|ratio| ratio.is_finite()).collect();
            let mut params = self.params(own);
            params.insert("against".into(), json!(other.entry.label()));
            let extra = BTreeMap::from([
                ("pairs".to_owned(), json!(found.pairs)),
                ("not_reached".into(), json!(found.pairs - found.reached)),
                ("median_of_all".into(), json!(Matched::median(ratios))),
            ]);
            Some(measured(name, "1", params, Summary::of(&reached)?, extra))
        };
        ratios.into_iter().filter_map(row).collect()
    }
}

fn params(group: &Group) -> BTreeMap<String, Value> {
    let entry = &group.entry;
    BTreeMap::from([
        ("experiment".to_owned(), json!(entry.experiment)),
        ("world".into(), json!(entry.world)),
        ("strategy".into(), json!(entry.strategy)),
        ("weights".into(), json!(entry.weights_name)),
    ])
}

fn measured(
    name: &str,
    unit: &str,
    params: BTreeMap<String, Value>,
    summary: Summary,
    extra: BTreeMap<String, Value>,
) -> Row {
    Row { name: name.into(), params, unit: unit.into(), summary, provenance: Provenance::Measured, extra }
}

/// How the runs ended.
fn endings(group: &Group) -> BTreeMap<String, Value> {
    let pose_errors: Vec<Option<f64>> = group.runs.iter().map(|run: &RunRecord| run.pose_error_m).collect();
    BTreeMap::from([
        ("weights".to_owned(), json!(group.entry.weights)),
        ("seeds".into(), json!(group.runs.iter().map(|run| run.seed).collect::<Vec<_>>())),
        ("stop".into(), json!(group.stops())),
        ("failures".into(), json!(group.failures())),
        ("given_up".into(), json!(group.given_up())),
        // Known only where poses are estimated.
        ("pose_error_m".into(), json!(pose_errors.iter().flatten().copied().reduce(f64::max))),
    ])
}

/// The source's own figures.
fn literature(group: &Group) -> Vec<Row> {
    let Some(known) = group.entry.literature() else { return Vec::new() };
    let figures = [
        ("metres", "m", known.metres),
        ("quality", "1", known.quality),
        ("coverage", "1", known.coverage),
        ("scans", "1", known.scans),
    ];
    let row = |(name, unit, value): (&str, &str, f64)| Row {
        name: name.into(),
        params: params(group),
        unit: unit.into(),
        summary: Summary::single(value),
        provenance: Provenance::Literature,
        extra: BTreeMap::from([("source".to_owned(), json!(SOURCE))]),
    };
    figures.map(row).to_vec()
}
