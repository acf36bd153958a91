//! What each reading does to the estimate.

use super::{Localizer, seconds};
use crate::localization::laser_heading::PieceEnd;
use crate::localization::measurements;
use crate::localization::readings::{GnssSample, ImuSample, MagneticSample, Reading, SweepSample, WheelSample};
use crate::localization::state::{GYRO_BIAS, Measurement};

/// Gate of the wheels' speed, standard deviations.
const WHEEL_GATE: f64 = 4.0;
/// Gate of a turn that the level laser has seen, standard deviations.
const TURN_GATE: f64 = 4.0;
/// Time over which the gyroscopes of a standing robot are averaged before they are believed [s].
const STILL_S: f64 = 0.5;

impl Localizer {
    pub(super) fn use_reading(&mut self, reading: &Reading) {
        match reading {
            Reading::Imu(sample) => self.use_imu(sample),
            Reading::Wheels(sample) => self.use_wheels(sample),
            Reading::Gnss(sample) if self.config.gnss.is_used => self.use_gnss(sample),
            Reading::Magnetic(sample) if self.config.magnetometer.is_used => self.use_magnetometer(sample),
            Reading::Sweep(sample) => self.use_sweep(sample),
            Reading::Gnss(_) | Reading::Magnetic(_) => {}
        }
    }

    fn use_imu(&mut self, sample: &ImuSample) {
        if self.imu.is_none() {
            self.state.level(&sample.acceleration);
        }
        self.imu = Some(*sample);
        if self.is_standing() {
            self.learn_gyro_bias(sample);
        } else {
            self.still = None;
        }
    }

    /// What the gyroscopes of a standing robot say is their bias, unless it creeps: a slope turns a robot slowly, which a
    /// mean over a while tells from a bias that was known better.
    fn learn_gyro_bias(&mut self, sample: &ImuSample) {
        let (since, mean) = self.still.get_or_insert((sample.stamp_ns, sample.angular_velocity));
        *mean += (self.imu_period / STILL_S) * (sample.angular_velocity - *mean);
        if seconds(*since, sample.stamp_ns) < STILL_S {
            return;
        }
        let mean = *mean;
        let spread = self.config.imu.angular_sigma.powi(2) * self.imu_period / STILL_S;
        let known = self.state.covariance.fixed_view::<3, 3>(GYRO_BIAS, GYRO_BIAS).diagonal();
        let off = mean - self.state.gyro_bias;
        if (0..3).all(|k| off[k].powi(2) < 9.0 * (spread + known[k])) {
            let standing = measurements::standing_gyro(&self.state, &sample.angular_velocity, &self.config);
            self.state.correct(&standing);
        }
    }

    fn use_wheels(&mut self, sample: &WheelSample) {
        let change = self.wheels.map_or(0.0, |last| sample.linear - last.linear);
        let since = self.wheels.map_or(0.0, |last| seconds(last.stamp_ns, sample.stamp_ns));
        self.laser.wheels(sample.linear * since);
        self.wheels = Some(*sample);
        let is_still = sample.linear == 0.0 && sample.angular == 0.0;
        self.standing_since_ns = if is_still { self.standing_since_ns.or(Some(sample.stamp_ns)) } else { None };
        if self.is_standing() {
            self.state.correct(&measurements::zero_velocity(&self.state, &self.config));
            return;
        }
        let turning = self.angular_velocity().z;
        if !self.laser.is_slipping() {
            self.use_forward_speed(sample, change, turning);
        }
        self.state.correct(&measurements::no_side_slip(&self.state, turning, &self.config));
    }

    fn use_forward_speed(&mut self, sample: &WheelSample, change: f64, turning: f64) {
        let forward = measurements::forward_speed(&self.state, sample, change, turning, &self.config);
        let agrees = self.state.distance2(&forward) < WHEEL_GATE.powi(2);
        self.quarrels[0].note(sample.stamp_ns, agrees);
        if agrees {
            self.state.correct(&forward);
        } else {
            self.counters.wheels_gated += 1;
        }
    }

    fn use_sweep(&mut self, sample: &SweepSample) {
        self.use_turn(sample);
        let Some(slip) = self.laser.hear(sample, &self.state.pose(), &self.config.laser) else { return };
        self.state.position += slip.shift;
        self.state.velocity = slip.velocity;
        self.counters.slips += 1;
    }

    /// How far the robot has turned over a piece of its way.
    fn use_turn(&mut self, sample: &SweepSample) {
        let (pose, learnt, stands) = (self.state.pose(), self.state.heading_then, self.is_standing());
        let end = self.laser_heading.hear(sample, &pose, learnt, stands, &self.config.laser);
        if let PieceEnd::Told(turn) = end {
            let measurement = measurements::turn(&self.state, &turn);
            if self.state.distance2(&measurement) < TURN_GATE.powi(2) {
                self.state.correct(&measurement);
                self.counters.turns += 1;
            } else {
                self.counters.turns_gated += 1;
            }
        }
        if end != PieceEnd::Not {
            self.laser_heading.begin(sample, &self.state.pose());
            self.state.remember_heading();
        }
    }

    fn use_gnss(&mut self, sample: &GnssSample) {
        let config = &self.config.gnss;
        let gate = config.gate.powi(2);
        let position = self.earth.position(&self.state, sample, config);
        let agrees = self.state.distance2(&position) < gate;
        self.quarrels[1].note(sample.stamp_ns, agrees);
        if !agrees {
            self.counters.gnss_gated += 1;
            return;
        }
        self.state.correct(&position);
        let velocity = self.earth.velocity(&self.state, sample, &self.angular_velocity(), config);
        if self.state.distance2(&velocity) < gate {
            self.state.correct(&velocity);
        }
    }

    fn use_magnetometer(&mut self, sample: &MagneticSample) {
        let config = &self.config.magnetometer;
        if self.magnetic_ns.is_some_and(|last| seconds(last, sample.stamp_ns) < config.period_s) {
            return;
        }
        self.magnetic_ns = Some(sample.stamp_ns);
        let Some(heading) = self.earth.heading(&self.state, &sample.field, &self.config) else { return };
        let is_near = |measurement: &Measurement<1>| self.state.distance2(measurement) < config.gate.powi(2);
        if is_near(&heading) {
            self.state.correct(&heading);
        } else {
            self.counters.magnetometer_gated += 1;
        }
    }
}
