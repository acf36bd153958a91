//! Multi-scan relaxation, the source's global relaxation (section 3, step 5): every scan against all others that
//! overlap it at once, point pairs found again in each round, until no scan moves any more.
//!
//! After Lu and Milios (1997) and its form in six degrees of freedom (Borrmann, Elseberg, Lingemann, Nuechter, Hertzberg
//! 2008), with two changes. The distance is that of a point to the tangent plane of its partner with a robust weight,
//! which converges in fewer rounds and is not biased along surfaces. And the pairs are not condensed to a measured
//! motion with a covariance first: their normal equations go straight into the sparse system of all poses, so that a
//! round is one Gauss-Newton step on all points of all scans.

mod config;
mod pairs;
#[cfg(test)]
mod tests;

pub use config::RelaxationConfig;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::pose_graph::solver::{OutOfMemory, SIZE, SparseSolver, Structure, Terms};
use crate::geometry::{Pose, Twist, exp};
use crate::registration::{ConfigError, PreparedCloud};
use crate::threads;
use pairs::{Round, ScanPair};

/// A gate is halved once the scans move less than this share of it.
const SETTLED_SHARE: f64 = 0.2;
/// Rotations are weighed against distances by the motion of a point so far away [m].
const ARM_M: f64 = 10.0;
/// Damping of directions that no pair constrains, as a share of the diagonal.
const DAMPING: f64 = 1e-6;

/// What a relaxation did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Relaxation {
    /// Rounds of finding pairs and moving scans.
    pub rounds: u32,
    /// The last round moved no scan farther than the tolerances.
    pub converged: bool,
    /// The pairs of scans that overlap.
    pub scan_pairs: usize,
    /// The root of the mean squared distance to the partner's plane, each cut off at the robust scale, before [m].
    pub residual_before_m: f64,
    /// The same in the last round [m].
    pub residual_m: f64,
    /// How far the scan moved that moved farthest in all [m].
    pub largest_translation_m: f64,
}

/// Why a relaxation is not possible.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RelaxationError {
    /// The settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// There is not one pose for each scan.
    #[error("{scans} scans with {poses} poses; each scan needs one")]
    Count {
        /// Scans given.
        scans: usize,
        /// Poses given.
        poses: usize,
    },
    /// A pose holds a value that is not finite.
    #[error("the pose of scan {scan} holds a value that is not finite")]
    NotFinite {
        /// The scan.
        scan: usize,
    },
    /// The equations do not fit into memory.
    #[error("the equations of {scans} scans do not fit into memory")]
    OutOfMemory {
        /// The scans.
        scans: usize,
    },
}

/// Moves all scans but the first to where they fit each other best; scans that overlap no other stay.
///
/// # Errors
/// [`RelaxationError`]; the poses are as before.
pub fn relax(
    scans: &[&PreparedCloud],
    poses: &mut [Pose],
    config: &RelaxationConfig,
) -> Result<Relaxation, RelaxationError> {
    config.validate()?;
    if scans.len() != poses.len() {
        return Err(RelaxationError::Count { scans: scans.len(), poses: poses.len() });
    }
    let is_finite = |pose: &Pose| pose.to_homogeneous().iter().all(|value| value.is_finite());
    if let Some(scan) = poses.iter().position(|pose| !is_finite(pose)) {
        return Err(RelaxationError::NotFinite { scan });
    }
    let before = poses.to_vec();
    let mut walk = Walk::new(scans, poses, config).map_err(|_| RelaxationError::OutOfMemory { scans: scans.len() })?;
    while !walk.converged && walk.rounds < config.max_rounds && !walk.pairs.is_empty() {
        walk.round(scans, poses, config);
    }
    let moved = before.iter().zip(&*poses).map(|(a, b)| (b.translation.vector - a.translation.vector).norm());
    Ok(Relaxation {
        rounds: walk.rounds,
        converged: walk.converged || walk.pairs.is_empty(),
        scan_pairs: walk.pairs.len(),
        residual_before_m: walk.first_residual_m,
        residual_m: walk.residual_m,
        largest_translation_m: moved.fold(0.0, f64::max),
    })
}

/// Where a relaxation stands.
struct Walk {
    pairs: Vec<ScanPair>,
    solver: SparseSolver,
    gate_m: f64,
    rounds: u32,
    converged: bool,
    first_residual_m: f64,
    residual_m: f64,
}

impl Walk {
    /// Pairs the scans that are near each other and keeps those pairs that overlap.
    fn new(scans: &[&PreparedCloud], poses: &[Pose], config: &RelaxationConfig) -> Result<Self, OutOfMemory> {
        let gate_m = config.first_pair_distance_m;
        let mut pairs = near_pairs(poses, config.max_distance_m);
        find_all(&mut pairs, scans, poses, gate_m, config);
        pairs.retain(|pair| pair.sum.overlap >= config.min_overlap);
        // Of each group of scans that hang together, the first is held.
        let mut is_free = vec![false; scans.len()];
        let mut components = super::pose_graph::solver::Components::default();
        scans.iter().for_each(|_| components.add());
        pairs.iter().for_each(|pair| components.join(pair.target, pair.source));
        is_free.iter_mut().enumerate().for_each(|(scan, is_free)| *is_free = components.first_of(scan) != scan);
        let solver = SparseSolver::new(Structure::new(pairs.iter().map(|p| (p.target, p.source)), &is_free)?)?;
        let residual_m = residual_of(&pairs);
        Ok(Self { pairs, solver, gate_m, rounds: 0, converged: false, first_residual_m: residual_m, residual_m })
    }

    /// Finds the pairs of points anew, but for the first round, for which it is done, and moves the scans.
    fn round(&mut self, scans: &[&PreparedCloud], poses: &mut [Pose], config: &RelaxationConfig) {
        if self.rounds > 0 {
            find_all(&mut self.pairs, scans, poses, self.gate_m, config);
            self.residual_m = residual_of(&self.pairs);
        }
        self.rounds += 1;
        self.solver.clear();
        for (k, pair) in self.pairs.iter().enumerate() {
            let target_from_source = poses[pair.target].inverse() * poses[pair.source];
            let terms = Terms::of_motion(&target_from_source, pair.sum.hessian, pair.sum.gradient);
            self.solver.add(k, (pair.target, pair.source), &terms);
        }
        if !self.solver.solve(DAMPING) {
            self.converged = true;
            return;
        }
        let (mut shift, mut turn) = (0.0_f64, 0.0_f64);
        for (node, step) in self.solver.structure.order.iter().zip(self.solver.step.chunks_exact(SIZE)) {
            let step = Twist::from_column_slice(step);
            shift = shift.max(step.fixed_rows::<3>(0).norm());
            turn = turn.max(step.fixed_rows::<3>(3).norm());
            poses[*node] *= exp(&step);
            poses[*node].rotation.renormalize();
        }
        if self.gate_m <= config.final_pair_distance_m {
            self.converged = shift < config.translation_tolerance_m && turn < config.rotation_tolerance;
        } else if shift + turn * ARM_M < SETTLED_SHARE * self.gate_m {
            self.gate_m = (0.5 * self.gate_m).max(config.final_pair_distance_m);
        }
    }
}

/// The pairs of scans whose scanners stood near each other. Which of the two lends its planes alternates, so that no
/// scan is always the one that is moved onto the others' planes.
fn near_pairs(poses: &[Pose], max_distance_m: f64) -> Vec<ScanPair> {
    let position = |k: usize| poses[k].translation.vector;
    let all = (0..poses.len()).flat_map(|i| (i + 1..poses.len()).map(move |j| (i, j)));
    let near = all.filter(|(i, j)| (position(*i) - position(*j)).norm() <= max_distance_m);
    near.map(|(i, j)| if (i + j) % 2 == 0 { ScanPair::new(j, i) } else { ScanPair::new(i, j) }).collect()
}

/// Finds the point pairs of all pairs of scans.
fn find_all(pairs: &mut [ScanPair], scans: &[&PreparedCloud], poses: &[Pose], gate_m: f64, config: &RelaxationConfig) {
    let scale_m = config.robust_scale_m * gate_m / config.final_pair_distance_m;
    let round = Round { gate_m, scale_m };
    threads::for_each(pairs.iter_mut(), config.threads, |pair| {
        let target_from_source = poses[pair.target].inverse() * poses[pair.source];
        pair.find(scans[pair.target], scans[pair.source], &target_from_source, &round, config);
    });
}

/// The root mean square of the cut-off distances over all pairs [m].
fn residual_of(pairs: &[ScanPair]) -> f64 {
    let (cost, points) = pairs
        .iter()
        .fold((0.0, 0.0), |(cost, points), pair| (cost + pair.sum.cost, points + f64::from(pair.sum.points)));
    (cost / f64::max(points, 1.0)).sqrt()
}
