//! The simulated robot with a localizer that hears its sensors.

use nalgebra::Vector3;

use super::super::*;
use crate::geometry::{Covariance, Pose, Twist, exp, log};
use crate::simulation::{CompiledScene, Motion, Noise, Readings, Scene, Simulator, SimulatorConfig};

/// A control step [s].
pub(crate) const CONTROL_S: f64 = 0.05;

pub(crate) fn stamp(time: f64) -> i64 {
    (time * 1e9).round() as i64
}

/// What is done to the readings before the localizer hears them.
pub(crate) type Tamper = Box<dyn FnMut(&mut Readings)>;

/// The robot's world, its readings, and where it takes itself to be.
pub(crate) struct Ride {
    pub simulator: Simulator,
    pub localizer: Localizer,
    pub readings: Vec<Readings>,
    pub tamper: Option<Tamper>,
    pub driven: f64,
    noise: Noise,
    scans: u32,
}

impl Ride {
    pub fn builtin(world: &str, seed: u64) -> Self {
        Self::new(Scene::builtin(world).unwrap(), seed, |_| {})
    }

    pub fn new(scene: Scene, seed: u64, change: impl FnOnce(&mut LocalizationConfig)) -> Self {
        let scene = CompiledScene::new(scene).unwrap();
        let start = scene.scene().start;
        let height = scene.ground_height(start.x, start.y).unwrap();
        let mut config = LocalizationConfig {
            start_xyz: [start.x, start.y, height],
            start_yaw_deg: start.yaw.to_degrees(),
            ..LocalizationConfig::default()
        };
        change(&mut config);
        let simulator = Simulator::new(scene, SimulatorConfig { seed, ..SimulatorConfig::default() }).unwrap();
        let noise = Noise::new(seed, 77);
        let localizer = Localizer::new(config).unwrap();
        Self { simulator, localizer, readings: vec![Readings::default()], tamper: None, driven: 0.0, noise, scans: 0 }
    }

    pub fn truth(&self) -> Motion {
        self.simulator.truth(0).unwrap()
    }

    pub fn now_ns(&self) -> i64 {
        stamp(self.simulator.time())
    }

    /// One control step with these rim speeds.
    pub fn control(&mut self, left: f64, right: f64) -> Estimate {
        self.simulator.drive(0, left, right).unwrap();
        self.readings[0].clear();
        let from = self.truth().pose.translation.vector;
        for _ in 0..10 {
            self.simulator.step(&mut self.readings);
        }
        self.driven += (self.truth().pose.translation.vector - from).norm();
        if let Some(tamper) = &mut self.tamper {
            tamper(&mut self.readings[0]);
        }
        hear(&mut self.localizer, &self.readings[0]);
        self.localizer.advance(self.now_ns())
    }

    pub fn go(&mut self, left: f64, right: f64, seconds: f64) -> Estimate {
        let mut estimate = self.localizer.estimate();
        for _ in 0..(seconds / CONTROL_S).round() as usize {
            estimate = self.control(left, right);
        }
        estimate
    }

    /// Turns to a place and drives there, by the truth.
    pub fn drive_to(&mut self, x: f64, y: f64) {
        for _ in 0..4000 {
            let pose = self.truth().pose;
            let to = pose.inverse_transform_point(&nalgebra::Point3::new(x, y, pose.translation.z));
            let (off, left) = (to.y.atan2(to.x), to.x.hypot(to.y));
            if left < 0.15 {
                break;
            }
            let turn = (1.5 * off).clamp(-0.7, 0.7);
            let speed = if off.abs() > 0.4 { 0.0 } else { 0.6 };
            self.control(speed - 0.515 * turn, speed + 0.515 * turn);
        }
        self.go(0.0, 0.0, 0.5);
    }

    /// Stands for a while, as for a scan; what the prior is off by, and its covariance; then its alignment, with errors of
    /// 1 cm and 0.1 deg.
    pub fn scan(&mut self, seconds: f64) -> (Twist, Covariance) {
        self.go(0.0, 0.0, seconds);
        let prior = self.localizer.prior(self.scans);
        let robot_from_scanner = Pose::translation(0.0, 0.0, 1.0);
        let truth = self.truth().pose * robot_from_scanner;
        let off = log(&(prior.map_from_scanner.inverse() * truth));
        let (metres, radians) = (0.01, 0.1_f64.to_radians());
        let (t, r) = (self.noise.normal3(metres), self.noise.normal3(radians));
        let aligned = truth * exp(&Twist::new(t.x, t.y, t.z, r.x, r.y, r.z));
        let (m, r) = (metres * metres, radians * radians);
        let covariance = Covariance::from_diagonal(&[m, m, m, r, r, r].into());
        assert_ne!(self.localizer.align(self.scans, &aligned, &covariance), ScanPoseUse::Unknown);
        self.scans += 1;
        (off, prior.covariance)
    }

    /// What the estimate is off by now.
    pub fn off(&self) -> Twist {
        log(&(self.localizer.estimate().map_from_robot.inverse() * self.truth().pose))
    }
}

/// Everything that a robot has said, as the localizer takes it.
pub(crate) fn hear(localizer: &mut Localizer, readings: &Readings) {
    for r in &readings.imu {
        let (acceleration, angular_velocity) = (r.acceleration, r.angular_velocity);
        localizer.imu(ImuSample { stamp_ns: stamp(r.time), acceleration, angular_velocity });
    }
    for r in &readings.odometry {
        localizer.wheels(WheelSample { stamp_ns: stamp(r.time), linear: r.linear, angular: r.angular });
    }
    for r in readings.gnss.iter().filter(|r| r.has_fix) {
        localizer.gnss(GnssSample {
            stamp_ns: stamp(r.time),
            latitude: r.latitude,
            longitude: r.longitude,
            height: r.height,
            velocity: r.velocity,
            sigma: r.sigma,
        });
    }
    for r in &readings.planar {
        localizer.sweep(SweepSample {
            stamp_ns: stamp(r.time),
            first_angle: -std::f64::consts::FRAC_PI_2,
            angle_step: std::f64::consts::PI / 360.0,
            mount_xyz: [0.5, 0.0, 0.42],
            mount_yaw: 0.0,
            ranges: r.beams.iter().map(|beam| beam.range).collect(),
        });
    }
    for r in &readings.magnetometer {
        localizer.magnetometer(MagneticSample { stamp_ns: stamp(r.time), field: r.field });
    }
}

/// Metres and degrees of a difference of poses.
pub(crate) fn size(off: &Twist) -> (f64, f64) {
    let part = |at: usize| Vector3::new(off[at], off[at + 1], off[at + 2]);
    (part(0).norm(), part(3).norm().to_degrees())
}
