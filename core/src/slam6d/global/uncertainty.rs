//! How well two poses of the map are known relative to each other: an upper bound, at next to no cost.
//!
//! Each node hangs on the tree by the pair that leaves it the least uncertain. Perturbations seen from the map add up
//! along a path, so with L(k) the sum from the root to k, two nodes that part at c have the relative covariance
//! L(a) + L(b) - 2 L(c). Whatever else ties them together only makes them better known. Loop candidates are gated by it.

use nalgebra::Matrix6;

use crate::geometry::{Covariance, Pose, adjoint};

/// The tree of the most certain pairs.
#[derive(Debug, Default)]
pub(crate) struct Uncertainty {
    nodes: Vec<Branch>,
}

#[derive(Debug)]
struct Branch {
    /// Always an earlier node; the root has none.
    parent: Option<usize>,
    /// Sum of the pairs' covariances from the root, perturbations on the left, in the map's frame.
    sum: Covariance,
}

impl Uncertainty {
    /// Hangs the next node on `parent` by a pair with this covariance (on the right, in the node's frame). The first
    /// node is the root.
    pub fn push(&mut self, parent: Option<usize>, map_from_node: &Pose, covariance: &Covariance) {
        let sum = self.through(parent, map_from_node, covariance);
        self.nodes.push(Branch { parent, sum });
    }

    /// Hangs a node on an earlier one if that leaves it less uncertain. Later nodes keep what they have.
    pub fn improve(&mut self, node: usize, parent: usize, map_from_node: &Pose, covariance: &Covariance) {
        let sum = self.through(Some(parent), map_from_node, covariance);
        let inverse = adjoint(&map_from_node.inverse());
        let position = |sum: &Covariance| (inverse * sum * inverse.transpose()).fixed_view::<3, 3>(0, 0).trace();
        if let Some(branch) = self.nodes.get_mut(node)
            && parent < node
            && position(&sum) < position(&branch.sum)
        {
            *branch = Branch { parent: Some(parent), sum };
        }
    }

    fn through(&self, parent: Option<usize>, map_from_node: &Pose, covariance: &Covariance) -> Covariance {
        let carried = adjoint(map_from_node);
        let above = parent.and_then(|k| self.nodes.get(k)).map_or_else(Covariance::zeros, |branch| branch.sum);
        above + carried * covariance * carried.transpose()
    }

    /// An upper bound of the covariance of each pose of `others` relative to `node`, on the right, in the frame of
    /// `node`, and thus also of `other_from_node`.
    pub fn relative_to(&self, node: usize, map_from_node: &Pose, others: &[usize]) -> Vec<Covariance> {
        let mut is_above = vec![false; self.nodes.len()];
        let mut at = Some(node);
        while let Some(k) = at {
            is_above[k] = true;
            at = self.nodes[k].parent;
        }
        let inverse = adjoint(&map_from_node.inverse());
        let sum = self.nodes[node].sum;
        others
            .iter()
            .map(|other| {
                let mut common = *other;
                while let (false, Some(parent)) = (is_above[common], self.nodes[common].parent) {
                    common = parent;
                }
                let relative = sum + self.nodes[*other].sum - 2.0 * self.nodes[common].sum;
                symmetric(&(inverse * relative * inverse.transpose()))
            })
            .collect()
    }

    /// An upper bound of the covariance of a node's pose, on the right, in its own frame.
    pub fn of(&self, node: usize, map_from_node: &Pose) -> Covariance {
        let inverse = adjoint(&map_from_node.inverse());
        self.nodes
            .get(node)
            .map_or_else(Covariance::zeros, |branch| symmetric(&(inverse * branch.sum * inverse.transpose())))
    }
}

/// The symmetric part: differences of large sums wear it off.
fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    0.5 * (matrix + matrix.transpose())
}

/// The largest standard deviations of position [m] and angles [rad] of a covariance.
pub(crate) fn largest_sigmas(covariance: &Covariance) -> (f64, f64) {
    let largest = |at: usize| {
        let block: nalgebra::Matrix3<f64> = covariance.fixed_view::<3, 3>(at, at).into();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    };
    (largest(0), largest(3))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const PAIR: f64 = 1e-4;

    /// A straight chain of `count` nodes, 2 m apart.
    fn chain(count: usize) -> (Uncertainty, Vec<Pose>) {
        let poses: Vec<Pose> = (0..count).map(|k| Pose::translation(2.0 * k as f64, 0.0, 0.0)).collect();
        let mut uncertainty = Uncertainty::default();
        for (k, pose) in poses.iter().enumerate() {
            let covariance = if k == 0 { Covariance::zeros() } else { Covariance::identity() * PAIR };
            uncertainty.push(k.checked_sub(1), pose, &covariance);
        }
        (uncertainty, poses)
    }

    #[test]
    fn along_a_chain_it_is_what_the_pairs_between_add_up_to() {
        let (uncertainty, poses) = chain(6);
        let found = uncertainty.relative_to(5, &poses[5], &[5, 4, 2]);
        assert!(found[0].norm() < 1e-12);
        assert!((found[1] - Covariance::identity() * PAIR).norm() < 1e-12);
        // Three pairs: three times along the chain; across, the turns of those before act over 2 m and 4 m.
        assert!((found[2][(0, 0)] - 3.0 * PAIR).abs() < 1e-12);
        assert!((found[2][(1, 1)] - (3.0 + 4.0 + 16.0) * PAIR).abs() < 1e-12, "{}", found[2]);
        assert!((uncertainty.of(5, &poses[5])[(0, 0)] - 5.0 * PAIR).abs() < 1e-12);
    }

    #[test]
    fn a_closed_loop_makes_the_node_as_certain_as_its_partner() {
        let (mut uncertainty, mut poses) = chain(20);
        poses[19] = Pose::new(Vector3::new(1.0, 0.5, 0.0), Vector3::z());
        uncertainty.improve(19, 1, &poses[19], &(Covariance::identity() * PAIR));
        let near = uncertainty.relative_to(19, &poses[19], &[1, 10]);
        assert!((near[0] - Covariance::identity() * PAIR).norm() < 1e-12, "{}", near[0]);
        assert!(near[1][(0, 0)] > 9.0 * PAIR, "through node 1 it is as far as from there");
        let before = uncertainty.of(19, &poses[19]);
        uncertainty.improve(19, 18, &poses[19], &Covariance::identity());
        assert_eq!(uncertainty.of(19, &poses[19]), before, "a worse pair is not taken");
    }

    #[test]
    fn the_largest_standard_deviations_are_found_in_any_direction() {
        let turned = Pose::new(Vector3::zeros(), Vector3::new(0.3, -0.2, 0.9));
        let carried = adjoint(&turned);
        let diagonal = Covariance::from_diagonal(&nalgebra::Vector6::new(0.01, 4.0, 0.02, 0.09, 0.01, 0.0));
        let (metres, radians) = largest_sigmas(&(carried * diagonal * carried.transpose()));
        assert!((metres - 2.0).abs() < 1e-9 && (radians - 0.3).abs() < 1e-9);
    }
}
