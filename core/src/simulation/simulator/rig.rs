//! The sensors of one robot, each at its own rate.

use super::readings::{PlanarSweep, Readings};
use super::{SimulatorConfig, SimulatorError};
use crate::geometry::Pose;
use crate::simulation::compiled_scene::CompiledScene;
use crate::simulation::physics::Motion;
use crate::simulation::robot::{Robot, Sensor, SensorKind};
use crate::simulation::sensors::{
    Battery, Gnss, Imu, Magnetometer, Noise, PlanarLaser, Rangers, SensorsConfig, TurningLaser, TurningLaserError,
    WheelOdometry,
};

/// Time between two sweeps of a planar laser [s].
const PLANAR_PERIOD_S: f64 = 0.05;
/// Streams of random numbers a robot may use.
const STREAMS: u64 = 1000;

/// A robot's sensors.
pub(super) struct Rig {
    pub robot: Robot,
    odometry: WheelOdometry,
    imu: Imu,
    gnss: Gnss,
    magnetometer: Magnetometer,
    pub rangers: Rangers,
    pub battery: Battery,
    /// The sensor's number, the laser, its `robot_from_sensor`.
    planar: Vec<(usize, PlanarLaser, Pose)>,
    pub turning: Option<(TurningLaser, Pose)>,
}

/// The step that is passing.
#[derive(Clone, Copy)]
pub(super) struct Clock {
    pub before: f64,
    pub now: f64,
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
    pub fn new(robot: Robot, number: u64, config: &SimulatorConfig) -> Result<Self, SimulatorError> {
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

    pub fn listen(
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
