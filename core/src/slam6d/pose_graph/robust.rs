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
/// Steps after which the weights are questioned: with false closures it would take long to converge and lead nowhere.
pub(super) const FIRST_ITERATIONS: u32 = 12;
/// How often the final weights may be corrected.
pub(super) const MOST_CORRECTIONS: u32 = 10;

/// The indices of the robust edges.
fn closures<'a>(problem: &Problem<'a>) -> impl Iterator<Item = usize> + use<'a> {
    problem.edges.iter().enumerate().filter(|(_, edge)| edge.kind == EdgeKind::LoopClosure).map(|(index, _)| index)
}

/// Whether the weight of a loop closure is not what its residual says.
pub(super) fn is_contradicted(problem: &Problem<'_>, gate: f64) -> bool {
    closures(problem).any(|edge| (problem.chi2(edge) <= gate) != (problem.weights[edge] == 1.0))
}

/// Gives each loop closure the weight that its residual says: 1 within the gate, else 0.
pub(super) fn decide(problem: &mut Problem<'_>, gate: f64) {
    for edge in closures(problem) {
        problem.weights[edge] = if problem.chi2(edge) <= gate { 1.0 } else { 0.0 };
    }
}

/// Sharpens the surrogate from convex to truncated least squares, with one step of the poses at each sharpness.
pub(super) fn graduate(
    problem: &mut Problem<'_>,
    workspace: &mut Workspace,
    config: &PoseGraphConfig,
    walk: &mut Walk,
) {
    let gate = config.closure_gate;
    let worst = closures(problem).map(|edge| problem.chi2(edge)).fold(0.0, f64::max);
    if worst <= gate {
        return;
    }
    let mut sharpness = gate / (2.0 * worst - gate);
    for _ in 0..MOST_SHARPENINGS {
        let mut undecided = 0;
        for edge in closures(problem) {
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
