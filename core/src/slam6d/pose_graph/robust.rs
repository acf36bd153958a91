//! Switches false loop closures off: truncated least squares by graduated non-convexity.
//!
//! The cost of a loop closure is min(chi2, gate). Its convex surrogate is sharpened step by step, so that the result
//! does not depend on a good start (Yang, Antonante, Tzoumas, Carlone 2020, equations 10 to 12). In the end a loop closure
//! counts fully or not at all.

use super::levenberg::{Problem, Walk, Workspace};
use super::{EdgeKind, PoseGraphConfig};

/// A weight up to this is switched off.
pub(super) const OFF: f64 = 1e-3;
/// How much sharper the surrogate becomes each time.
const SHARPENING: f64 = 1.4;
/// Enough to sharpen from residuals a million times the gate.
const MOST_SHARPENINGS: u32 = 100;
/// How often the final weights may be corrected.
const MOST_CORRECTIONS: u32 = 10;

/// Optimises all edges of the workspace, the robust ones with weights of 0 or 1.
pub(super) fn optimise(problem: &mut Problem<'_>, workspace: &mut Workspace, config: &PoseGraphConfig) -> Walk {
    let mut walk = Walk::default();
    problem.minimise(workspace, config, &mut walk);
    if !config.robust || correct(problem, workspace, config.closure_gate, false) == 0 {
        return walk;
    }
    // The weights contradict the residuals: begin anew with every loop closure counting.
    for edge in &workspace.edge_indices {
        problem.weights[*edge] = 1.0;
    }
    problem.minimise(workspace, config, &mut walk);
    graduate(problem, workspace, config, &mut walk);
    for _ in 0..MOST_CORRECTIONS {
        problem.minimise(workspace, config, &mut walk);
        if correct(problem, workspace, config.closure_gate, true) == 0 {
            break;
        }
    }
    walk
}

/// The indices of the robust edges.
fn closures<'a>(problem: &Problem<'a>, workspace: &'a Workspace) -> impl Iterator<Item = usize> + use<'a> {
    let edges = problem.edges;
    workspace.edge_indices.iter().copied().filter(|edge| edges[*edge].kind == EdgeKind::LoopClosure)
}

/// Counts the loop closures whose weight is not what their residual says, and corrects them if asked to.
fn correct(problem: &mut Problem<'_>, workspace: &Workspace, gate: f64, write: bool) -> usize {
    let mut wrong = 0;
    for edge in closures(problem, workspace) {
        let weight = if problem.chi2(edge) <= gate { 1.0 } else { 0.0 };
        wrong += usize::from(weight != problem.weights[edge]);
        if write {
            problem.weights[edge] = weight;
        }
    }
    wrong
}

/// Sharpens the surrogate from convex to truncated least squares, with one step of the poses at each sharpness.
fn graduate(problem: &mut Problem<'_>, workspace: &mut Workspace, config: &PoseGraphConfig, walk: &mut Walk) {
    let gate = config.closure_gate;
    let worst = closures(problem, workspace).map(|edge| problem.chi2(edge)).fold(0.0, f64::max);
    if worst <= gate {
        return;
    }
    let mut sharpness = gate / (2.0 * worst - gate);
    for _ in 0..MOST_SHARPENINGS {
        let mut undecided = 0;
        for edge in closures(problem, workspace) {
            let weight = weight(problem.chi2(edge), gate, sharpness);
            undecided += usize::from(weight > 0.0 && weight < 1.0);
            problem.weights[edge] = weight;
        }
        problem.step(workspace, config, walk);
        if undecided == 0 {
            break;
        }
        sharpness *= SHARPENING;
    }
}

/// The weight of a residual under the surrogate (equation 14 of the paper's truncated least squares).
fn weight(chi2: f64, gate: f64, sharpness: f64) -> f64 {
    if chi2 <= gate * sharpness / (sharpness + 1.0) {
        1.0
    } else if chi2 >= gate * (sharpness + 1.0) / sharpness {
        0.0
    } else {
        (gate / chi2 * sharpness * (sharpness + 1.0)).sqrt() - sharpness
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_falls_with_the_residual_and_sharpens_to_a_step() {
        for sharpness in [1e-4, 0.1, 1.0, 50.0, 1e6] {
            let weights: Vec<f64> = (0..2000).map(|k| weight(f64::from(k) * 0.1, 36.0, sharpness)).collect();
            assert!(weights.windows(2).all(|pair| pair[0] >= pair[1]) && weights[0] == 1.0);
            assert!(weights.iter().all(|weight| (0.0..=1.0).contains(weight)));
        }
        assert!(weight(35.9, 36.0, 1e6) == 1.0 && weight(36.1, 36.0, 1e6) == 0.0);
    }
}
