//! The poses that are tried: rotations on a lattice, each with the source's cubes under it.

use nalgebra::{UnitQuaternion, Vector3};

use super::occupancy::Occupancy;
use super::{CoarseConfig, SearchRange};
use crate::geometry::Pose;

/// A rotation on trial and where it puts the source's points.
#[derive(Debug, Clone)]
pub(super) struct Rotated {
    /// The rotation of `target_from_source`.
    pub rotation: UnitQuaternion<f64>,
    /// The cube of every point at zero offset.
    pub cubes: Vec<[i32; 3]>,
}

/// All offsets of the search, in cubes: from `low` to `high`, both included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Offsets {
    pub low: [i32; 3],
    pub high: [i32; 3],
}

/// The rotations about `initial.rotation` within the range: yaw about the vertical, then a tilt about an axis across
/// it, both in the source's frame.
pub(super) fn rotations(initial: &Pose, range: &SearchRange, config: &CoarseConfig) -> Vec<UnitQuaternion<f64>> {
    let (up, across, ahead) = axes(range);
    let yaws = steps(range.yaw, config.yaw_step);
    let tilts = steps(range.tilt, config.tilt_step);
    let mut rotations = Vec::with_capacity(yaws.len() * tilts.len() * tilts.len());
    for yaw in &yaws {
        for first in &tilts {
            for second in &tilts {
                let tilt = UnitQuaternion::from_scaled_axis(across * *first + ahead * *second);
                rotations.push(initial.rotation * UnitQuaternion::from_scaled_axis(up * *yaw) * tilt);
            }
        }
    }
    rotations
}

/// The unit vertical and two directions across it, in the source's frame.
pub(super) fn axes(range: &SearchRange) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let up = Vector3::from(range.vertical).normalize();
    let across = up.cross(&if up.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }).normalize();
    (up, across, up.cross(&across))
}

/// Values from `-most` to `most`, no farther apart than `step`; zero is among them.
fn steps(most: f64, step: f64) -> Vec<f64> {
    // A range that is a whole number of steps up to rounding must not get one more.
    let count = ((most / step) - 1e-9).ceil().max(0.0) as i32;
    let width = if count == 0 { 0.0 } else { most / f64::from(count) };
    (-count..=count).map(|k| f64::from(k) * width).collect()
}

/// The offsets that cover the range whichever way the initial pose is turned.
pub(super) fn offsets(initial: &Pose, range: &SearchRange, cell_m: f64) -> Offsets {
    let up = initial.rotation * Vector3::from(range.vertical).normalize();
    let height = range.height_m + range.translation_m * range.tilt.sin();
    let half: [i32; 3] = std::array::from_fn(|axis| {
        // The range is a disc about `up` with a height; this is its extent along a target's axis.
        let along = up[axis].abs();
        let reach = height * along + range.translation_m * (1.0 - along * along).max(0.0).sqrt();
        (reach / cell_m).ceil() as i32
    });
    Offsets { low: half.map(|h| -h), high: half }
}

/// The source's points under a rotation, in the target's cubes.
pub(super) fn rotated(
    grid: &Occupancy,
    points: impl Iterator<Item = [f32; 3]>,
    rotation: UnitQuaternion<f64>,
    translation: &Vector3<f64>,
) -> Rotated {
    let matrix = rotation.to_rotation_matrix().into_inner();
    let cubes = points.map(|p| grid.cube((matrix * Vector3::from(p.map(f64::from)) + translation).into())).collect();
    Rotated { rotation, cubes }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_reaches_the_ends_of_its_range_and_holds_the_initial_pose() {
        assert_eq!(steps(0.0, 0.1), [0.0]);
        assert_eq!(steps(0.3, 0.1).len(), 7);
        let uneven = steps(0.25, 0.1);
        assert_eq!(uneven.len(), 7);
        assert!((uneven[6] - 0.25).abs() < 1e-12 && uneven[3] == 0.0);
    }

    #[test]
    fn a_tilted_start_searches_along_its_own_plane() {
        let range = SearchRange { tilt: 0.0, ..SearchRange::default() };
        let level = offsets(&Pose::identity(), &range, 0.5);
        assert_eq!(level.high, [10, 10, 1]);
        let upright = Pose::new(Vector3::zeros(), Vector3::new(0.0, std::f64::consts::FRAC_PI_2, 0.0));
        assert_eq!(offsets(&upright, &range, 0.5).high, [1, 10, 10]);
    }
}
