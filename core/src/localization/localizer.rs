//! The filter with its sensors: readings in the order of time, scans in the order they were taken.

mod sensors;

use nalgebra::Vector3;

use super::config::LocalizationConfig;
use super::intake::{Intake, Refusals};
use super::laser_heading::LaserHeading;
use super::laser_track::LaserTrack;
use super::lost::{Lost, Quarrel, Signs, Source, judge};
use super::measurements::{self, Earth};
use super::readings::{GnssSample, ImuSample, MagneticSample, Reading, SweepSample, WheelSample};
use super::state::{Motion, POSITION, ROTATION, State};
use crate::geometry::{Covariance, Pose, adjoint};
use crate::registration::ConfigError;

/// What a metre between the end of a scan and the time its pose is known adds to that pose [m, rad].
const MOVED_SIGMA: f64 = 0.02;

/// Where the robot is.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Time [ns].
    pub stamp_ns: i64,
    /// `map_from_robot`.
    pub map_from_robot: Pose,
    /// Its covariance: translation before rotation, perturbation on the right, in the robot's frame.
    pub covariance: Covariance,
    /// Forward speed [m/s].
    pub linear: f64,
    /// Turning speed about z [rad/s].
    pub angular: f64,
    /// Why it is not to be believed, if so.
    pub lost: Option<Lost>,
    /// The newest scan whose aligned pose is in the estimate.
    pub aligned_scan: Option<u32>,
}

/// Where the scanner was in a scan, before its alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanPrior {
    /// `map_from_scanner`.
    pub map_from_scanner: Pose,
    /// Its covariance, in the scanner's frame.
    pub covariance: Covariance,
    /// Why it is not to be believed, if so.
    pub lost: Option<Lost>,
}

/// What came of the pose of an aligned scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanPoseUse {
    /// It corrected the estimate.
    Corrected,
    /// It was so far off that the estimate was put there.
    Moved,
    /// It names a scan that no prior was given for, or an older one.
    Unknown,
    /// It is not finite.
    Refused,
}

/// What has counted and what has not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Readings that could not be used.
    pub refused: Refusals,
    /// Speeds of the wheels outside their gate: they slip.
    pub wheels_gated: u64,
    /// Pieces of the way over which the laser saw the robot lag far behind its wheels.
    pub slips: u64,
    /// Pieces of the way over which the laser saw how far the robot turned.
    pub turns: u64,
    /// Such pieces over which that was outside its gate.
    pub turns_gated: u64,
    /// Positions of the receiver outside their gate.
    pub gnss_gated: u64,
    /// Magnetic headings outside their gate.
    pub magnetometer_gated: u64,
    /// Times the estimate was put where a scan was aligned.
    pub moved: u64,
}

/// Keeps the estimate. It has no clock: time passes by [`Localizer::advance`].
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizationConfig,
    earth: Earth,
    state: State,
    intake: Intake,
    /// The time of the state; none before the first reading.
    time_ns: Option<i64>,
    /// The last time that was asked for.
    now_ns: i64,
    begun_ns: Option<i64>,
    imu: Option<ImuSample>,
    imu_period: f64,
    wheels: Option<WheelSample>,
    laser: LaserTrack,
    laser_heading: LaserHeading,
    /// Since when the wheels stand.
    standing_since_ns: Option<i64>,
    /// Since when the robot stands, and the mean of its gyroscopes [rad/s].
    still: Option<(i64, Vector3<f64>)>,
    magnetic_ns: Option<i64>,
    quarrels: [Quarrel; 2],
    /// The scan a prior was given for, and `map_from_robot` then.
    anchor: Option<(u32, Pose)>,
    /// The newest aligned scan and its `map_from_scanner`.
    aligned: Option<(u32, Pose)>,
    counters: Counters,
}

impl Localizer {
    /// Starts where the config says.
    ///
    /// # Errors
    /// Names the first field of the config that is wrong.
    pub fn new(config: LocalizationConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            earth: Earth::new(&config),
            state: State::new(&config),
            config,
            intake: Intake::default(),
            time_ns: None,
            now_ns: i64::MIN,
            begun_ns: None,
            imu: None,
            imu_period: 0.01,
            wheels: None,
            laser: LaserTrack::default(),
            laser_heading: LaserHeading::default(),
            standing_since_ns: None,
            still: None,
            magnetic_ns: None,
            quarrels: [Quarrel::default(); 2],
            anchor: None,
            aligned: None,
            counters: Counters::default(),
        })
    }

    /// Goes on after a restart from an estimate that was kept, known as well as it then was and by what the robot may
    /// have moved since [m].
    pub fn resume(&mut self, map_from_robot: &Pose, covariance: &Covariance, moved_m: f64) {
        let mut covariance = *covariance;
        for k in 0..3 {
            covariance[(k, k)] += moved_m.powi(2);
            covariance[(3 + k, 3 + k)] += moved_m.powi(2);
        }
        self.state.put(map_from_robot, &covariance);
        self.laser.forget();
        self.laser_heading.forget();
        self.state.drift = Vector3::zeros();
        self.state.reopen_drift(self.config.gnss.drift_sigma);
    }

    /// Takes a reading in; it counts when its time has come.
    pub fn imu(&mut self, sample: ImuSample) {
        self.intake.push(Reading::Imu(sample));
    }

    /// Takes a reading in; it counts when its time has come.
    pub fn wheels(&mut self, sample: WheelSample) {
        self.intake.push(Reading::Wheels(sample));
    }

    /// Takes a reading with a fix in; it counts when its time has come.
    pub fn gnss(&mut self, sample: GnssSample) {
        self.intake.push(Reading::Gnss(sample));
    }

    /// Takes a reading in; it counts when its time has come.
    pub fn magnetometer(&mut self, sample: MagneticSample) {
        self.intake.push(Reading::Magnetic(sample));
    }

    /// Takes a sweep of the level laser in, if such count; it does when its time has come.
    pub fn sweep(&mut self, sample: SweepSample) {
        if self.config.laser.is_used {
            self.intake.push(Reading::Sweep(sample));
        }
    }

    /// Lets time pass up to a moment; every reading up to it counts.
    pub fn advance(&mut self, now_ns: i64) -> Estimate {
        if now_ns > self.now_ns {
            self.begun_ns = self.begun_ns.or(Some(now_ns));
            while let Some(reading) = self.intake.next(now_ns) {
                if let Reading::Imu(sample) = &reading {
                    self.hear_of_interval(sample);
                }
                self.predict_to(reading.stamp_ns());
                self.use_reading(&reading);
            }
            self.predict_to(now_ns);
            self.intake.done(now_ns);
            self.now_ns = now_ns;
        }
        self.estimate()
    }

    /// The estimate at the last time asked for.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let own = self.state.rotation.inverse() * self.state.velocity;
        Estimate {
            stamp_ns: self.now_ns,
            map_from_robot: self.state.pose(),
            covariance: self.state.pose_covariance(),
            linear: own.x,
            angular: self.angular_velocity().z,
            lost: self.lost(),
            aligned_scan: self.aligned.map(|(scan, _)| scan),
        }
    }

    /// What has counted and what has not.
    #[must_use]
    pub fn counters(&self) -> Counters {
        Counters { refused: self.intake.refusals, ..self.counters }
    }

    /// Whether wheels and gyroscopes say that the robot stands.
    #[must_use]
    pub fn is_standing(&self) -> bool {
        let still = |sample: &ImuSample| {
            (sample.angular_velocity - self.state.gyro_bias).norm() < self.config.wheels.standing_turn
        };
        let since = self.standing_since_ns.zip(self.time_ns);
        since.is_some_and(|(since, now)| seconds(since, now) >= self.config.wheels.standing_s)
            && self.imu.as_ref().is_some_and(still)
    }

    /// The prior of a scan that has just been taken here.
    pub fn prior(&mut self, scan: u32) -> ScanPrior {
        let estimate = self.estimate();
        self.anchor = Some((scan, estimate.map_from_robot));
        let robot_from_scanner = self.config.robot_from_scanner();
        let moved = adjoint(&robot_from_scanner.inverse());
        ScanPrior {
            map_from_scanner: estimate.map_from_robot * robot_from_scanner,
            covariance: moved * estimate.covariance * moved.transpose(),
            lost: estimate.lost,
        }
    }

    /// The pose that alignment found for a scan, with its covariance against the scan it was aligned to (in the scanner's
    /// frame; all zero is taken for 0.05 m and 0.5 deg): the estimate is the place in the map as it is, so what the map has
    /// drifted by since its first scan does not count, else the receiver would pull the robot off it. The robot may have
    /// moved on since.
    pub fn align(&mut self, scan: u32, map_from_scanner: &Pose, covariance: &Covariance) -> ScanPoseUse {
        let Some((_, then)) = self.anchor.filter(|(anchor, _)| *anchor == scan) else { return ScanPoseUse::Unknown };
        let rows = map_from_scanner.to_homogeneous();
        if !rows.iter().chain(covariance.iter()).all(|value| value.is_finite()) {
            return ScanPoseUse::Refused;
        }
        let robot_from_scanner = self.config.robot_from_scanner();
        let then_from_now = then.inverse() * self.state.pose();
        let measured = map_from_scanner * robot_from_scanner.inverse() * then_from_now;
        let covariance = self.scan_covariance(covariance);
        let moved = adjoint(&then_from_now.inverse()) * adjoint(&robot_from_scanner);
        let mut noise = moved * covariance * moved.transpose();
        let walked = (MOVED_SIGMA * then_from_now.translation.vector.norm()).powi(2);
        for k in 0..6 {
            noise[(k, k)] += walked;
        }
        let measurement = measurements::pose(&self.state, &measured, &noise);
        let is_far = self.state.distance2(&measurement) > self.config.scans.gate.powi(2);
        if is_far {
            self.state.put(&measured, &noise);
            self.laser_heading.forget();
            self.counters.moved += 1;
        } else {
            self.state.correct(&measurement);
        }
        if self.quarrels[1].seconds(self.now_ns) > 0.0 {
            // The map is believed; so the receiver must have drifted.
            self.state.reopen_drift(self.config.gnss.drift_sigma);
        }
        self.quarrels = [Quarrel::default(); 2];
        self.aligned = Some((scan, *map_from_scanner));
        self.laser.forget();
        if is_far { ScanPoseUse::Moved } else { ScanPoseUse::Corrected }
    }

    /// The newest aligned scan has moved in the map: the estimate moves along. Other scans are nothing to it.
    pub fn correct(&mut self, scan: u32, map_from_scanner: &Pose) -> bool {
        let Some((_, before)) = self.aligned.filter(|(aligned, _)| *aligned == scan) else { return false };
        if !map_from_scanner.to_homogeneous().iter().all(|value| value.is_finite()) {
            return false;
        }
        let new_from_old = map_from_scanner * before.inverse();
        self.state.move_along(&new_from_old);
        self.laser.forget();
        self.laser_heading.forget();
        if let Some((_, then)) = &mut self.anchor {
            *then = new_from_old * *then;
        }
        self.aligned = Some((scan, *map_from_scanner));
        true
    }

    fn scan_covariance(&self, covariance: &Covariance) -> Covariance {
        let config = &self.config.scans;
        let diagonal = |metres: f64, degrees: f64| {
            let (m, r) = (metres.powi(2), degrees.to_radians().powi(2));
            Covariance::from_diagonal(&[m, m, m, r, r, r].into())
        };
        let known = if covariance.iter().all(|value| *value == 0.0) { diagonal(0.05, 0.5) } else { *covariance };
        0.5 * (known + known.transpose()) + diagonal(config.extra_sigma_m, config.extra_sigma_deg)
    }

    /// A reading of the inertial unit is the mean of the interval that it ends: over that it is the word, and goes on to be.
    fn hear_of_interval(&mut self, sample: &ImuSample) {
        let Some(last) = self.imu else { return };
        let period = seconds(last.stamp_ns, sample.stamp_ns);
        if period < self.config.imu.gap_s {
            (self.imu, self.imu_period) = (Some(*sample), period);
        }
    }

    /// Predicts up to a reading, or up to now, by the last word of the inertial unit as long as it is fresh.
    fn predict_to(&mut self, stamp_ns: i64) {
        let Some(from) = self.time_ns.filter(|time| *time < stamp_ns) else {
            self.time_ns = self.time_ns.or(Some(stamp_ns));
            return;
        };
        let gap_ns = (self.config.imu.gap_s * 1e9) as i64;
        // Behind a gap nobody knows; up to it the last word holds.
        let fresh_until = self.imu.map_or(from, |imu| imu.stamp_ns.saturating_add(gap_ns)).clamp(from, stamp_ns);
        if let Some(imu) = self.imu.filter(|_| fresh_until > from) {
            let acceleration = imu.acceleration;
            let period = self.imu_period;
            let motion = Motion::Measured { acceleration, angular_velocity: imu.angular_velocity, period };
            self.state.predict(seconds(from, fresh_until), &motion, &self.config);
        }
        if fresh_until < stamp_ns {
            let turning = self.wheels.map_or(0.0, |wheels| wheels.angular);
            self.state.predict(seconds(fresh_until, stamp_ns), &Motion::Unknown { turning }, &self.config);
        }
        self.time_ns = Some(stamp_ns);
    }

    /// Turning in the robot's frame without the bias; what the wheels say while the inertial unit is silent.
    fn angular_velocity(&self) -> Vector3<f64> {
        let imu =
            self.imu.filter(|imu| seconds(imu.stamp_ns, self.time_ns.unwrap_or(imu.stamp_ns)) < self.config.imu.gap_s);
        match imu {
            Some(imu) => imu.angular_velocity - self.state.gyro_bias,
            None => Vector3::new(0.0, 0.0, self.wheels.map_or(0.0, |wheels| wheels.angular)),
        }
    }

    fn lost(&self) -> Option<Lost> {
        let begun = self.begun_ns?;
        let silence = |last: Option<i64>| seconds(last.unwrap_or(begun), self.now_ns);
        let up = self.state.rotation * Vector3::z();
        let horizontal = self.state.covariance.fixed_view::<2, 2>(POSITION, POSITION).into_owned();
        let rotation = self.state.covariance.fixed_view::<3, 3>(ROTATION, ROTATION);
        let up_in_robot = self.state.rotation.inverse() * Vector3::z();
        let signs = Signs {
            tilt: up.z.clamp(-1.0, 1.0).acos(),
            position_sigma: horizontal.symmetric_eigenvalues().max().max(0.0).sqrt(),
            yaw_sigma: (up_in_robot.transpose() * rotation * up_in_robot).x.max(0.0).sqrt(),
            silent: [
                (Source::Imu, silence(self.imu.map(|s| s.stamp_ns))),
                (Source::Wheels, silence(self.wheels.map(|s| s.stamp_ns))),
            ],
            contradicted: [
                (Source::Wheels, self.quarrels[0].seconds(self.now_ns)),
                (Source::Gnss, self.quarrels[1].seconds(self.now_ns)),
            ],
        };
        judge(&signs, &self.config.lost)
    }
}

/// From one stamp to a later one [s].
fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}
