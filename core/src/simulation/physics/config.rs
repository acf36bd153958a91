//! What the physics is computed with, and why it cannot be.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Numbers of the physics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhysicsConfig {
    /// Length of a step [s].
    pub step: f64,
    /// Downwards [m/s^2].
    pub gravity: f64,
    /// Coulomb friction of wheels on the ground.
    pub friction: f64,
    /// Torque of a motor for each rad/s that its wheel is too slow [N m s/rad].
    pub motor_gain: f64,
    /// Largest torque of a wheel's motor [N m].
    pub motor_torque: f64,
    /// Iterations of the solver in a step.
    pub iterations: usize,
}

impl Default for PhysicsConfig {
    /// Rubber on dry soil, and motors that can make any wheel of the source's robot slip, even where uneven ground puts all
    /// of its weight on two of them: else it could not turn on the spot there.
    fn default() -> Self {
        Self { step: 0.005, gravity: 9.81, friction: 0.7, motor_gain: 2000.0, motor_torque: 80.0, iterations: 8 }
    }
}

/// Why there is no physics.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PhysicsError {
    /// A field is outside its range.
    #[error("physics.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// A robot starts where there is no ground.
    #[error("{place}robot `{robot}` starts at x = {x}, y = {y}, which is off the terrain; move x_m, y_m")]
    OffTerrain {
        /// File and line of the robot, or nothing.
        place: String,
        /// Its name.
        robot: String,
        /// Its start [m].
        x: f64,
        /// Its start [m].
        y: f64,
    },
    /// A robot starts within something.
    #[error("{place}robot `{robot}` starts at x = {x}, y = {y}, where it touches a {label}; move x_m, y_m")]
    Touches {
        /// File and line of the robot, or nothing.
        place: String,
        /// Its name.
        robot: String,
        /// Its start [m].
        x: f64,
        /// Its start [m].
        y: f64,
        /// What it touches.
        label: super::super::scene::Label,
    },
    /// A body cannot be built from its shapes.
    #[error("{place}robot `{robot}`: {reason}")]
    Body {
        /// File and line of the robot, or nothing.
        place: String,
        /// Its name.
        robot: String,
        /// What is wrong and what would be right.
        reason: &'static str,
    },
    /// The world's triangles cannot be taken.
    #[error("scene {scene}: its triangles cannot carry a robot: {reason}")]
    World {
        /// The scene's name.
        scene: String,
        /// The engine's reason.
        reason: String,
    },
}

impl PhysicsConfig {
    /// Checks every field.
    pub(super) fn validate(&self) -> Result<(), PhysicsError> {
        let checks = [
            ((1e-4..=0.02).contains(&self.step), "step", self.step, "must lie in 0.0001 ..= 0.02"),
            ((0.0..=100.0).contains(&self.gravity), "gravity", self.gravity, "must lie in 0 ..= 100"),
            ((0.0..=5.0).contains(&self.friction), "friction", self.friction, "must lie in 0 ..= 5"),
            ((0.0..=1e5).contains(&self.motor_gain), "motor_gain", self.motor_gain, "must lie in 0 ..= 100000"),
            ((0.0..=1e5).contains(&self.motor_torque), "motor_torque", self.motor_torque, "must lie in 0 ..= 100000"),
            ((1..=1000).contains(&self.iterations), "iterations", self.iterations as f64, "must lie in 1 ..= 1000"),
        ];
        match checks.into_iter().find(|(holds, ..)| !holds) {
            None => Ok(()),
            Some((_, field, value, allowed)) => Err(PhysicsError::OutOfRange { field, value, allowed }),
        }
    }
}
