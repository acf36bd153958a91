//! The pose graph as a whole.

use std::time::Instant;

use nalgebra::Matrix6;

use super::survey::{Survey, SurveyConfig};
use super::*;
use crate::slam6d::trajectory_error;

fn small(false_share: f64, false_pairs: bool, seed: u64) -> SurveyConfig {
    SurveyConfig { poses: 240, poses_per_lane: 20, edges: 640, false_share, false_pairs, seed, ..Default::default() }
}

fn graph(survey: &Survey) -> PoseGraph {
    survey.graph(PoseGraphConfig::default()).unwrap()
}

#[test]
fn a_survey_comes_out_where_it_was() {
    for config in [small(0.0, false, 3), SurveyConfig::default()] {
        let survey = Survey::new(&config).unwrap();
        let mut graph = graph(&survey);
        let begin = Instant::now();
        let result = graph.optimise().unwrap();
        println!("{} poses, {} edges in {:?}: {result:?}", config.poses, config.edges, begin.elapsed());
        let before = trajectory_error(&survey.start, &survey.truth).unwrap();
        let after = trajectory_error(graph.poses(), &survey.truth).unwrap();
        println!("  from {before:?}\n  to {after:?}");
        // With honest covariances the sum of squares is as large as the measurements are more than the unknowns.
        let freedom = 6.0 * (config.edges - config.poses + 1) as f64;
        assert!(result.converged && (result.chi2 / freedom - 1.0).abs() < 5.0 / freedom.sqrt(), "{result:?}");
        assert!(after.ate_rmse_m < 0.2 * before.ate_rmse_m, "{after:?}");
        let again = graph.optimise().unwrap();
        assert!(again.iterations == 1 && again.largest_translation_m < 1e-6, "{again:?}");
    }
}

/// Optimises a survey with and without false closures; they must be switched off, no others, and make no difference.
fn check_false_closures(config: &SurveyConfig) {
    let clean = Survey::new(&SurveyConfig { false_share: 0.0, ..*config }).unwrap();
    let survey = Survey::new(config).unwrap();
    let (mut expected, mut graph) = (graph(&clean), graph(&survey));
    expected.optimise().unwrap();
    let begin = Instant::now();
    let result = graph.optimise().unwrap();
    let difference = trajectory_error(graph.poses(), expected.poses()).unwrap();
    println!(
        "{:.1} false, pairs {}, seed {}: {} iterations in {:?}, {} of {} off, {:.2e} m from without",
        config.false_share,
        config.false_pairs,
        config.seed,
        result.iterations,
        begin.elapsed(),
        result.switched_off.len(),
        survey.edges.len() - survey.first_false,
        difference.max_m,
    );
    assert_eq!(result.switched_off, (survey.first_false..survey.edges.len()).collect::<Vec<_>>());
    assert!(result.converged && difference.max_m < 1e-4 && difference.max_deg < 1e-3, "{difference:?}");
}

#[test]
fn false_closures_are_switched_off_and_true_ones_kept() {
    for seed in 1..4 {
        for (share, pairs) in [(0.1, false), (0.3, false), (0.5, false), (0.1, true), (0.3, true), (0.5, true)] {
            check_false_closures(&small(share, pairs, seed));
        }
    }
}

/// Adds the nodes and edges of a survey in the order in which a robot would, and updates after each node.
fn grow(survey: &Survey, config: PoseGraphConfig) -> (PoseGraph, [usize; 3]) {
    let mut graph = PoseGraph::new(config).unwrap();
    let mut edges = survey.edges.clone();
    edges.sort_by_key(|edge| edge.from.max(edge.to));
    let mut edges = edges.into_iter().peekable();
    let mut counts = [0; 3];
    for node in 0..survey.truth.len() {
        let chain = edges.peek().filter(|edge| edge.to == node && edge.from + 1 == node);
        let pose = chain.map_or(survey.start[0], |edge| graph.poses()[edge.from] * edge.from_from_to);
        graph.add_node(pose);
        while let Some(edge) = edges.next_if(|edge| edge.from.max(edge.to) == node) {
            graph.add_edge(edge).unwrap();
        }
        match graph.update().unwrap() {
            Update::Nothing => counts[0] += 1,
            Update::Window(_) => counts[1] += 1,
            Update::Full(_) => counts[2] += 1,
        }
    }
    (graph, counts)
}

#[test]
fn a_graph_grown_step_by_step_ends_where_the_whole_does() {
    for (seed, false_share) in [(1, 0.0), (2, 0.0), (3, 0.2)] {
        let config = SurveyConfig { poses: 120, edges: 300, false_share, ..small(0.0, false, seed) };
        let survey = Survey::new(&config).unwrap();
        let (mut grown, counts) = grow(&survey, PoseGraphConfig::default());
        grown.optimise().unwrap();
        let mut batch = graph(&survey);
        batch.optimise().unwrap();
        let difference = trajectory_error(grown.poses(), batch.poses()).unwrap();
        println!("grown, updates [nothing, window, full] {counts:?}: {difference:?}");
        assert!(difference.max_m < 1e-6 && difference.max_deg < 1e-5, "{difference:?}");
        assert_eq!(grown.switched_off().len(), survey.edges.len() - survey.first_false);
    }
}

#[test]
fn a_window_is_as_good_as_the_whole_within_its_tolerance() {
    // No closures: 60 nodes a lane, each joined to the two before.
    let config = SurveyConfig { poses: 300, poses_per_lane: 60, edges: 597, ..Default::default() };
    let survey = Survey::new(&config).unwrap();
    let (mut grown, [nothing, windows, full]) = grow(&survey, PoseGraphConfig::default());
    assert!(nothing == 2 && windows > 200 && full < 60, "{nothing} {windows} {full}");
    let before = grown.poses().to_vec();
    let moved = grown.optimise().unwrap();
    let last = trajectory_error(&before[290..], &grown.poses()[290..]).unwrap();
    println!("after {windows} windows and {full} full: {moved:?}, the end by {last:?}");
    assert!(last.max_m < 1e-3, "{last:?}");
    assert!(moved.largest_translation_m < 300.0 * 1e-4, "{moved:?}");
}

#[test]
fn a_chain_alone_asks_for_nothing_and_a_window_holds_what_is_before_it() {
    let config = SurveyConfig { poses: 40, edges: 39, ..Default::default() };
    let (mut graph, counts) = grow(&Survey::new(&config).unwrap(), PoseGraphConfig::default());
    assert_eq!(counts, [40, 0, 0]);
    let before = graph.poses().to_vec();
    let pull = Edge { from: 20, to: 39, from_from_to: Pose::identity(), ..graph.edges()[0].clone() };
    graph.add_edge(pull).unwrap();
    let moved = graph.optimise_window(30).unwrap();
    assert!(moved.chi2 < moved.chi2_before && moved.first_node == 30 && moved.largest_translation_m > 1.0);
    assert_eq!(&graph.poses()[..30], &before[..30]);
}

#[test]
fn the_relative_covariance_is_that_of_the_dense_inverse() {
    let survey = Survey::new(&SurveyConfig { poses: 30, poses_per_lane: 10, edges: 70, ..Default::default() }).unwrap();
    let mut graph = graph(&survey);
    graph.optimise().unwrap();
    // The dense equations without node 0.
    let mut dense = nalgebra::DMatrix::zeros(29 * 6, 29 * 6);
    for edge in graph.edges() {
        let terms = linearisation::linearise(edge, &graph.poses()[edge.from], &graph.poses()[edge.to], 1.0);
        let (a, b) = (edge.from.checked_sub(1).map(|k| 6 * k), edge.to.checked_sub(1).map(|k| 6 * k));
        let mut add = |row: Option<usize>, column: Option<usize>, block: &Matrix6<f64>| {
            if let (Some(row), Some(column)) = (row, column) {
                let mut view = dense.fixed_view_mut::<6, 6>(row, column);
                view += block;
            }
        };
        add(a, a, &terms.from_from);
        add(b, b, &terms.to_to);
        add(a, b, &terms.from_to);
        add(b, a, &terms.from_to.transpose());
    }
    let inverse = dense.try_inverse().unwrap();
    let block = |a: usize, b: usize| -> Matrix6<f64> {
        if a == 0 || b == 0 { Matrix6::zeros() } else { inverse.fixed_view::<6, 6>(6 * a - 6, 6 * b - 6).into() }
    };
    for (a, b) in [(0, 29), (29, 0), (3, 17), (17, 3), (12, 13), (5, 5)] {
        let found = graph.relative_covariance(a, b).unwrap();
        let carry = crate::geometry::adjoint(&(graph.poses()[b].inverse() * graph.poses()[a]));
        let cross = carry * block(a, b);
        let expected = block(b, b) + carry * block(a, a) * carry.transpose() - cross - cross.transpose();
        assert!((found - expected).amax() < 1e-9 * (1e-6 + expected.amax()), "{a} {b}: {found} {expected}");
    }
}

#[test]
fn the_covariance_of_a_chain_is_the_sum_of_its_steps_before_and_after_optimisation() {
    let survey = Survey::new(&SurveyConfig { poses: 25, edges: 24, ..Default::default() }).unwrap();
    let mut graph = graph(&survey);
    let sum = |graph: &PoseGraph, from: usize, to: usize| {
        let steps = graph.edges()[from..to].iter().map(|edge| {
            let carry = crate::geometry::adjoint(&(graph.poses()[to].inverse() * graph.poses()[edge.to]));
            carry * edge.information.try_inverse().unwrap() * carry.transpose()
        });
        steps.sum::<Matrix6<f64>>()
    };
    for _ in 0..2 {
        for (a, b) in [(0, 24), (5, 20), (23, 24)] {
            let (found, expected) = (graph.relative_covariance(a, b).unwrap(), sum(&graph, a, b));
            assert!((found - expected).amax() < 1e-9 * expected.amax(), "{found} {expected}");
            // Seen from the other end it is the same spread in the other's frame.
            let carry = crate::geometry::adjoint(&(graph.poses()[a].inverse() * graph.poses()[b]));
            let back = graph.relative_covariance(b, a).unwrap();
            let carried = carry * found * carry.transpose();
            assert!((back - carried).amax() < 1e-9 * carried.amax(), "{back} {carried}");
        }
        graph.optimise().unwrap();
        // Nodes added later hang on those that are known.
        let edge = Edge { from: graph.poses().len() - 1, to: graph.poses().len(), ..graph.edges()[0].clone() };
        graph.add_node(graph.poses()[edge.from] * edge.from_from_to);
        graph.add_edge(edge).unwrap();
        let end = graph.poses().len() - 1;
        let (found, expected) = (graph.relative_covariance(3, end).unwrap(), sum(&graph, 3, end));
        assert!((found - expected).amax() < 1e-9 * expected.amax(), "{found} {expected}");
    }
}

#[test]
fn edges_that_make_no_sense_are_refused_and_change_nothing() {
    let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
    graph.add_node(Pose::identity());
    graph.add_node(Pose::identity());
    let good = Edge {
        from: 0,
        to: 1,
        from_from_to: Pose::identity(),
        information: Matrix6::identity(),
        kind: EdgeKind::Sequential,
    };
    let mut lopsided = Matrix6::identity();
    lopsided[(0, 1)] = 0.5;
    let refused = [
        (Edge { to: 2, ..good.clone() }, EdgeError::UnknownNode { node: 2, nodes: 2 }),
        (Edge { to: 0, ..good.clone() }, EdgeError::SelfEdge { node: 0 }),
        (
            Edge { from_from_to: Pose::translation(f64::NAN, 0.0, 0.0), ..good.clone() },
            EdgeError::NotFinite { from: 0, to: 1 },
        ),
        (
            Edge { information: Matrix6::identity() * f64::INFINITY, ..good.clone() },
            EdgeError::NotFinite { from: 0, to: 1 },
        ),
        (Edge { information: -Matrix6::identity(), ..good.clone() }, EdgeError::Information { from: 0, to: 1 }),
        (Edge { information: lopsided, ..good.clone() }, EdgeError::Information { from: 0, to: 1 }),
    ];
    for (edge, error) in refused {
        assert_eq!(graph.add_edge(edge), Err(error));
    }
    let covariance = Matrix6::zeros();
    assert!(Edge::with_covariance(0, 1, Pose::identity(), &covariance, EdgeKind::Overlap).is_err());
    assert!(graph.edges().is_empty());
    assert_eq!(graph.relative_covariance(0, 1), Err(CovarianceError::Unconnected { a: 0, b: 1 }));
    assert_eq!(graph.relative_covariance(0, 9), Err(CovarianceError::UnknownNode { node: 9, nodes: 2 }));
    assert!(graph.optimise().unwrap().converged, "nothing to do");
}

#[test]
fn a_direction_that_no_edge_measures_keeps_its_start() {
    let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
    graph.add_node(Pose::identity());
    graph.add_node(Pose::translation(1.0, 5.0, 0.0));
    let mut information = Matrix6::identity() * 100.0;
    information[(1, 1)] = 0.0;
    let from_from_to = Pose::translation(2.0, 0.0, 0.0);
    graph.add_edge(Edge { from: 0, to: 1, from_from_to, information, kind: EdgeKind::Sequential }).unwrap();
    let result = graph.optimise().unwrap();
    let found = graph.poses()[1].translation.vector;
    assert!(result.chi2 < 1e-9 && (found.x - 2.0).abs() < 1e-6 && (found.y - 5.0).abs() < 1e-3, "{result:?} {found}");
    assert_eq!(graph.relative_covariance(0, 1), Err(CovarianceError::Unconstrained { a: 0, b: 1 }));
}

#[test]
fn parts_that_no_edge_joins_each_keep_their_first_node() {
    let survey = Survey::new(&small(0.0, false, 7)).unwrap();
    let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
    survey.start.iter().for_each(|pose| {
        graph.add_node(*pose);
    });
    let cut = 100;
    for edge in survey.edges.iter().filter(|edge| (edge.from < cut) == (edge.to < cut)) {
        graph.add_edge(edge.clone()).unwrap();
    }
    assert!(graph.optimise().unwrap().converged);
    assert_eq!((graph.poses()[0], graph.poses()[cut]), (survey.start[0], survey.start[cut]));
    let error = trajectory_error(&graph.poses()[cut..], &survey.truth[cut..]).unwrap();
    assert!(error.ate_rmse_m < 0.2, "{error:?}");
}
