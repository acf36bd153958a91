//! Point to plane with damped steps (Levenberg 1944): the step is ours, keyframes and evidence are mirador's.
//!
//! A keyframe is mirador's own [`PreparedCloud`]: points, their planes, and a search for the nearest. What a pose is worth
//! (overlap, residual, cost, covariance, which directions the geometry constrains) is asked of a built-in method with 0
//! iterations, which only judges the start. So a method of your own need not be more than its step.

use mirador::Registry;
use mirador_core::geometry::{Pose, exp, rotation_angle};
use mirador_core::registration::{
    AlignError, Alignment, Limits, PrepareError, PreparedCloud, PreparedScan, Registration, RegistrationConfig,
};
use mirador_core::scan::ScanView;
use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector3, Vector6};

/// The method.
pub struct Damped {
    config: RegistrationConfig,
    /// Added to the diagonal of the normal equations, as a share of it.
    damping: f64,
    judge: Box<dyn Registration>,
}

impl Damped {
    /// The method with these settings; `method.custom.damping` is its own.
    pub fn new(config: &RegistrationConfig) -> Self {
        let damping = config.custom.get("damping").and_then(|value| value.as_float()).unwrap_or(1e-3);
        let judge = Registry::default().create("point_to_plane", config);
        Self { config: config.clone(), damping, judge: judge.expect("a built-in method, settings checked before") }
    }

    /// The step from `pose` by the pairs within `gate_m`: every source point with the plane of its nearest neighbour.
    fn step(&self, target: &PreparedCloud, source: &PreparedCloud, pose: &Pose, gate_m: f64) -> Option<Vector6<f64>> {
        let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for point in source.points() {
            let arm = Vector3::from(point.map(f64::from));
            let seen = pose * Point3::from(arm);
            let query = [seen.x as f32, seen.y as f32, seen.z as f32];
            let Some((index, _)) = target.nearest(query, (gate_m * gate_m) as f32) else { continue };
            let Some((normal, offset)) = target.plane(index as usize) else { continue };
            let normal = Vector3::from(normal.map(f64::from));
            let residual = normal.dot(&seen.coords) - f64::from(offset);
            // The perturbation acts on the right: in the source's axes, about its scanner.
            let normal = pose.rotation.inverse() * normal;
            let turn = arm.cross(&normal);
            let row = Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z);
            let weight = 1.0 / (1.0 + (residual / self.config.robust_scale_m).powi(2));
            hessian += row * row.transpose() * weight;
            gradient += row * residual * weight;
        }
        for k in 0..6 {
            hessian[(k, k)] *= 1.0 + self.damping;
            hessian[(k, k)] += 1e-9;
        }
        (hessian.trace() > 1e-6).then(|| hessian.cholesky().map(|factor| -factor.solve(&gradient)))?
    }
}

impl Registration for Damped {
    fn name(&self) -> &str {
        "damped"
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        Ok(Box::new(PreparedCloud::new(scan, &self.config)?))
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let only_judge = Limits { max_iterations: 0, ..*limits };
        let start = initial_target_from_source;
        // This also refuses what makes no sense: foreign scans, a start that is not finite, limits out of range.
        let mut best = self.judge.align(target, source, start, &only_judge)?;
        let (target_cloud, source_cloud) = (own(target, "target")?, own(source, "source")?);
        let (mut pose, mut gate_m) = (*start, limits.pair_distance_m);
        let (mut iterations, mut settled, mut limited) = (0, false, false);
        let mut constraint = best.constraint;
        while iterations < limits.max_iterations && !settled && !limited {
            let Some(step) = self.step(target_cloud, source_cloud, &pose, gate_m) else { break };
            // What the geometry leaves open keeps the start.
            let step = constraint.project(&step);
            (pose, limited) = within(limits, start, &(pose * exp(&step)));
            iterations += 1;
            let is_small = step.fixed_rows::<3>(0).norm() < self.config.translation_tolerance_m
                && step.fixed_rows::<3>(3).norm() < self.config.rotation_tolerance;
            settled = is_small && gate_m <= self.config.final_pair_distance_m;
            gate_m = (0.7 * gate_m).max(self.config.final_pair_distance_m.min(limits.pair_distance_m));
            let judged = self.judge.align(target, source, &pose, &only_judge)?;
            constraint = judged.constraint;
            if judged.cost <= best.cost {
                best = judged;
            }
        }
        let converged = settled && !limited;
        Ok(Alignment { iterations, converged, limit_reached: limited, ..best })
    }
}

/// The prepared scan as our own type.
fn own<'a>(scan: &'a dyn PreparedScan, role: &'static str) -> Result<&'a PreparedCloud, AlignError> {
    let foreign = || AlignError::ForeignScan { method: "damped".into(), role };
    scan.as_any().downcast_ref().ok_or_else(foreign)
}

/// The pose, or the one on the border of the limits on the way to it; whether that was needed.
fn within(limits: &Limits, start: &Pose, pose: &Pose) -> (Pose, bool) {
    let mut moved = start.inverse() * pose;
    let (metres, radians) = (moved.translation.vector.norm(), rotation_angle(&moved));
    let (far, turned) = (metres > limits.max_translation_m, radians > limits.max_rotation);
    if far {
        moved.translation.vector *= limits.max_translation_m / metres;
    }
    if turned {
        let axis = moved.rotation.scaled_axis();
        moved.rotation = UnitQuaternion::from_scaled_axis(axis * (limits.max_rotation / radians));
    }
    if far || turned { (start * moved, true) } else { (*pose, false) }
}
