//! Which world is simulated, with what, and at what pace.

use std::path::Path;

use mirador_core::geometry::Pose;
use mirador_core::simulation::{
    CompiledScene, PhysicsConfig, PhysicsError, Robot, ScannerConfig, Scene, SensorKind, SensorsConfig, Simulator,
    SimulatorConfig as WorldConfig, SimulatorError,
};
use serde::{Deserialize, Serialize};

use crate::sensor_fault::SensorFault;

/// The table `simulator`.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatorConfig {
    /// Name of a built-in world, or a world file.
    pub world: String,
    /// Which of the world's robots drives, from 0; the others stand.
    pub robot: usize,
    /// What all sensors' errors are drawn from.
    pub seed: u64,
    /// Time between two references for the drives [s]: a whole number of physics steps.
    pub control_period_s: f64,
    /// Simulated time runs at this multiple of real time; 0 is lockstep: it goes on when navigation has answered.
    pub speed: f64,
    /// Physics.
    pub physics: PhysicsConfig,
    /// Sensors other than lasers and cameras, which the world file describes.
    pub sensors: SensorsConfig,
    /// Sensors that fall silent or babble for a while.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<SensorFault>,
    /// Services that must be there before time begins (set by the supervisor).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lockstep_with: Vec<String>,
}

impl Default for SimulatorConfig {
    fn default() -> Self {
        Self {
            world: "simple".into(),
            robot: 0,
            seed: 1,
            control_period_s: 0.05,
            speed: 0.0,
            physics: PhysicsConfig::default(),
            sensors: SensorsConfig::default(),
            faults: Vec::new(),
            lockstep_with: Vec::new(),
        }
    }
}

/// A value of the table `simulator` is wrong.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A number is outside its range.
    #[error("simulator.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// A number of the physics is outside its range.
    #[error("simulator.physics.{field} = {value} is out of range: {allowed}")]
    Physics {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// The world cannot be had.
    #[error("simulator.world = '{world}': {reason}")]
    World {
        /// The world as given.
        world: String,
        /// What is wrong.
        reason: String,
    },
    /// The world has no robot of this number.
    #[error("simulator.robot = {robot}: world '{world}' has {robots}, counted from 0")]
    NoRobot {
        /// The number as given.
        robot: usize,
        /// The world.
        world: String,
        /// Its robots.
        robots: usize,
    },
    /// The robot cannot scan.
    #[error("simulator.robot = {robot}: robot '{name}' of world '{world}' has no sensor of kind laser3d to scan with")]
    NoScanner {
        /// The number as given.
        robot: usize,
        /// The robot's name.
        name: String,
        /// The world.
        world: String,
    },
}

impl SimulatorConfig {
    /// Checks every value that can be checked without the world.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let steps = self.control_period_s / self.physics.step;
        let sensors = &self.sensors;
        let period = "above 0";
        let checks = [
            ("speed", self.speed, (0.0..=1e6).contains(&self.speed), "0 (lockstep) to 1000000"),
            ("control_period_s", self.control_period_s, (0.005..=0.5).contains(&self.control_period_s), "0.005 to 0.5"),
            ("physics.step", self.physics.step, (1e-4..=0.02).contains(&self.physics.step), "0.0001 to 0.02"),
            (
                "control_period_s",
                self.control_period_s,
                (steps - steps.round()).abs() < 1e-6 && steps > 0.5,
                "a whole number of simulator.physics.step",
            ),
            ("sensors.odometry.track", sensors.odometry.track, sensors.odometry.track > 0.0, period),
            ("sensors.odometry.period", sensors.odometry.period, sensors.odometry.period > 0.0, period),
            ("sensors.imu.period", sensors.imu.period, sensors.imu.period > 0.0, period),
            ("sensors.gnss.period", sensors.gnss.period, sensors.gnss.period > 0.0, period),
            ("sensors.magnetometer.period", sensors.magnetometer.period, sensors.magnetometer.period > 0.0, period),
            ("sensors.rangers.period", sensors.rangers.period, sensors.rangers.period > 0.0, period),
            ("sensors.battery.period", sensors.battery.period, sensors.battery.period > 0.0, period),
        ];
        let wrong =
            checks.into_iter().find(|(.., right, _)| !right).map(|(field, value, _, allowed)| (field, value, allowed));
        match wrong.or_else(|| self.faults.iter().find_map(SensorFault::wrong_field)) {
            None => Ok(()),
            Some((field, value, allowed)) => Err(ConfigError::OutOfRange { field, value, allowed }),
        }
    }

    /// Physics steps of a control step.
    pub(crate) fn physics_steps(&self) -> u64 {
        (self.control_period_s / self.physics.step).round() as u64
    }

    /// The world's description.
    ///
    /// # Errors
    /// [`ConfigError::World`].
    pub fn scene(&self) -> Result<Scene, ConfigError> {
        let scene = if self.world.ends_with(".toml") {
            Scene::load(Path::new(&self.world))
        } else {
            Scene::builtin(&self.world)
        };
        scene.map_err(|error| self.world_error(&error))
    }

    /// The world with its robots at their starts.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn simulator(&self, threads: usize) -> Result<Simulator, ConfigError> {
        self.validate()?;
        self.driven()?;
        let scene = CompiledScene::new(self.scene()?).map_err(|error| self.world_error(&error))?;
        let config = WorldConfig { seed: self.seed, physics: self.physics, sensors: self.sensors };
        let mut simulator = Simulator::new(scene, config).map_err(|error| match error {
            SimulatorError::Physics(PhysicsError::OutOfRange { field, value, allowed }) => {
                ConfigError::Physics { field, value, allowed }
            }
            error => self.world_error(&error),
        })?;
        simulator.set_threads(threads);
        Ok(simulator)
    }

    /// The robot that drives, as the world describes it.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn driven(&self) -> Result<DrivenRobot, ConfigError> {
        let scene = self.scene()?;
        let usual = [Robot { start: scene.start, ..Robot::default() }];
        let robots = if scene.robots.is_empty() { &usual[..] } else { &scene.robots[..] };
        let (number, world) = (self.robot, self.world.clone());
        let Some(robot) = robots.get(number) else {
            return Err(ConfigError::NoRobot { robot: number, world, robots: robots.len() });
        };
        let scanner = robot.sensors.iter().find_map(|sensor| match &sensor.kind {
            SensorKind::Laser3d(scanner) => Some((scanner.as_ref().clone(), sensor.robot_from_sensor())),
            _ => None,
        });
        let missing = || ConfigError::NoScanner { robot: number, name: robot.name.clone(), world };
        let (scanner, robot_from_scanner) = scanner.ok_or_else(missing)?;
        Ok(DrivenRobot { robot: robot.clone(), scanner, robot_from_scanner })
    }

    fn world_error(&self, error: &dyn std::fmt::Display) -> ConfigError {
        ConfigError::World { world: self.world.clone(), reason: error.to_string() }
    }
}

/// The robot that drives: what acquisition and localization must know of it.
#[derive(Debug, Clone)]
pub struct DrivenRobot {
    /// All of it.
    pub robot: Robot,
    /// The laser on its turning head: the grid of its scans.
    pub scanner: ScannerConfig,
    /// Where the head is mounted.
    pub robot_from_scanner: Pose,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_drives_the_usual_robot() {
        let config = SimulatorConfig::default();
        config.validate().unwrap();
        let driven = config.driven().unwrap();
        assert_eq!((driven.scanner.sweeps, driven.scanner.beams), (720, 541));
        assert_eq!(driven.robot_from_scanner.translation.vector.z, 1.0);
        assert_eq!(config.physics_steps(), 10);
    }

    #[test]
    fn wrong_values_are_named_with_what_would_be_right() {
        let wrong = [
            ("control_period_s = 0.052", "simulator.control_period_s = 0.052"),
            ("control_period_s = nan", "simulator.control_period_s = NaN"),
            ("speed = -1.0", "simulator.speed = -1"),
            ("sensors.imu.period = 0.0", "simulator.sensors.imu.period = 0"),
            ("faults = [{ topic = \"imu\", from_s = 3.0, to_s = 2.0 }]", "simulator.faults.to_s = 2"),
            ("faults = [{ topic = \"imu\", from_s = -1.0, to_s = 2.0 }]", "simulator.faults.from_s = -1"),
            (
                "faults = [{ topic = \"imu\", from_s = 1.0, to_s = 2.0, repeats = 2000 }]",
                "simulator.faults.repeats = 2000",
            ),
            ("robot = 3", "simulator.robot = 3: world 'simple' has 1"),
            ("world = \"nowhere\"", "simulator.world = 'nowhere'"),
            ("world = \"nowhere.toml\"", "simulator.world = 'nowhere.toml'"),
        ];
        for (text, named) in wrong {
            let config: SimulatorConfig = toml::from_str(text).unwrap();
            let message = config.validate().and_then(|()| config.driven().map(drop)).unwrap_err().to_string();
            assert!(message.contains(named), "{text}: {message}");
        }
        let unknown = toml::from_str::<SimulatorConfig>("wrold = \"simple\"").unwrap_err().to_string();
        assert!(unknown.contains("wrold"), "{unknown}");
        let nobody = "faults = [{ topic = \"nose\", from_s = 1.0, to_s = 2.0 }]";
        let nobody = toml::from_str::<SimulatorConfig>(nobody).unwrap_err().to_string();
        assert!(nobody.contains("unknown variant `nose`") && nobody.contains("planar_scan"), "{nobody}");
    }
}
