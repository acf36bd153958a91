//! The filter's state: prediction and correction of the nominal state and of the covariance of its error.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::config::LocalizationConfig;
use crate::geometry::{Covariance, Pose};

/// Dimensions of the error.
pub(super) const DIM: usize = 21;
/// Where the parts of the error begin: position (map frame), velocity (map frame), rotation vector (robot frame, on the
/// right), biases of gyroscopes and accelerometers, drift of the satellite receiver (map frame), share by which the
/// wheels go too far, magnetic deviation, heading at an earlier moment.
pub(super) const POSITION: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const ROTATION: usize = 6;
pub(super) const GYRO_BIAS: usize = 9;
pub(super) const ACCELERATION_BIAS: usize = 12;
pub(super) const DRIFT: usize = 15;
pub(super) const SLIP: usize = 18;
pub(super) const IRON: usize = 19;
pub(super) const HEADING_THEN: usize = 20;

pub(super) type ErrorCovariance = SMatrix<f64, DIM, DIM>;
pub(super) type Jacobian<const N: usize> = SMatrix<f64, N, DIM>;

/// A measurement, linearised: `residual = jacobian * error + noise`.
pub(super) struct Measurement<const N: usize> {
    pub residual: SVector<f64, N>,
    pub jacobian: Jacobian<N>,
    pub noise: SMatrix<f64, N, N>,
}

/// What is estimated, and how well.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    /// `map_from_robot`.
    pub rotation: UnitQuaternion<f64>,
    pub gyro_bias: Vector3<f64>,
    pub acceleration_bias: Vector3<f64>,
    pub drift: Vector3<f64>,
    pub slip: f64,
    pub iron: f64,
    /// What was learnt since a remembered moment about the heading then [rad].
    pub heading_then: f64,
    pub covariance: ErrorCovariance,
}

/// How the robot is taken to move over a step.
#[derive(Debug, Clone, Copy)]
pub(super) enum Motion {
    /// As the inertial unit says: acceleration [m/s^2] and angular velocity [rad/s] as read, and the time between its
    /// readings [s].
    Measured { acceleration: Vector3<f64>, angular_velocity: Vector3<f64>, period: f64 },
    /// Nobody says: it goes on as before, turning at this speed about z as the wheels say [rad/s].
    Unknown { turning: f64 },
}

/// Random walks while the inertial unit is silent: of the velocity [m/s/sqrt(s)] and of the attitude [rad/sqrt(s)].
const UNKNOWN_VELOCITY_WALK: f64 = 0.5;
const UNKNOWN_ROTATION_WALK: f64 = 0.3;

impl State {
    pub fn new(config: &LocalizationConfig) -> Self {
        let start = config.map_from_start();
        let mut sigmas = SVector::<f64, DIM>::zeros();
        let mut set = |at: usize, values: [f64; 3]| sigmas.fixed_rows_mut::<3>(at).copy_from_slice(&values);
        set(POSITION, [config.start_sigma_m; 3]);
        set(VELOCITY, [0.1; 3]);
        let lean = 3.0_f64.to_radians();
        set(ROTATION, [lean, lean, config.start_yaw_sigma_deg.to_radians()]);
        set(GYRO_BIAS, [config.imu.angular_bias; 3]);
        set(ACCELERATION_BIAS, [config.imu.acceleration_bias; 3]);
        let drift = config.gnss.drift_sigma;
        set(DRIFT, [drift, drift, 2.0 * drift]);
        sigmas[SLIP] = config.wheels.slip_sigma;
        sigmas[IRON] = config.magnetometer.iron_sigma_deg.to_radians();
        Self {
            position: start.translation.vector,
            velocity: Vector3::zeros(),
            rotation: start.rotation,
            gyro_bias: Vector3::zeros(),
            acceleration_bias: Vector3::zeros(),
            drift: Vector3::zeros(),
            slip: 0.0,
            iron: 0.0,
            heading_then: 0.0,
            covariance: ErrorCovariance::from_diagonal(&sigmas.component_mul(&sigmas)),
        }
    }

    /// `map_from_robot`.
    pub fn pose(&self) -> Pose {
        Pose::from_parts(self.position.into(), self.rotation)
    }

    /// Covariance of [`State::pose`] as everywhere: translation before rotation, on the right, in the robot's frame.
    pub fn pose_covariance(&self) -> Covariance {
        let mut select = SMatrix::<f64, 6, DIM>::zeros();
        let back = self.rotation.to_rotation_matrix().into_inner().transpose();
        select.fixed_view_mut::<3, 3>(0, POSITION).copy_from(&back);
        select.fixed_view_mut::<3, 3>(3, ROTATION).copy_from(&Matrix3::identity());
        let covariance = select * self.covariance * select.transpose();
        0.5 * (covariance + covariance.transpose())
    }

    /// Turns the upright start so that the accelerometers of a standing robot agree: roll and pitch, not heading.
    pub fn level(&mut self, acceleration: &Vector3<f64>) {
        let yaw = self.heading();
        let felt = UnitQuaternion::rotation_between(acceleration, &Vector3::z());
        if let Some(tilt) = felt {
            let ahead = tilt * Vector3::x();
            let turn = yaw - ahead.y.atan2(ahead.x);
            self.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * tilt;
        }
    }

    /// Heading of the robot's x axis in the map [rad].
    pub fn heading(&self) -> f64 {
        let ahead = self.rotation * Vector3::x();
        ahead.y.atan2(ahead.x)
    }

    /// Prediction over `step` [s]: Sola (2017), nominal state (260), error state (261) to (268).
    pub fn predict(&mut self, step: f64, motion: &Motion, config: &LocalizationConfig) {
        let rotation = self.rotation.to_rotation_matrix().into_inner();
        let mut transition = ErrorCovariance::identity();
        let mut noise = SVector::<f64, DIM>::zeros();
        let mut add = |at: usize, variance: f64| noise.fixed_rows_mut::<3>(at).add_scalar_mut(variance);
        let imu = &config.imu;
        if let Motion::Measured { acceleration, period, .. } = motion {
            let felt = acceleration - self.acceleration_bias;
            let accelerated = rotation * felt - Vector3::new(0.0, 0.0, imu.gravity);
            self.position += step * self.velocity + 0.5 * step * step * accelerated;
            self.velocity += step * accelerated;
            let lever = -step * rotation * felt.cross_matrix();
            transition.fixed_view_mut::<3, 3>(VELOCITY, ROTATION).copy_from(&lever);
            transition.fixed_view_mut::<3, 3>(VELOCITY, ACCELERATION_BIAS).copy_from(&(-step * rotation));
            add(VELOCITY, imu.acceleration_sigma.powi(2) * step * period);
        } else {
            self.position += step * self.velocity;
            add(VELOCITY, UNKNOWN_VELOCITY_WALK.powi(2) * step);
        }
        transition.fixed_view_mut::<3, 3>(POSITION, VELOCITY).fill_diagonal(step);
        match motion {
            Motion::Measured { angular_velocity, period, .. } => {
                let turn = Rotation3::from_scaled_axis(step * (angular_velocity - self.gyro_bias));
                self.turn(&turn, &mut transition);
                transition.fixed_view_mut::<3, 3>(ROTATION, GYRO_BIAS).fill_diagonal(-step);
                add(ROTATION, imu.angular_sigma.powi(2) * step * period);
            }
            Motion::Unknown { turning } => {
                let turn = Rotation3::from_scaled_axis(Vector3::new(0.0, 0.0, step * turning));
                self.turn(&turn, &mut transition);
                add(ROTATION, UNKNOWN_ROTATION_WALK.powi(2) * step);
            }
        }
        self.fade(step, config, &mut transition, &mut noise);
        noise.fixed_rows_mut::<2>(POSITION).add_scalar_mut(step * self.sliding(config.wheels.slide_sigma_m));
        self.covariance = transition * self.covariance * transition.transpose();
        for k in 0..DIM {
            self.covariance[(k, k)] += noise[k];
        }
        self.symmetrise();
    }

    /// How the variance of a horizontal coordinate grows with time because the robot slides on slopes [m^2/s].
    fn sliding(&self, slide_sigma_m: f64) -> f64 {
        let up = self.rotation * Vector3::z();
        let slope = up.x.hypot(up.y) / up.z.abs().max(0.1);
        (slide_sigma_m * slope).powi(2) * self.velocity.norm()
    }

    fn turn(&mut self, turn: &Rotation3<f64>, transition: &mut ErrorCovariance) {
        self.rotation *= UnitQuaternion::from_rotation_matrix(turn);
        self.rotation.renormalize();
        transition.fixed_view_mut::<3, 3>(ROTATION, ROTATION).copy_from(&turn.matrix().transpose());
    }

    /// What holds for a while is a first-order Gauss-Markov process: it fades and is renewed.
    fn fade(
        &mut self,
        step: f64,
        config: &LocalizationConfig,
        transition: &mut ErrorCovariance,
        noise: &mut SVector<f64, DIM>,
    ) {
        let (imu, gnss, wheels) = (&config.imu, &config.gnss, &config.wheels);
        let mut process = |at: usize, sigmas: &[f64], correlation: f64| {
            let keep = (-step / correlation).exp();
            for (k, sigma) in (at..).zip(sigmas) {
                transition[(k, k)] = keep;
                noise[k] += sigma.powi(2) * (1.0 - keep * keep);
            }
            keep
        };
        self.gyro_bias *= process(GYRO_BIAS, &[imu.angular_bias; 3], imu.bias_correlation_s);
        self.acceleration_bias *= process(ACCELERATION_BIAS, &[imu.acceleration_bias; 3], imu.bias_correlation_s);
        let drift = [gnss.drift_sigma, gnss.drift_sigma, 2.0 * gnss.drift_sigma];
        self.drift *= process(DRIFT, &drift, gnss.drift_correlation_s);
        self.slip *= process(SLIP, &[wheels.slip_sigma], wheels.slip_correlation_s);
        let magnetometer = &config.magnetometer;
        let iron = magnetometer.iron_sigma_deg.to_radians();
        self.iron *= process(IRON, &[iron], magnetometer.iron_correlation_s);
    }

    /// Squared distance of a measurement from what is expected, in standard deviations (chi-square of N degrees of
    /// freedom); infinite when it has no inverse.
    pub fn distance2<const N: usize>(&self, measurement: &Measurement<N>) -> f64 {
        let spread = measurement.jacobian * self.covariance * measurement.jacobian.transpose() + measurement.noise;
        let inverse = spread.try_inverse();
        inverse.map_or(f64::INFINITY, |inverse| measurement.residual.dot(&(inverse * measurement.residual)))
    }

    /// Correction: Sola (2017), (274) to (276), the covariance in Joseph's form, and (282) to (283).
    pub fn correct<const N: usize>(&mut self, measurement: &Measurement<N>) {
        let (h, v) = (&measurement.jacobian, &measurement.noise);
        let Some(inverse) = (h * self.covariance * h.transpose() + v).try_inverse() else { return };
        let gain = self.covariance * h.transpose() * inverse;
        let keep = ErrorCovariance::identity() - gain * h;
        self.covariance = keep * self.covariance * keep.transpose() + gain * v * gain.transpose();
        self.symmetrise();
        self.inject(&(gain * measurement.residual));
    }

    fn inject(&mut self, error: &SVector<f64, DIM>) {
        let part = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
        self.position += part(POSITION);
        self.velocity += part(VELOCITY);
        self.rotation *= UnitQuaternion::from_scaled_axis(part(ROTATION));
        self.rotation.renormalize();
        self.gyro_bias += part(GYRO_BIAS);
        self.acceleration_bias += part(ACCELERATION_BIAS);
        self.drift += part(DRIFT);
        self.slip += error[SLIP];
        self.iron += error[IRON];
        self.heading_then += error[HEADING_THEN];
        // The error is counted in the corrected robot's frame from now on (287).
        let reset = Matrix3::identity() - 0.5 * part(ROTATION).cross_matrix();
        let rows: SMatrix<f64, 3, DIM> = reset * self.covariance.fixed_rows::<3>(ROTATION);
        self.covariance.fixed_rows_mut::<3>(ROTATION).copy_from(&rows);
        let columns: SMatrix<f64, DIM, 3> = self.covariance.fixed_columns::<3>(ROTATION) * reset.transpose();
        self.covariance.fixed_columns_mut::<3>(ROTATION).copy_from(&columns);
    }

    /// Remembers the heading of now, for a measurement of how far the robot turns from here: its error goes on beside that of the
    /// heading, and is as well known as that is now.
    pub fn remember_heading(&mut self) {
        self.heading_then = 0.0;
        let mut clone = ErrorCovariance::identity();
        clone[(HEADING_THEN, HEADING_THEN)] = 0.0;
        let up = self.rotation.inverse() * Vector3::z();
        clone.fixed_view_mut::<1, 3>(HEADING_THEN, ROTATION).copy_from(&up.transpose());
        self.covariance = clone * self.covariance * clone.transpose();
        self.symmetrise();
    }

    /// Puts the robot somewhere else, known to `covariance` (as of [`State::pose_covariance`]) and no longer tied to
    /// anything before. It moves on as it did, in its own frame, and readings of the receiver stay as likely as they were.
    pub fn put(&mut self, pose: &Pose, covariance: &Covariance) {
        let velocity = self.rotation.inverse() * self.velocity;
        self.drift -= pose.translation.vector - self.position;
        self.position = pose.translation.vector;
        self.rotation = pose.rotation;
        self.velocity = self.rotation * velocity;
        let turn = self.rotation.to_rotation_matrix().into_inner();
        for at in [POSITION, ROTATION] {
            self.untie(at);
        }
        let block = |row: usize, column: usize| covariance.fixed_view::<3, 3>(row, column).into_owned();
        let mut set = |row: usize, column: usize, value: Matrix3<f64>| {
            self.covariance.fixed_view_mut::<3, 3>(row, column).copy_from(&value);
        };
        set(POSITION, POSITION, turn * block(0, 0) * turn.transpose());
        set(POSITION, ROTATION, turn * block(0, 3));
        set(ROTATION, POSITION, block(3, 0) * turn.transpose());
        set(ROTATION, ROTATION, block(3, 3));
        self.symmetrise();
    }

    /// The map has moved under the robot: `new_from_old` moves everything in the map's frame along.
    pub fn move_along(&mut self, new_from_old: &Pose) {
        let before = self.position;
        let moved = new_from_old * self.pose();
        self.position = moved.translation.vector;
        self.rotation = moved.rotation;
        self.velocity = new_from_old.rotation * self.velocity;
        self.drift -= self.position - before;
        let turn = new_from_old.rotation.to_rotation_matrix().into_inner();
        let mut transition = ErrorCovariance::identity();
        for at in [POSITION, VELOCITY] {
            transition.fixed_view_mut::<3, 3>(at, at).copy_from(&turn);
        }
        self.covariance = transition * self.covariance * transition.transpose();
        self.symmetrise();
    }

    /// What the receiver has drifted by may be anything again, up to some standard deviations of `sigma` [m].
    pub fn reopen_drift(&mut self, sigma: f64) {
        self.untie(DRIFT);
        for (k, factor) in [3.0, 3.0, 6.0].into_iter().enumerate() {
            self.covariance[(DRIFT + k, DRIFT + k)] = (factor * sigma).powi(2);
        }
    }

    /// Three states are no longer correlated with anything, themselves included.
    fn untie(&mut self, at: usize) {
        self.covariance.fixed_rows_mut::<3>(at).fill(0.0);
        self.covariance.fixed_columns_mut::<3>(at).fill(0.0);
    }

    fn symmetrise(&mut self) {
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }
}

#[cfg(test)]
mod tests {
    use super::super::measurements;
    use super::super::sweep_matching::Turn;
    use super::*;

    #[test]
    fn a_turn_from_a_moment_just_remembered_teaches_nothing_and_one_from_long_ago_is_believed() {
        let config = LocalizationConfig::default();
        let mut state = State::new(&config);
        state.remember_heading();
        let turn = Turn { radians: 0.01, variance: 1e-8 };
        let before = state.clone();
        state.correct(&measurements::turn(&state, &turn));
        assert_eq!(state.rotation, before.rotation);
        assert!((state.covariance - before.covariance).norm() < 1e-12);
        let angular_velocity = Vector3::new(0.0, 0.0, 0.1);
        let motion = Motion::Measured { acceleration: Vector3::z() * 9.81, angular_velocity, period: 0.01 };
        for _ in 0..2000 {
            state.predict(0.01, &motion, &config);
        }
        let (heading, bias) = (state.heading(), state.gyro_bias.z);
        state.correct(&measurements::turn(&state, &turn));
        let learnt = state.heading() - heading - state.heading_then;
        assert!((learnt - 0.01).abs() < 1e-4, "{learnt}");
        assert!(state.gyro_bias.z < bias, "it turned farther than the gyroscopes had it");
    }
}
