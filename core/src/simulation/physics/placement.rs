//! Where robots start.

use nalgebra::Vector3;
use parry3d::math::{Pose as ParryPose, Vector};
use parry3d::query;
use parry3d::shape::{Cuboid, Triangle};

use super::{PhysicsError, to_rapier};
use crate::geometry::Pose;
use crate::simulation::compiled_scene::CompiledScene;
use crate::simulation::robot::Robot;

/// How far over the ground robots are set down [m].
const DROP_M: f64 = 0.02;
/// What rises less over the ground is driven over, not started in [m].
const CLEARANCE_M: f64 = 0.1;
/// No robot is larger [m].
const FAR_M: f64 = 5.0;

/// File and line of a robot, as errors begin with.
pub(super) fn place(scene: &CompiledScene, robot: &Robot) -> String {
    if robot.line == 0 { String::new() } else { format!("{}, line {}: ", scene.scene().origin.file, robot.line) }
}

/// The pose `map_from_robot` at a robot's start: on the ground, leaning as it does.
pub(super) fn start_pose(scene: &CompiledScene, robot: &Robot) -> Result<Pose, PhysicsError> {
    let (x, y) = (robot.start.x, robot.start.y);
    let span = robot.wheels.iter().map(|w| w.mount[0].hypot(w.mount[1])).fold(0.3, f64::max);
    let pose = scene.leaning_scanner_pose(&robot.start, DROP_M, span * std::f64::consts::SQRT_2);
    let pose =
        pose.ok_or_else(|| PhysicsError::OffTerrain { place: place(scene, robot), robot: robot.name.clone(), x, y })?;
    let solids = solids(robot);
    for (corners, label) in scene.object_triangles() {
        if is_far(&corners, x, y) {
            continue;
        }
        let [a, b, c] = corners.map(|v: Vector3<f64>| Vector::new(v.x as f32, v.y as f32, v.z as f32));
        let triangle = Triangle::new(a, b, c);
        for (size, centre) in &solids {
            let at = to_rapier(&(pose * nalgebra::Translation3::from(*centre)));
            let half = 0.5 * size;
            let cuboid = Cuboid::new(Vector::new(half.x as f32, half.y as f32, half.z as f32));
            // Shapes that cannot be compared do not occur here; they would count as apart.
            if query::intersection_test(&at, &cuboid, &ParryPose::IDENTITY, &triangle).is_ok_and(|met| met.intersecting)
            {
                let (place, robot) = (place(scene, robot), robot.name.clone());
                return Err(PhysicsError::Touches { place, robot, x, y, label });
            }
        }
    }
    Ok(pose)
}

/// Whether a triangle lies well beyond any robot at (x, y).
fn is_far(corners: &[Vector3<f64>; 3], x: f64, y: f64) -> bool {
    let beyond = |axis: usize, at: f64| {
        corners.iter().all(|v| v[axis] > at + FAR_M) || corners.iter().all(|v| v[axis] < at - FAR_M)
    };
    beyond(0, x) || beyond(1, y)
}

/// Sizes and middles of boxes around all parts of a robot that are higher than what it drives over [m].
fn solids(robot: &Robot) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let mut solids: Vec<_> =
        robot.boxes.iter().map(|part| (Vector3::from(part.size), Vector3::from(part.centre))).collect();
    solids.extend(robot.wheels.iter().map(|wheel| {
        let low = wheel.mount[2] - wheel.radius + CLEARANCE_M;
        let high = (wheel.mount[2] + wheel.radius).max(low + 1e-3);
        let size = Vector3::new(2.0 * wheel.radius, wheel.width, high - low);
        (size, Vector3::new(wheel.mount[0], wheel.mount[1], 0.5 * (low + high)))
    }));
    if let Some(mesh) = &robot.mesh {
        let [low, high] = mesh.bounds().map(Vector3::from);
        solids.push((high - low, 0.5 * (low + high)));
    }
    solids
}
