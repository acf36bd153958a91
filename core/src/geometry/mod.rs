//! Poses, twists and small angles: the vocabulary every other module speaks.

mod pose;

pub use pose::{
    Covariance, Pose, Twist, adjoint, compose_all, exp, log, pose_from_rows, rotation_angle, rows_from_pose,
};
