//! What is kept for a restart: the estimate, once a second of its time.

use std::path::Path;

use mirador_core::geometry::pose_from_rows;
use mirador_core::localization::Localizer;
use mirador_ipc_schema::messages::RobotPose;
use mirador_service_common::{CheckpointError, checkpoint};

use crate::messages::covariance_from_rows;

/// Time between two times it is kept [ns].
pub(crate) const KEEP_NS: i64 = 1_000_000_000;
/// How far the robot may have moved since it was kept [m].
const MOVED_M: f64 = 0.5;

pub(crate) fn keep(path: &Path, pose: &RobotPose) -> Result<(), CheckpointError> {
    checkpoint::save(path, bytemuck::bytes_of(pose))
}

/// Goes on from what was kept, if anything was.
pub(crate) fn resume(path: &Path, localizer: &mut Localizer) -> Result<(), CheckpointError> {
    let Some(bytes) = checkpoint::load(path)? else { return Ok(()) };
    let invalid = |reason: &str| CheckpointError::Invalid { path: path.into(), reason: reason.into() };
    let pose: RobotPose =
        bytemuck::try_pod_read_unaligned(&bytes).map_err(|_| invalid("its length is that of something else"))?;
    let map_from_robot = pose_from_rows(&pose.map_from_robot).ok_or_else(|| invalid("it holds no pose"))?;
    localizer.resume(&map_from_robot, &covariance_from_rows(&pose.covariance), MOVED_M);
    Ok(())
}
