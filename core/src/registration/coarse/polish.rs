//! From a pose on the lattice to the nearest one where surfaces lie on surfaces.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::CoarseScan;
use crate::geometry::{self, Pose};

/// Pair distances of the passes, in cells: wide while the pose is that of a lattice.
const GATES: [f32; 12] = [3.0, 3.0, 3.0, 2.0, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0, 1.0];
/// Normals that differ by more do not belong to one surface (cosine).
const LEAST_COSINE: f64 = 0.6;
/// The residual at which a pair begins to lose weight, as a share of the pair distance.
const SCALE: f64 = 0.2;
/// Fewer pairs than this move nothing.
const LEAST_PAIRS: usize = 20;
/// A pass that moves less ends the passes of its gate [m] and [rad] together.
const SETTLED: f64 = 2e-3;

/// Moves `start` by Gauss-Newton steps on the distances of the source's chosen points to the target's planes.
pub(super) fn polish(target: &CoarseScan, source: &CoarseScan, start: &Pose, cell_m: f64) -> Pose {
    let mut pose = *start;
    let mut settled_at = 0.0_f32;
    for gate in GATES {
        if gate == settled_at {
            continue;
        }
        let Some(step) = step(target, source, &pose, f64::from(gate) * cell_m) else { return pose };
        pose *= geometry::exp(&step);
        pose.rotation.renormalize();
        if step.norm() < SETTLED {
            settled_at = gate;
        }
    }
    pose
}

/// One step, a perturbation on the right.
fn step(target: &CoarseScan, source: &CoarseScan, pose: &Pose, gate_m: f64) -> Option<Vector6<f64>> {
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let (mut hessian, mut gradient, mut pairs) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros(), 0);
    let scale = SCALE * gate_m;
    for index in source.sample() {
        let index = *index as usize;
        let (Some(point), Some(own)) = (source.points().get(index), source.normals().get(index)) else { continue };
        let p = Vector3::from(point.map(f64::from));
        let moved = rotation * p + pose.translation.vector;
        let Some((near, _)) =
            target.tree().nearest([moved.x as f32, moved.y as f32, moved.z as f32], (gate_m * gate_m) as f32)
        else {
            continue;
        };
        let normal = Vector3::from(target.normals()[near as usize].map(f64::from));
        let own = rotation * Vector3::from(own.map(f64::from));
        // A point without a normal has the normal zero and fails here too.
        if normal.dot(&own) < LEAST_COSINE {
            continue;
        }
        let residual = normal.dot(&(moved - Vector3::from(target.points()[near as usize].map(f64::from))));
        let ratio = residual / scale;
        let weight = 1.0 / (1.0 + ratio * ratio);
        let in_source = rotation.tr_mul(&normal);
        let lever = p.cross(&in_source);
        let row = Vector6::new(in_source.x, in_source.y, in_source.z, lever.x, lever.y, lever.z);
        hessian += weight * row * row.transpose();
        gradient += weight * residual * row;
        pairs += 1;
    }
    if pairs < LEAST_PAIRS {
        return None;
    }
    // A little damping keeps still what the pairs do not determine.
    let damped = hessian + Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 50.0, 50.0, 50.0)) * 1e-3 * pairs as f64;
    damped.cholesky().map(|factor| -factor.solve(&gradient)).filter(|step| step.iter().all(|v| v.is_finite()))
}
