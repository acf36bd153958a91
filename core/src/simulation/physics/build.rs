//! The bodies of the world and of a robot.

use nalgebra::{Translation3, Vector3};
use rapier3d::dynamics::{MassProperties, MotorModel, RevoluteJointBuilder, RigidBodyBuilder, RigidBodyHandle};
use rapier3d::geometry::{ColliderBuilder, Group, InteractionGroups, InteractionTestMode, TriMeshFlags};
use rapier3d::math::Vector;
use rapier3d::pipeline::PhysicsWorld;

use super::placement::place;
use super::{PhysicsConfig, PhysicsError, RobotBodies, WheelBody, to_rapier};
use crate::geometry::Pose;
use crate::simulation::compiled_scene::CompiledScene;
use crate::simulation::robot::{Robot, Wheel, WheelKind};

/// Mass of a wheel, and of the fork of one that turns about z [kg].
const WHEEL_KG: f32 = 2.5;
const FORK_KG: f32 = 1.0;
/// Wheels have round rims of this radius [m].
const RIM_M: f64 = 0.01;
/// Of the body on what it touches.
const BODY_FRICTION: f32 = 0.4;

/// The ground and all that stands on it, as one mesh of triangles that face outwards.
pub(super) fn add_ground(
    world: &mut PhysicsWorld,
    scene: &CompiledScene,
    config: &PhysicsConfig,
) -> Result<(), PhysicsError> {
    let fail = |error: &dyn std::fmt::Display| PhysicsError::World {
        scene: scene.scene().name.clone(),
        reason: error.to_string(),
    };
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (corners, _) in scene.labelled_triangles() {
        let first = vertices.len() as u32;
        vertices.extend(corners.map(|v| vector(&v)));
        triangles.push([first, first + 1, first + 2]);
    }
    // A wheel must not trip over the edge between two triangles of one plane.
    let flags = TriMeshFlags::FIX_INTERNAL_EDGES;
    let ground = ColliderBuilder::trimesh_with_flags(vertices, triangles, flags).map_err(|error| fail(&error))?;
    world.insert_collider(ground.friction(config.friction as f32), None);
    Ok(())
}

/// What all parts of a robot are built with.
pub(super) struct Build<'a> {
    pub(super) scene: &'a CompiledScene,
    pub(super) config: &'a PhysicsConfig,
    pub(super) groups: InteractionGroups,
}

/// The parts of a robot do not touch one another, but everything else. Robots share a group only beyond thirty.
pub(super) fn groups(robot: usize) -> InteractionGroups {
    let own = Group::from_bits_truncate(2_u32 << (robot % 30));
    InteractionGroups::new(own, !own, InteractionTestMode::And)
}

impl Build<'_> {
    /// The bodies and joints of a robot.
    pub(super) fn robot(
        &self,
        world: &mut PhysicsWorld,
        robot: &Robot,
        map_from_robot: &Pose,
    ) -> Result<RobotBodies, PhysicsError> {
        let fail = |reason| {
            let (place, robot) = (place(self.scene, robot), robot.name.clone());
            PhysicsError::Body { place, robot, reason }
        };
        if robot.wheels.is_empty() {
            return Err(fail("it has no wheels"));
        }
        let chassis = RigidBodyBuilder::dynamic()
            .pose(to_rapier(map_from_robot))
            .additional_mass_properties(chassis_mass(robot))
            .can_sleep(false)
            .build();
        let chassis = world.insert_body(chassis);
        let mut solids = Vec::new();
        for part in &robot.boxes {
            let [hx, hy, hz] = part.size.map(|side| 0.5 * side as f32);
            let at = to_rapier(&Pose::from_parts(Translation3::from(part.centre), nalgebra::one()));
            solids.push(ColliderBuilder::cuboid(hx, hy, hz).position(at));
        }
        if let Some(mesh) = &robot.mesh {
            let points: Vec<_> = mesh.vertices().iter().map(|v| vector(&Vector3::from(*v))).collect();
            let hull = ColliderBuilder::convex_hull(&points);
            solids.push(hull.ok_or_else(|| fail("its mesh has no convex hull; it needs a volume"))?);
        }
        for solid in solids {
            let solid = solid.density(0.0).friction(BODY_FRICTION).collision_groups(self.groups);
            world.insert_collider(solid, Some(chassis));
        }
        let mut wheels = Vec::new();
        for wheel in &robot.wheels {
            if wheel.radius <= 2.0 * RIM_M || wheel.width <= 2.0 * RIM_M {
                return Err(fail("a wheel's radius_m and width_m must be above 0.02"));
            }
            wheels.push(self.wheel(world, chassis, wheel, map_from_robot));
        }
        let angles = vec![0.0; wheels.len()];
        Ok(RobotBodies { chassis, wheels, max_speed: robot.max_speed, asked: [0.0; 2], angles })
    }

    fn wheel(
        &self,
        world: &mut PhysicsWorld,
        chassis: RigidBodyHandle,
        wheel: &Wheel,
        map_from_robot: &Pose,
    ) -> WheelBody {
        let mount = Vector3::from(wheel.mount);
        let turns = matches!(wheel.kind, WheelKind::Caster | WheelKind::Steered);
        let trail = if wheel.kind == WheelKind::Caster { -0.5 * wheel.radius } else { 0.0 };
        let middle = map_from_robot * Translation3::from(mount + Vector3::new(trail, 0.0, 0.0));
        let body = world.insert_body(RigidBodyBuilder::dynamic().pose(to_rapier(&middle)).can_sleep(false).build());
        let (half, radius) = ((0.5 * wheel.width - RIM_M) as f32, (wheel.radius - RIM_M) as f32);
        let collider = ColliderBuilder::round_cylinder(half, radius, RIM_M as f32)
            .mass(WHEEL_KG)
            .friction(self.config.friction as f32)
            .collision_groups(self.groups);
        world.insert_collider(collider, Some(body));

        let gain = self.config.motor_gain as f32;
        let (holder, anchor, steering) = if turns {
            let pose = to_rapier(&(map_from_robot * Translation3::from(mount)));
            let mass = MassProperties::new(Vector::ZERO, FORK_KG, Vector::splat(0.02));
            let fork = RigidBodyBuilder::dynamic().pose(pose).additional_mass_properties(mass).can_sleep(false);
            let fork = world.insert_body(fork.build());
            let mut joint = RevoluteJointBuilder::new(Vector::Z).local_anchor1(vector(&mount)).contacts_enabled(false);
            if wheel.kind == WheelKind::Steered {
                joint = joint.motor_model(MotorModel::ForceBased).motor_position(0.0, 20.0 * gain, gain);
            }
            let steering = world.insert_impulse_joint(chassis, fork, joint);
            (fork, Vector3::new(trail, 0.0, 0.0), Some(steering))
        } else {
            (chassis, mount, None)
        };
        let mut axle = RevoluteJointBuilder::new(Vector::Y).local_anchor1(vector(&anchor)).contacts_enabled(false);
        if matches!(wheel.kind, WheelKind::Driven | WheelKind::Steered) {
            axle = axle
                .motor_model(MotorModel::ForceBased)
                .motor_velocity(0.0, gain)
                .motor_max_force(self.config.motor_torque as f32);
        }
        let axle = world.insert_impulse_joint(holder, body, axle);
        WheelBody { body, axle, steering, kind: wheel.kind, radius: wheel.radius, is_left: wheel.mount[1] > 0.0 }
    }
}

/// The mass of all but the wheels: a cuboid of the body's length and width.
fn chassis_mass(robot: &Robot) -> MassProperties {
    let mut size = [0.3_f64, 0.3, 0.3];
    for part in &robot.boxes {
        for (largest, side) in size.iter_mut().zip(part.size) {
            *largest = largest.max(side);
        }
    }
    let mass = robot.mass as f32;
    let [x, y, z] = size.map(|side| (side * side) as f32);
    let inertia = Vector::new(y + z, x + z, x + y) * (mass / 12.0);
    MassProperties::new(Vector::new(0.0, 0.0, robot.mass_height as f32), mass, inertia)
}

fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}
