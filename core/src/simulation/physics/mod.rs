//! Robots as rigid bodies on the world's triangles, by rapier.
//!
//! The wheels are bodies of their own that roll on the ground with Coulomb friction: skid steering, slip on slopes and
//! tipping follow from that and are not modelled apart. The same world, commands and steps give the same bits.

mod build;
mod config;
mod placement;
#[cfg(test)]
mod tests;

pub use config::{PhysicsConfig, PhysicsError};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::dynamics::{FrictionModel, ImpulseJointHandle, JointAxis, RigidBodyHandle};
use rapier3d::math::{Pose as RapierPose, Vector as RapierVector};
use rapier3d::pipeline::PhysicsWorld;

use self::build::Build;
use super::compiled_scene::CompiledScene;
use super::robot::{Robot, WheelKind};
use crate::geometry::Pose;

/// A robot that leans farther than this lies on its side.
const TIPPED_COS: f64 = 0.5;
/// A robot that is asked to stand and in this time [s] moves and turns by less than this [m, rad] is parked: nothing moves
/// until it is driven. Its brakes and the friction of its tyres would hold it for good; the solver, which knows the friction
/// of moving bodies only, lets it tremble and creep on uneven slopes, by up to 5 mm/s and 12 mrad/s, which would distort every
/// scan. A robot that slides is faster at once.
const PARKED_AFTER_S: f64 = 0.25;
const PARKED_WITHIN: f64 = 6e-3;

/// The bodies of a world and its robots.
pub struct Physics {
    world: PhysicsWorld,
    robots: Vec<RobotBodies>,
    config: PhysicsConfig,
    steps: u64,
    /// Steps for which all robots have been asked to stand, up to now, and where they were when the last of the times began
    /// after which it is looked whether they do.
    idle: u64,
    idle_at: Vec<Pose>,
    parked: bool,
}

/// One robot's bodies.
struct RobotBodies {
    chassis: RigidBodyHandle,
    wheels: Vec<WheelBody>,
    max_speed: f64,
    /// Speeds of the rims of the left and right wheels as last asked for [m/s].
    asked: [f64; 2],
    /// Of each wheel about its axle since the start [rad].
    angles: Vec<f64>,
}

struct WheelBody {
    body: RigidBodyHandle,
    axle: ImpulseJointHandle,
    /// About z, of casters and steered wheels.
    steering: Option<ImpulseJointHandle>,
    kind: WheelKind,
    radius: f64,
    is_left: bool,
}

/// What a robot does at a moment, the truth that its sensors are drawn from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// `map_from_robot`.
    pub pose: Pose,
    /// Velocity of the robot's origin, map frame [m/s].
    pub linear: Vector3<f64>,
    /// Turning, robot frame [rad/s].
    pub angular: Vector3<f64>,
}

impl Physics {
    /// Builds the world's triangles and puts the robots at their starts, upright on the ground.
    ///
    /// # Errors
    /// When a robot starts off the ground or touches something, or has no body or wheel that can be built.
    pub fn new(scene: &CompiledScene, robots: &[Robot], config: PhysicsConfig) -> Result<Self, PhysicsError> {
        config.validate()?;
        let mut world = PhysicsWorld::new();
        world.gravity = RapierVector::new(0.0, 0.0, -(config.gravity as f32));
        world.integration_parameters.dt = config.step as f32;
        world.integration_parameters.num_solver_iterations = config.iterations;
        world.integration_parameters.friction_model = FrictionModel::Coulomb;
        build::add_ground(&mut world, scene, &config)?;
        let mut bodies = Vec::new();
        for (number, robot) in robots.iter().enumerate() {
            let pose = placement::start_pose(scene, robot)?;
            let build = Build { scene, config: &config, groups: build::groups(number) };
            bodies.push(build.robot(&mut world, robot, &pose)?);
        }
        Ok(Self { world, robots: bodies, config, steps: 0, idle: 0, idle_at: Vec::new(), parked: false })
    }

    /// The number of robots.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// Simulated time [s].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.steps as f64 * self.config.step
    }

    /// Sets the speeds of the rims of a robot's left and right driven wheels [m/s], limited to what it can do. A robot
    /// that does not exist is nobody's.
    pub fn drive(&mut self, robot: usize, left: f64, right: f64) {
        let Some(bodies) = self.robots.get_mut(robot) else { return };
        let fastest = bodies.max_speed;
        let asked = [left, right].map(|rim| if rim.is_finite() { rim.clamp(-fastest, fastest) } else { 0.0 });
        if asked != bodies.asked {
            bodies.asked = asked;
            (self.idle, self.parked) = (0, false);
        }
        for wheel in bodies.wheels.iter().filter(|w| matches!(w.kind, WheelKind::Driven | WheelKind::Steered)) {
            let rim = asked[usize::from(!wheel.is_left)];
            if let Some(joint) = self.world.impulse_joints.get_mut(wheel.axle, true) {
                let (speed, gain) = ((rim / wheel.radius) as f32, self.config.motor_gain as f32);
                joint.data.set_motor_velocity(JointAxis::AngX, speed, gain);
            }
        }
    }

    /// Turns a robot's steered wheels to an angle about z [rad].
    pub fn steer(&mut self, robot: usize, angle: f64) {
        let Some(bodies) = self.robots.get(robot) else { return };
        (self.idle, self.parked) = (0, false);
        for wheel in bodies.wheels.iter().filter(|wheel| wheel.kind == WheelKind::Steered) {
            if let Some(joint) = wheel.steering.and_then(|handle| self.world.impulse_joints.get_mut(handle, true)) {
                let gain = self.config.motor_gain as f32;
                joint.data.set_motor_position(JointAxis::AngX, angle as f32, 20.0 * gain, gain);
            }
        }
    }

    /// Lets one step pass.
    pub fn step(&mut self) {
        self.steps += 1;
        if self.is_parked() {
            return;
        }
        self.world.step();
        for robot in 0..self.robots.len() {
            self.turn_wheels(robot);
        }
        self.look_whether_they_stand();
    }

    /// Lets the robots come to rest on their wheels before time begins, for at most this long [s]: one that slides or tips
    /// over at its start is then about to.
    pub fn settle(&mut self, longest_s: f64) {
        let begun = self.steps;
        while !self.is_parked() && ((self.steps - begun) as f64) * self.config.step < longest_s {
            self.step();
        }
        self.steps = begun;
        for robot in &mut self.robots {
            robot.angles.fill(0.0);
        }
    }

    /// Whether all robots have stood long enough to be left alone, with their brakes on, until one is driven: what then
    /// happens is nothing, to the last bit, and takes no time.
    #[must_use]
    pub fn is_parked(&self) -> bool {
        self.parked
    }

    fn look_whether_they_stand(&mut self) {
        if self.robots.iter().any(|robot| robot.asked != [0.0; 2]) {
            self.idle = 0;
            return;
        }
        let steps = ((PARKED_AFTER_S / self.config.step) as u64).max(1);
        if self.idle.is_multiple_of(steps) {
            let poses: Vec<Pose> = (0..self.robots.len()).filter_map(|robot| self.pose(robot)).collect();
            let stands = |(now, then): (&Pose, &Pose)| {
                let moved = then.inverse() * now;
                moved.translation.vector.norm() < PARKED_WITHIN && moved.rotation.angle() < PARKED_WITHIN
            };
            self.parked = self.idle > 0 && poses.iter().zip(&self.idle_at).all(stands);
            self.idle_at = poses;
        }
        self.idle += 1;
    }

    fn pose(&self, robot: usize) -> Option<Pose> {
        Some(pose_from(self.world.bodies.get(self.robots.get(robot)?.chassis)?.position()))
    }

    /// Adds up how far the wheels have turned.
    fn turn_wheels(&mut self, robot: usize) {
        let speeds: Vec<f64> =
            (0..self.robots[robot].wheels.len()).map(|wheel| self.wheel_speed(robot, wheel)).collect();
        let step = self.config.step;
        let bodies = &mut self.robots[robot];
        for (angle, speed) in bodies.angles.iter_mut().zip(&speeds) {
            *angle += step * speed;
        }
    }

    /// Where a robot is and how it moves.
    #[must_use]
    pub fn motion(&self, robot: usize) -> Option<Motion> {
        let body = self.world.bodies.get(self.robots.get(robot)?.chassis)?;
        let pose = pose_from(body.position());
        if self.is_parked() {
            return Some(Motion { pose, linear: Vector3::zeros(), angular: Vector3::zeros() });
        }
        let angular = vector(body.angvel());
        // rapier gives the velocity of the centre of mass.
        let centre = vector(body.center_of_mass());
        let linear = vector(body.linvel()) + angular.cross(&(pose.translation.vector - centre));
        Some(Motion { pose, linear, angular: pose.rotation.inverse() * angular })
    }

    /// Whether a robot lies on its side or its back.
    #[must_use]
    pub fn has_tipped(&self, robot: usize) -> bool {
        self.motion(robot).is_some_and(|motion| (motion.pose.rotation * Vector3::z()).z < TIPPED_COS)
    }

    /// How far each of a robot's wheels has turned about its axle since the start [rad], forwards positive.
    #[must_use]
    pub fn wheel_angles(&self, robot: usize) -> &[f64] {
        self.robots.get(robot).map_or(&[], |bodies| &bodies.angles)
    }

    /// The mean angles of a robot's left and right wheels times their radius: what its encoders add up [m].
    #[must_use]
    pub fn rolled(&self, robot: usize) -> [f64; 2] {
        let mut sums = [(0.0, 0_u32); 2];
        let Some(bodies) = self.robots.get(robot) else { return [0.0; 2] };
        let driven = |wheel: &&WheelBody| matches!(wheel.kind, WheelKind::Driven | WheelKind::Steered);
        for (wheel, angle) in bodies.wheels.iter().zip(&bodies.angles).filter(|(wheel, _)| driven(wheel)) {
            let side = &mut sums[usize::from(!wheel.is_left)];
            *side = (side.0 + angle * wheel.radius, side.1 + 1);
        }
        sums.map(|(sum, count)| sum / f64::from(count.max(1)))
    }

    /// Mechanical power of a robot's motors in the last step [W].
    #[must_use]
    pub fn motor_power(&self, robot: usize) -> f64 {
        let Some(bodies) = self.robots.get(robot) else { return 0.0 };
        let power = bodies.wheels.iter().enumerate().map(|(k, wheel)| {
            let joint = self.world.impulse_joints.get(wheel.axle);
            let motor = joint.and_then(|joint| joint.data.motor(JointAxis::AngX));
            // rapier keeps the impulse of the last of the parts that its iterations cut a step into.
            let part = self.config.step / self.config.iterations as f64;
            let torque = motor.map_or(0.0, |motor| f64::from(motor.impulse) / part);
            (torque * self.wheel_speed(robot, k)).abs()
        });
        power.sum()
    }

    /// Turning speed of a wheel about its axle against the body [rad/s], forwards positive.
    fn wheel_speed(&self, robot: usize, wheel: usize) -> f64 {
        let turning = || {
            let bodies = self.robots.get(robot)?;
            let chassis = self.world.bodies.get(bodies.chassis)?;
            let wheel = self.world.bodies.get(bodies.wheels.get(wheel)?.body)?;
            let axle = pose_from(wheel.position()).rotation * Vector3::y();
            Some((vector(wheel.angvel()) - vector(chassis.angvel())).dot(&axle))
        };
        turning().unwrap_or(0.0)
    }
}

fn vector(v: RapierVector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

fn pose_from(pose: &RapierPose) -> Pose {
    let q = pose.rotation;
    let rotation = Quaternion::new(f64::from(q.w), f64::from(q.x), f64::from(q.y), f64::from(q.z));
    Isometry3::from_parts(Translation3::from(vector(pose.translation)), UnitQuaternion::new_normalize(rotation))
}

fn to_rapier(pose: &Pose) -> RapierPose {
    let (t, q) = (pose.translation.vector.cast::<f32>(), pose.rotation.cast::<f32>());
    let rotation = rapier3d::math::Rotation::from_xyzw(q.i, q.j, q.k, q.w);
    RapierPose::from_parts(RapierVector::new(t.x, t.y, t.z), rotation)
}
