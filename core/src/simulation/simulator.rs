//! The whole robot in its world: physics and sensors, step by step in simulated time.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::camera::{Camera, Image};
use super::compiled_scene::CompiledScene;
use super::physics::{Motion, Physics, PhysicsConfig, PhysicsError};
use super::robot::{Robot, Sensor, SensorKind};
use super::sensors::{
    Battery, BatteryReading, EncoderTick, Gnss, GnssReading, Imu, ImuReading, LaserBeam, LaserSweep, Magnetometer,
    MagnetometerReading, Noise, OdometryReading, PlanarLaser, RangerReading, Rangers, SensorsConfig, TurningLaser,
    TurningLaserError, WheelOdometry,
};
use crate::geometry::Pose;

/// Time between two sweeps of a planar laser [s].
const PLANAR_PERIOD_S: f64 = 0.05;
/// Streams of random numbers a robot may use.
const STREAMS: u64 = 1000;

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

/// A sweep of one of a robot's fixed lasers.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarSweep {
    /// Simulated time of its first beam [s].
    pub time: f64,
    /// Which of the robot's sensors, in the order of the world file.
    pub sensor: usize,
    /// Its beams, the rightmost first.
    pub beams: Vec<LaserBeam>,
}

/// What a robot's sensors have said since the readings were cleared, each kind in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Readings {
    /// Wheels.
    pub odometry: Vec<OdometryReading>,
    /// Inertial unit.
    pub imu: Vec<ImuReading>,
    /// Satellite receiver.
    pub gnss: Vec<GnssReading>,
    /// Magnetometer.
    pub magnetometer: Vec<MagnetometerReading>,
    /// Ultrasonic rangers.
    pub rangers: Vec<RangerReading>,
    /// Battery.
    pub battery: Vec<BatteryReading>,
    /// Fixed lasers.
    pub planar: Vec<PlanarSweep>,
    /// The laser on the turning head.
    pub sweeps: Vec<LaserSweep>,
    /// The head itself.
    pub ticks: Vec<EncoderTick>,
}

impl Readings {
    /// Forgets all, keeps the memory.
    pub fn clear(&mut self) {
        self.odometry.clear();
        self.imu.clear();
        self.gnss.clear();
        self.magnetometer.clear();
        self.rangers.clear();
        self.battery.clear();
        self.planar.clear();
        self.sweeps.clear();
        self.ticks.clear();
    }
}

/// A world with its robots. The same world, config and commands give the same bits.
pub struct Simulator {
    scene: CompiledScene,
    physics: Physics,
    config: SimulatorConfig,
    robots: Vec<Rig>,
}

/// A robot's sensors.
struct Rig {
    robot: Robot,
    odometry: WheelOdometry,
    imu: Imu,
    gnss: Gnss,
    magnetometer: Magnetometer,
    rangers: Rangers,
    battery: Battery,
    /// The sensor's number, the laser, its `robot_from_sensor`.
    planar: Vec<(usize, PlanarLaser, Pose)>,
    turning: Option<(TurningLaser, Pose)>,
}

impl Simulator {
    /// Puts the world's robots at their starts; the source's robot at the world's start when the file names none.
    ///
    /// # Errors
    /// When a robot cannot stand where it starts, or one of its parts cannot be built.
    pub fn new(scene: CompiledScene, config: SimulatorConfig) -> Result<Self, SimulatorError> {
        let usual = [Robot { start: scene.scene().start, ..Robot::default() }];
        let named = &scene.scene().robots;
        let robots = if named.is_empty() { usual.to_vec() } else { named.clone() };
        let physics = Physics::new(&scene, &robots, config.physics)?;
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

/// The step that is passing.
#[derive(Clone, Copy)]
struct Clock {
    before: f64,
    now: f64,
}

impl Clock {
    /// Whether a sensor of this period speaks at the end of the step.
    fn is_due(self, period: f64) -> bool {
        // A shade more than a whole number of periods, so that rounding does not skip one.
        let count = |time: f64| (time / period + 1e-6).floor();
        count(self.now) > count(self.before)
    }
}

impl Rig {
    fn new(robot: Robot, number: u64, config: &SimulatorConfig) -> Result<Self, SimulatorError> {
        let noise = |stream: u64| Noise::new(config.seed, number * STREAMS + stream);
        let sensors = config.sensors;
        let (mut planar, mut turning) = (Vec::new(), None);
        for (index, sensor) in robot.sensors.iter().enumerate() {
            let own = noise(100 + index as u64);
            let mount = sensor.robot_from_sensor();
            match &sensor.kind {
                SensorKind::Camera { .. } => {}
                &SensorKind::Laser1d { range, noise } => {
                    planar.push((index, PlanarLaser::new(range, noise, 1.0, 0.0, own), mount));
                }
                &SensorKind::Laser2d { range, noise, resolution, field_of_view } => {
                    planar.push((index, PlanarLaser::new(range, noise, resolution, field_of_view, own), mount));
                }
                SensorKind::Laser3d(scanner) => {
                    let laser = TurningLaser::new(scanner.as_ref().clone(), own);
                    let laser = laser.map_err(|source| laser_error(&robot, sensor, source))?;
                    turning.get_or_insert((laser, mount));
                }
            }
        }
        let east_from_map = sensors.gnss.east_from_map_deg.to_radians();
        Ok(Self {
            odometry: WheelOdometry::new(sensors.odometry),
            imu: Imu::new(sensors.imu, noise(0)),
            gnss: Gnss::new(sensors.gnss, noise(1)),
            magnetometer: Magnetometer::new(sensors.magnetometer, east_from_map, noise(2)),
            rangers: Rangers::new(sensors.rangers, noise(3)),
            battery: Battery::new(sensors.battery, 1.0),
            robot,
            planar,
            turning,
        })
    }

    fn listen(
        &mut self,
        clock: Clock,
        motion: &Motion,
        rolled: [f64; 2],
        scene: &CompiledScene,
        config: &SensorsConfig,
        out: &mut Readings,
    ) {
        let time = clock.now;
        if clock.is_due(config.odometry.period) {
            out.odometry.push(self.odometry.read(time, rolled));
        }
        if clock.is_due(config.imu.period) {
            out.imu.push(self.imu.read(time, motion));
        }
        if clock.is_due(config.gnss.period) {
            out.gnss.push(self.gnss.read(time, motion, scene));
        }
        if clock.is_due(config.magnetometer.period) {
            out.magnetometer.push(self.magnetometer.read(time, motion));
        }
        if clock.is_due(config.rangers.period) {
            self.rangers.read(time, &motion.pose, scene, &mut out.rangers);
        }
        if clock.is_due(config.battery.period) {
            out.battery.push(self.battery.read(time));
        }
        if clock.is_due(PLANAR_PERIOD_S) {
            for (sensor, laser, mount) in &mut self.planar {
                let mut beams = Vec::with_capacity(laser.beams());
                laser.sweep(scene, &(motion.pose * *mount), &mut beams);
                out.planar.push(PlanarSweep { time, sensor: *sensor, beams });
            }
        }
        if let Some((laser, mount)) = &mut self.turning {
            laser.advance(time, scene, &(motion.pose * *mount), &mut out.sweeps, &mut out.ticks);
        }
    }
}

fn laser_error(robot: &Robot, sensor: &Sensor, source: TurningLaserError) -> SimulatorError {
    SimulatorError::Laser { robot: robot.name.clone(), sensor: sensor.name.clone(), source }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::simulation::Scene;

    fn simulator(name: &str) -> Simulator {
        let scene = CompiledScene::new(Scene::builtin(name).unwrap()).unwrap();
        Simulator::new(scene, SimulatorConfig { seed: 5, ..SimulatorConfig::default() }).unwrap()
    }

    #[test]
    fn every_sensor_speaks_at_its_rate() {
        let mut simulator = simulator("simple");
        simulator.drive(0, 0.4, 0.4).unwrap();
        simulator.start_scan(0).unwrap();
        let mut readings = vec![Readings::default()];
        for _ in 0..400 {
            simulator.step(&mut readings);
        }
        let r = &readings[0];
        assert!((simulator.time() - 2.0).abs() < 1e-9);
        let counts = [r.odometry.len(), r.imu.len(), r.gnss.len(), r.magnetometer.len(), r.rangers.len()];
        assert_eq!(counts, [100, 200, 8, 100, 120]);
        assert_eq!((r.battery.len(), r.planar.len(), r.sweeps.len(), r.ticks.len()), (2, 40, 100, 201));
        assert_eq!(r.planar[0].beams.len(), 361);
        assert!(r.battery[1].charge < r.battery[0].charge && r.battery[1].current > 3.0);
        assert!(simulator.is_scanning(0));
        let felt = r.imu.iter().skip(100).map(|i| i.acceleration.norm()).sum::<f64>() / 100.0;
        assert!((felt - 9.81).abs() < 0.3, "{felt}");
        readings[0].clear();
        assert_eq!(readings[0], Readings::default());
    }

    #[test]
    fn odometry_is_right_ahead_and_wrong_in_turns() {
        let scene = CompiledScene::new(Scene::builtin("field").unwrap()).unwrap();
        // It believes in the true distance of its wheels.
        let mut config = SimulatorConfig { seed: 5, ..SimulatorConfig::default() };
        config.sensors.odometry.track = 0.72;
        let mut simulator = Simulator::new(scene, config).unwrap();
        let mut readings = vec![Readings::default()];
        let mut run = |simulator: &mut Simulator, left: f64, right: f64, steps: usize| {
            simulator.drive(0, left, right).unwrap();
            for _ in 0..steps {
                simulator.step(&mut readings);
            }
            (simulator.truth(0).unwrap().pose, *readings[0].odometry.last().unwrap())
        };
        run(&mut simulator, 0.0, 0.0, 200);
        let (from, odometry_from) = run(&mut simulator, 0.5, 0.5, 200);
        let (to, odometry_to) = run(&mut simulator, 0.5, 0.5, 800);
        let driven = (to.translation.vector - from.translation.vector).norm();
        assert!((odometry_to.distance - odometry_from.distance - driven).abs() < 0.05 * driven, "{driven}");
        let heading = |pose: &Pose| {
            let ahead = pose.rotation * Vector3::x();
            ahead.y.atan2(ahead.x)
        };
        let (turned, odometry_turned) = run(&mut simulator, -0.3, 0.3, 400);
        let truth = heading(&turned) - heading(&to);
        let told = odometry_turned.pose[2] - odometry_to.pose[2];
        assert!(truth > 0.2 && told > 1.2 * truth, "skidding deceives it: {truth} {told}");
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_one_others() {
        let run = |seed| {
            let scene = CompiledScene::new(Scene::builtin("structured").unwrap()).unwrap();
            let mut simulator = Simulator::new(scene, SimulatorConfig { seed, ..SimulatorConfig::default() }).unwrap();
            simulator.drive(0, 0.6, 0.5).unwrap();
            let mut readings = vec![Readings::default()];
            for _ in 0..300 {
                simulator.step(&mut readings);
            }
            format!("{readings:?}")
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    #[test]
    fn the_camera_shows_the_world_and_missing_things_are_named() {
        let mut simulator = simulator("simple");
        let image = simulator.image(0, "camera", 2).unwrap();
        assert_eq!((image.width, image.height), (640, 480));
        let mut colours: Vec<_> = image.rgb.chunks_exact(3).collect();
        colours.sort_unstable();
        colours.dedup();
        assert!(colours.len() > 50, "{}", colours.len());
        let message = simulator.image(0, "eye", 1).unwrap_err().to_string();
        assert_eq!(message, "robot `robot` has no camera called `eye`");
        assert_eq!(simulator.drive(3, 0.0, 0.0).unwrap_err().to_string(), "there is no robot 3; this world has 1");
    }

    #[test]
    fn the_robot_drives_through_every_world_from_its_start() {
        for name in Scene::builtin_names() {
            let mut simulator = simulator(name);
            simulator.drive(0, 0.5, 0.5).unwrap();
            let from = simulator.truth(0).unwrap().pose.translation.vector;
            let mut readings = vec![Readings::default()];
            for _ in 0..400 {
                simulator.step(&mut readings);
            }
            let moved = (simulator.truth(0).unwrap().pose.translation.vector - from).norm();
            assert!(!simulator.has_tipped(0) && (0.6..1.2).contains(&moved), "{name}: {moved}");
        }
    }
}
