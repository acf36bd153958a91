//! The whole robot in its world: physics and sensors, step by step in simulated time.

mod readings;
mod rig;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use self::readings::{PlanarSweep, Readings};
use self::rig::{Clock, Rig};
use super::camera::{Camera, Image};
use super::compiled_scene::CompiledScene;
use super::physics::{Motion, Physics, PhysicsConfig, PhysicsError};
use super::robot::{Robot, SensorKind};
use super::sensors::{RangerMount, SensorsConfig, TurningLaserError};
use crate::geometry::Pose;

/// The robots have stood at their starts for up to this long when time begins [s].
const SETTLE_S: f64 = 5.0;

/// What a world is simulated with.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatorConfig {
    /// What all sensors' errors are drawn from.
    pub seed: u64,
    /// Physics.
    pub physics: PhysicsConfig,
    /// Sensors other than lasers and cameras, which the world file describes.
    pub sensors: SensorsConfig,
}

/// Why a world cannot be simulated.
#[derive(Debug, Error)]
pub enum SimulatorError {
    /// The physics cannot be built.
    #[error(transparent)]
    Physics(#[from] PhysicsError),
    /// A laser cannot turn as it is asked to.
    #[error("robot `{robot}`, sensor `{sensor}`: {source}")]
    Laser {
        /// The robot's name.
        robot: String,
        /// The sensor's name.
        sensor: String,
        /// Why.
        source: TurningLaserError,
    },
    /// There is no robot of this number.
    #[error("there is no robot {robot}; this world has {robots}")]
    NoRobot {
        /// Asked for, from 0.
        robot: usize,
        /// How many there are.
        robots: usize,
    },
    /// The robot has no sensor of this name and kind.
    #[error("robot `{robot}` has no {kind} called `{sensor}`")]
    NoSensor {
        /// The robot's name.
        robot: String,
        /// What was asked for.
        kind: &'static str,
        /// Its name.
        sensor: String,
    },
}

/// A world with its robots. The same world, config and commands give the same bits.
pub struct Simulator {
    scene: CompiledScene,
    physics: Physics,
    config: SimulatorConfig,
    robots: Vec<Rig>,
}

impl Simulator {
    /// Puts the world's robots at their starts, at rest; the source's robot at the world's start when the file names none.
    ///
    /// # Errors
    /// When a robot cannot stand where it starts, or one of its parts cannot be built.
    pub fn new(scene: CompiledScene, config: SimulatorConfig) -> Result<Self, SimulatorError> {
        let usual = [Robot { start: scene.scene().start, ..Robot::default() }];
        let named = &scene.scene().robots;
        let robots = if named.is_empty() { usual.to_vec() } else { named.clone() };
        let mut physics = Physics::new(&scene, &robots, config.physics)?;
        physics.settle(SETTLE_S);
        let rigs = robots.into_iter().enumerate().map(|(number, robot)| Rig::new(robot, number as u64, &config));
        let robots = rigs.collect::<Result<_, _>>()?;
        Ok(Self { scene, physics, config, robots })
    }

    /// The world.
    #[must_use]
    pub fn scene(&self) -> &CompiledScene {
        &self.scene
    }

    /// The robots as described.
    pub fn robots(&self) -> impl Iterator<Item = &Robot> {
        self.robots.iter().map(|rig| &rig.robot)
    }

    /// Simulated time [s].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.physics.time()
    }

    /// The true motion of a robot, which no client is told.
    #[must_use]
    pub fn truth(&self, robot: usize) -> Option<Motion> {
        self.physics.motion(robot)
    }

    /// Whether a robot lies on its side.
    #[must_use]
    pub fn has_tipped(&self, robot: usize) -> bool {
        self.physics.has_tipped(robot)
    }

    /// Sets the speeds of a robot's left and right wheels [m/s].
    ///
    /// # Errors
    /// When there is no such robot.
    pub fn drive(&mut self, robot: usize, left: f64, right: f64) -> Result<(), SimulatorError> {
        self.rig(robot)?;
        self.physics.drive(robot, left, right);
        Ok(())
    }

    /// Begins a scan with a robot's turning laser; sweeps and ticks follow with the steps.
    ///
    /// # Errors
    /// When there is no such robot, or it has no turning laser.
    pub fn start_scan(&mut self, robot: usize) -> Result<(), SimulatorError> {
        self.rig(robot)?;
        let time = self.time();
        let rig = &mut self.robots[robot];
        let name = rig.robot.name.clone();
        let missing = || SimulatorError::NoSensor { robot: name, kind: "laser3d", sensor: "any".into() };
        rig.turning.as_mut().ok_or_else(missing)?.0.start(time);
        Ok(())
    }

    /// Whether a robot's scan is under way.
    #[must_use]
    pub fn is_scanning(&self, robot: usize) -> bool {
        self.robots.get(robot).and_then(|rig| rig.turning.as_ref()).is_some_and(|(laser, _)| laser.is_scanning())
    }

    /// Casts the sweeps of turning lasers on this many threads; the bits do not depend on it.
    pub fn set_threads(&mut self, threads: usize) {
        for (laser, _) in self.robots.iter_mut().filter_map(|rig| rig.turning.as_mut()) {
            laser.set_threads(threads);
        }
    }

    /// Where a robot's ultrasonic rangers are and where they look; none when there is no such robot.
    #[must_use]
    pub fn ranger_mounts(&self, robot: usize) -> &[RangerMount] {
        self.robots.get(robot).map_or(&[], |rig| rig.rangers.mounts())
    }

    /// What a robot's camera sees now.
    ///
    /// # Errors
    /// When there is no such robot or camera.
    pub fn image(&self, robot: usize, camera: &str, threads: usize) -> Result<Image, SimulatorError> {
        let rig = self.rig(robot)?;
        let found = rig.robot.sensors.iter().find_map(|sensor| match sensor.kind {
            SensorKind::Camera { width, height, field_of_view } if sensor.name == camera => {
                Some((Camera { width, height, field_of_view }, sensor.robot_from_sensor()))
            }
            _ => None,
        });
        let (found, mount) = found.ok_or_else(|| SimulatorError::NoSensor {
            robot: rig.robot.name.clone(),
            kind: "camera",
            sensor: camera.to_owned(),
        })?;
        let pose = self.physics.motion(robot).map_or_else(Pose::identity, |motion| motion.pose);
        Ok(found.image(&self.scene, &(pose * mount), threads))
    }

    fn rig(&self, robot: usize) -> Result<&Rig, SimulatorError> {
        self.robots.get(robot).ok_or(SimulatorError::NoRobot { robot, robots: self.robots.len() })
    }

    /// Lets one step of the physics pass and appends to each robot's readings what has become due. Robots without
    /// readings are not listened to.
    pub fn step(&mut self, readings: &mut [Readings]) {
        let before = self.physics.time();
        self.physics.step();
        let clock = Clock { before, now: self.physics.time() };
        for (robot, (rig, readings)) in self.robots.iter_mut().zip(readings).enumerate() {
            let Some(motion) = self.physics.motion(robot) else { continue };
            rig.battery.draw(self.physics.motor_power(robot), self.config.physics.step);
            let rolled = self.physics.rolled(robot);
            rig.listen(clock, &motion, rolled, &self.scene, &self.config.sensors, readings);
        }
    }
}

#[cfg(test)]
mod tests;
