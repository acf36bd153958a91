//! `relaxation` rows: pose graphs brought to their optimum, ours and GTSAM in turns.

use std::collections::BTreeMap;
use std::time::Instant;

use mirador_core::formats::{g2o_chi2, read_g2o, write_g2o};
use mirador_core::geometry::Pose;
use mirador_core::slam6d::pose_graph::survey::{Survey, SurveyConfig};
use mirador_core::slam6d::pose_graph::{Edge, PoseGraph, PoseGraphConfig};
use nalgebra::Matrix6;
use serde_json::{Value, json};

use super::contest::{median, median_parts};
use super::peers::{GTSAM_METHODS, Peers};
use super::{RegistrationBenchError, RegistrationOptions};
use crate::{Provenance, Row, Summary};

/// A graph to relax.
struct GraphData {
    name: String,
    start: Vec<Pose>,
    edges: Vec<Edge>,
}

/// What one relaxation gave.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GraphRun {
    /// From the graph in memory to its optimum [ms].
    pub ms: f64,
    /// The share of each phase [ms].
    pub parts: BTreeMap<String, f64>,
    /// `map_from_node`.
    pub poses: Vec<Pose>,
    /// Linearisations.
    pub iterations: Option<u64>,
}

/// The rows of every graph that is there.
pub(super) fn rows(
    options: &RegistrationOptions,
    peers: &Peers,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    let mut rows = Vec::new();
    let file = options.data.join("posegraph/parking-garage.g2o.gz");
    if file.is_file() {
        let read = read_g2o(&file)?;
        let data = GraphData { name: "parking-garage".into(), start: read.poses, edges: read.edges };
        rows.extend(relax(options.repetitions, &data, peers, say)?);
    } else {
        say(&format!("no data at {}: its rows are left out", file.display()));
    }
    let survey = Survey::new(&SurveyConfig::default())?;
    let data = GraphData { name: "survey_4000".into(), start: survey.start, edges: survey.edges };
    rows.extend(relax(options.repetitions, &data, peers, say)?);
    Ok(rows)
}

/// Whose runs, in the order of the report: ours, then the methods of GTSAM.
fn relax(
    repetitions: usize,
    data: &GraphData,
    peers: &Peers,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, RegistrationBenchError> {
    say(&format!("relaxation {}: {} poses, {} edges", data.name, data.start.len(), data.edges.len()));
    // GTSAM reads files only, and no packed ones.
    let folder = tempfile::tempdir().map_err(|e| RegistrationBenchError::temporary(&e))?;
    let file = folder.path().join("graph.g2o");
    let edges: Vec<Edge> = data.edges.iter().map(as_gtsam_reads_it).collect();
    write_g2o(&file, &data.start, &edges)?;
    let mut ours = Vec::new();
    let mut theirs: BTreeMap<&str, Vec<GraphRun>> = BTreeMap::new();
    for repetition in 0..=repetitions {
        let run = relax_ours(data)?;
        // The first is for warming up.
        ours.extend((repetition > 0).then_some(run));
        for method in GTSAM_METHODS {
            let run = peers.relax(method, &file, data.start.len(), say);
            theirs.entry(method).or_default().extend(run.filter(|_| repetition > 0));
        }
    }
    let mut rows: Vec<Row> = graph_row(data, "pose_graph", None, &ours).into_iter().collect();
    for (method, runs) in &theirs {
        rows.extend(graph_row(data, &format!("gtsam {method}"), peers.gtsam_version().as_deref(), runs));
    }
    Ok(rows)
}

/// The measurement such that GTSAM, reading it from a file, minimises the same sum as we do. A g2o file has information
/// about the vector part of a quaternion, which is half the rotation vector; GTSAM takes it for that about the rotation
/// vector itself.
fn as_gtsam_reads_it(edge: &Edge) -> Edge {
    let factor = |k: usize| if k < 3 { 1.0 } else { 0.5 };
    let information = Matrix6::from_fn(|i, j| edge.information[(i, j)] * factor(i) * factor(j));
    Edge { information, ..edge.clone() }
}

fn relax_ours(data: &GraphData) -> Result<GraphRun, RegistrationBenchError> {
    let begin = Instant::now();
    let mut graph = PoseGraph::new(PoseGraphConfig::default())?;
    for pose in &data.start {
        graph.add_node(*pose);
    }
    for edge in &data.edges {
        graph.add_edge(edge.clone())?;
    }
    let built = Instant::now();
    let result = graph.optimise()?;
    let end = Instant::now();
    let ms = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
    Ok(GraphRun {
        ms: ms(begin, end),
        parts: BTreeMap::from([("build".into(), ms(begin, built)), ("optimise".into(), ms(built, end))]),
        poses: graph.poses().to_vec(),
        iterations: Some(u64::from(result.iterations)),
    })
}

/// Both sums of squares are g2o's, by our own reckoning for every contestant, so that they can be compared.
fn graph_row(data: &GraphData, method: &str, version: Option<&str>, runs: &[GraphRun]) -> Option<Row> {
    let times: Vec<f64> = runs.iter().map(|run| run.ms).collect();
    let parts: Vec<&BTreeMap<String, f64>> = runs.iter().map(|run| &run.parts).collect();
    let iterations = median(runs.iter().filter_map(|run| Some(run.iterations? as f64)));
    let mut extra = BTreeMap::from([
        ("poses".to_owned(), json!(data.start.len())),
        ("edges".into(), json!(data.edges.len())),
        ("chi2_before".into(), json!(g2o_chi2(&data.start, &data.edges))),
        ("chi2".into(), json!(g2o_chi2(&runs.last()?.poses, &data.edges))),
        ("iterations".into(), json!(iterations.map(|n| n as u64))),
        ("parts".into(), json!(median_parts(&parts))),
    ]);
    if let Some(version) = version {
        extra.insert("version".into(), json!(version));
    }
    Some(Row {
        name: "relaxation".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(method)),
            ("data".into(), json!(data.name)),
            ("peer".into(), Value::Bool(version.is_some())),
        ]),
        unit: "ms".into(),
        summary: Summary::of(&times)?,
        provenance: Provenance::Measured,
        extra,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_survey_is_relaxed_and_reported() {
        let config = SurveyConfig { poses: 40, poses_per_lane: 10, edges: 90, ..SurveyConfig::default() };
        let survey = Survey::new(&config).unwrap();
        let data = GraphData { name: "d".into(), start: survey.start, edges: survey.edges };
        let run = relax_ours(&data).unwrap();
        let row = graph_row(&data, "pose_graph", None, &[run]).unwrap();
        assert_eq!(
            serde_json::to_value(&row.params).unwrap(),
            json!({"method": "pose_graph", "data": "d", "peer": false})
        );
        let number = |key: &str| row.extra[key].as_f64().unwrap();
        assert!(number("chi2") < number("chi2_before"), "{row:?}");
        assert!(number("iterations") >= 1.0 && row.extra["parts"]["optimise"].as_f64().unwrap() > 0.0);
        assert_eq!(graph_row(&data, "pose_graph", None, &[]), None);
    }
}
