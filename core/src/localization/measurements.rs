//! What each sensor should say by the state, and how that depends on the error.

use nalgebra::{Matrix1, Matrix2, Matrix3, SVector, Vector1, Vector2, Vector3};

use super::config::{GnssModel, LocalizationConfig};
use super::geodesy::LocalFrame;
use super::readings::{GnssSample, WheelSample};
use super::state::{
    DRIFT, GYRO_BIAS, HEADING_THEN, IRON, Jacobian, Measurement, POSITION, ROTATION, SLIP, State, VELOCITY,
};
use super::sweep_matching::Turn;
use crate::geometry::{Covariance, Pose, log};

/// Velocity in the robot's frame [m/s] with its derivatives.
fn own_velocity(state: &State) -> (Vector3<f64>, Jacobian<3>) {
    let back = state.rotation.inverse().to_rotation_matrix().into_inner();
    let velocity = back * state.velocity;
    let mut jacobian = Jacobian::<3>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, VELOCITY).copy_from(&back);
    jacobian.fixed_view_mut::<3, 3>(0, ROTATION).copy_from(&velocity.cross_matrix());
    (velocity, jacobian)
}

/// The velocity at which a robot on wheels slides while it turns on a slope, in its own frame [m/s]: downhill. Dry friction
/// opposes the whole of a wheel's motion over the ground: while that is mostly sideways, as it is in turning, what is left to
/// hold the robot on the slope grows only with the speed at which it slides. So it slides in proportion to turning speed and
/// sine of the slope; by how much is measured on the simulated robot (0.6 m in a turn by 170 deg on 14.5 deg).
fn sliding(state: &State, turning: f64, config: &LocalizationConfig) -> [f64; 2] {
    let up = state.rotation.inverse() * Vector3::z();
    let speed = config.wheels.turning_slide_m * turning.abs();
    [-speed * up.x, -speed * up.y]
}

/// The wheels' forward speed: that of the robot but for what it slides, and the share by which they slip. A reading is the mean
/// over its interval, so at its end it is off by half of what the speed has changed by: `change` [m/s]. `turning` [rad/s].
pub(super) fn forward_speed(
    state: &State,
    sample: &WheelSample,
    change: f64,
    turning: f64,
    config: &LocalizationConfig,
) -> Measurement<1> {
    let (velocity, own) = own_velocity(state);
    let rolling = velocity.x - sliding(state, turning, config)[0];
    let mut jacobian: Jacobian<1> = (1.0 + state.slip) * own.fixed_rows::<1>(0);
    jacobian[SLIP] = rolling;
    let residual = Vector1::new(sample.linear - (1.0 + state.slip) * rolling);
    let skidding = config.wheels.turning_forward_sigma * turning;
    let noise = config.wheels.sigma.powi(2) + (0.5 * change).powi(2) + skidding.powi(2);
    Measurement { residual, jacobian, noise: Matrix1::new(noise) }
}

/// A robot on wheels goes neither sideways nor off the ground, give or take what it skids when it turns [rad/s].
pub(super) fn no_side_slip(state: &State, turning: f64, config: &LocalizationConfig) -> Measurement<2> {
    let (velocity, own) = own_velocity(state);
    let [_, aside] = sliding(state, turning, config);
    let sigma = config.wheels.sideways_sigma.hypot(config.wheels.turning_sigma * turning);
    Measurement {
        residual: Vector2::new(aside - velocity.y, -velocity.z),
        jacobian: own.fixed_rows::<2>(1).into_owned(),
        noise: Matrix2::identity() * sigma.powi(2),
    }
}

/// It stands.
pub(super) fn zero_velocity(state: &State, config: &LocalizationConfig) -> Measurement<3> {
    let mut jacobian = Jacobian::<3>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, VELOCITY).fill_with_identity();
    let noise = Matrix3::identity() * config.wheels.standing_sigma.powi(2);
    Measurement { residual: -state.velocity, jacobian, noise }
}

/// What the gyroscopes of a standing robot say is their bias.
pub(super) fn standing_gyro(
    state: &State,
    angular_velocity: &Vector3<f64>,
    config: &LocalizationConfig,
) -> Measurement<3> {
    let mut jacobian = Jacobian::<3>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, GYRO_BIAS).fill_with_identity();
    // Twice the noise: a robot that stands may still tremble.
    let noise = Matrix3::identity() * (2.0 * config.imu.angular_sigma).powi(2);
    Measurement { residual: angular_velocity - state.gyro_bias, jacobian, noise }
}

/// By how much more than the estimate has it the robot has turned since its heading was remembered.
pub(super) fn turn(state: &State, turn: &Turn) -> Measurement<1> {
    let mut jacobian = Jacobian::<1>::zeros();
    let up = state.rotation.inverse() * Vector3::z();
    jacobian.fixed_view_mut::<1, 3>(0, ROTATION).copy_from(&up.transpose());
    jacobian[HEADING_THEN] = -1.0;
    Measurement { residual: Vector1::new(turn.radians), jacobian, noise: Matrix1::new(turn.variance) }
}

/// How the map lies on the earth.
#[derive(Debug, Clone)]
pub(super) struct Earth {
    frame: LocalFrame,
    map_from_enu: Matrix3<f64>,
    /// Direction of magnetic north in the map [rad].
    magnetic_north: f64,
}

impl Earth {
    pub fn new(config: &LocalizationConfig) -> Self {
        let gnss = &config.gnss;
        let frame = LocalFrame::new(gnss.latitude_deg.to_radians(), gnss.longitude_deg.to_radians(), gnss.height);
        let east_from_map = gnss.east_from_map_deg.to_radians();
        let map_from_enu = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), -east_from_map).into_inner();
        let declination = config.magnetometer.declination_deg.to_radians();
        let magnetic_north = std::f64::consts::FRAC_PI_2 - declination - east_from_map;
        Self { frame, map_from_enu, magnetic_north }
    }

    /// The antenna's position, which drifts.
    pub fn position(&self, state: &State, sample: &GnssSample, config: &GnssModel) -> Measurement<3> {
        let measured = self.map_from_enu * self.frame.enu(sample.latitude, sample.longitude, sample.height);
        let rotation = state.rotation.to_rotation_matrix().into_inner();
        let antenna = Vector3::from(config.antenna_xyz);
        let mut jacobian = Jacobian::<3>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, POSITION).fill_with_identity();
        jacobian.fixed_view_mut::<3, 3>(0, ROTATION).copy_from(&(-rotation * antenna.cross_matrix()));
        jacobian.fixed_view_mut::<3, 3>(0, DRIFT).fill_with_identity();
        // A receiver that says it is worse than usual is believed.
        let usual = config.drift_sigma.hypot(config.noise_sigma);
        let worse = (sample.sigma.x.max(sample.sigma.y) / usual).max(1.0);
        let sigma = Vector3::new(1.0, 1.0, 2.0) * config.noise_sigma * worse;
        let residual = measured - (state.position + rotation * antenna + state.drift);
        Measurement { residual, jacobian, noise: Matrix3::from_diagonal(&sigma.component_mul(&sigma)) }
    }

    /// The antenna's velocity; `angular_velocity` of the robot in its frame [rad/s].
    pub fn velocity(
        &self,
        state: &State,
        sample: &GnssSample,
        angular_velocity: &Vector3<f64>,
        config: &GnssModel,
    ) -> Measurement<3> {
        let rotation = state.rotation.to_rotation_matrix().into_inner();
        let swing = angular_velocity.cross(&Vector3::from(config.antenna_xyz));
        let mut jacobian = Jacobian::<3>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, VELOCITY).fill_with_identity();
        jacobian.fixed_view_mut::<3, 3>(0, ROTATION).copy_from(&(-rotation * swing.cross_matrix()));
        let residual = self.map_from_enu * sample.velocity - state.velocity - rotation * swing;
        Measurement { residual, jacobian, noise: Matrix3::identity() * config.velocity_sigma.powi(2) }
    }

    /// Where the horizontal field points, which iron bends; nothing where the field is too upright to tell.
    pub fn heading(&self, state: &State, field: &Vector3<f64>, config: &LocalizationConfig) -> Option<Measurement<1>> {
        let in_map = state.rotation * field;
        if in_map.x.hypot(in_map.y) < 0.2 * field.norm() {
            return None;
        }
        let off = self.magnetic_north + state.iron - in_map.y.atan2(in_map.x);
        let off = off.sin().atan2(off.cos());
        let mut jacobian = Jacobian::<1>::zeros();
        let up = state.rotation.inverse() * Vector3::z();
        jacobian.fixed_view_mut::<1, 3>(0, ROTATION).copy_from(&up.transpose());
        jacobian[IRON] = -1.0;
        let noise = Matrix1::new(config.magnetometer.sigma_deg.to_radians().powi(2));
        Some(Measurement { residual: Vector1::new(off), jacobian, noise })
    }
}

/// `map_from_robot` as measured, with its covariance.
pub(super) fn pose(state: &State, measured: &Pose, covariance: &Covariance) -> Measurement<6> {
    let difference = log(&(state.pose().inverse() * measured));
    let mut jacobian = Jacobian::<6>::zeros();
    let back = state.rotation.inverse().to_rotation_matrix().into_inner();
    jacobian.fixed_view_mut::<3, 3>(0, POSITION).copy_from(&back);
    jacobian.fixed_view_mut::<3, 3>(3, ROTATION).fill_with_identity();
    Measurement { residual: SVector::from_iterator(difference.iter().copied()), jacobian, noise: *covariance }
}
