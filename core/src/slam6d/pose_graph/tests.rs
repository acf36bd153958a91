//! The pose graph as a whole.

use std::time::Instant;

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
        println!("{} poses {} edges: {result:?} in {:?}", config.poses, config.edges, begin.elapsed());
        let begin = Instant::now();
        let again = graph.optimise().unwrap();
        println!("again: {again:?} in {:?}", begin.elapsed());
        let before = trajectory_error(&survey.start, &survey.truth).unwrap();
        let after = trajectory_error(graph.poses(), &survey.truth).unwrap();
        println!("{before:?} {after:?}");
        let begin = Instant::now();
        println!(
            "{:?} in {:?}",
            graph.relative_covariance(10, config.poses - 10).unwrap()[(0, 0)].sqrt(),
            begin.elapsed()
        );
        let freedom = 6.0 * (config.edges - config.poses + 1) as f64;
        assert!(result.converged && (result.chi2 / freedom - 1.0).abs() < 5.0 / freedom.sqrt(), "{result:?}");
        assert!(after.ate_rmse_m < 0.2 * before.ate_rmse_m, "{after:?}");
    }
}

#[test]
fn false_closures_are_switched_off_and_true_ones_kept() {
    for pairs in [false, true] {
        for share in [0.1, 0.3, 0.5] {
            let clean = Survey::new(&small(0.0, false, 5)).unwrap();
            let survey = Survey::new(&small(share, pairs, 5)).unwrap();
            let (mut expected, mut graph) = (graph(&clean), graph(&survey));
            expected.optimise().unwrap();
            let begin = Instant::now();
            let result = graph.optimise().unwrap();
            let difference = trajectory_error(graph.poses(), expected.poses()).unwrap();
            println!(
                "{share} {pairs} {} iterations {:?}: {} off of {}, {difference:?}",
                result.iterations,
                begin.elapsed(),
                result.switched_off.len(),
                survey.edges.len() - survey.first_false
            );
        }
    }
}

#[test]
#[ignore]
fn profile() {
    use std::hint::black_box;
    let survey = Survey::new(&SurveyConfig::default()).unwrap();
    let mut graph = graph(&survey);
    graph.optimise().unwrap();
    let begin = Instant::now();
    let solved = graph.analyse().map_err(|_| ()).unwrap();
    println!("analyse {:?}", begin.elapsed());
    let mut workspace = solved.workspace;
    println!(
        "unknowns {} nnz {} factor {} supernodes {}",
        workspace.solver.structure.unknowns(),
        workspace.solver.values.len(),
        workspace.solver.structure.symbolic.len_val(),
        workspace.solver.structure.symbolic.n_supernodes()
    );
    let problem = Problem { edges: &graph.edges, poses: &mut graph.poses, weights: &mut graph.weights };
    for _ in 0..3 {
        let begin = Instant::now();
        black_box(problem.linearise(&mut workspace));
        println!("linearise {:?}", begin.elapsed());
        let begin = Instant::now();
        workspace.solver.factorise(0.0);
        println!("factorise {:?}", begin.elapsed());
        let begin = Instant::now();
        workspace.solver.solve(0.0);
        println!("solve with factorise {:?}", begin.elapsed());
        let begin = Instant::now();
        black_box(problem.cost(&workspace));
        println!("cost {:?}", begin.elapsed());
    }
}
