//! The source's own search: depth by depth, every combination about the best of the depth before.

use nalgebra::{UnitQuaternion, Vector3};

use super::lattice;
use super::occupancy::{LEVELS, OCCUPIED, Occupancy};
use super::search::{Found, Maximum};
use super::{CoarseConfig, CoarseScan, SearchRange};
use crate::geometry::Pose;

/// A displacement dP: translation [m] before yaw and two tilts [rad], in the source's frame, the vertical as z.
type Displacement = [f64; 6];

/// Section 3, step 2: for each depth from the coarsest cubes (`LEVELS` - 1 times doubled) to the finest, the
/// displacement with most overlapping cubes among all combinations of -dP_max, 0 and +dP_max about dP_best, dP_max
/// being half the range at first and half as much at each depth. Of equals the nearest to dP_best stays.
pub(super) fn depth_by_depth(
    target: &CoarseScan,
    source: &CoarseScan,
    initial: &Pose,
    range: &SearchRange,
    config: &CoarseConfig,
) -> Found {
    let sample: Vec<[f32; 3]> =
        source.sample().iter().filter_map(|index| source.points().get(*index as usize).copied()).collect();
    if sample.is_empty() {
        return Found::default();
    }
    let [yaw, tilt] = [range.yaw, range.tilt];
    let mut most = [range.translation_m, range.translation_m, range.height_m, yaw, tilt, tilt];
    let mut best: Displacement = [0.0; 6];
    let mut found = Found::default();
    let mut overlap = 0;
    for level in (0..LEVELS).rev() {
        let grid = Occupancy::new(target.points(), config.cell_m * f64::from(1 << level));
        most = most.map(|m| 0.5 * m);
        let about = best;
        overlap = overlapping(&grid, &sample, &pose_of(initial, range, &best));
        for combination in 0..729 {
            let tried = displaced(&about, &most, combination);
            let count = overlapping(&grid, &sample, &pose_of(initial, range, &tried));
            if count > overlap {
                (best, overlap) = (tried, count);
            }
        }
        found.evaluations += 730;
    }
    let overlap = f64::from(overlap) / (sample.len() as f64 * f64::from(OCCUPIED));
    found.maxima.push(Maximum { target_from_source: pose_of(initial, range, &best), overlap });
    found
}

/// One of the 3^6 combinations about `best`.
fn displaced(best: &Displacement, most: &Displacement, combination: usize) -> Displacement {
    let mut rest = combination;
    std::array::from_fn(|k| {
        let step = [0.0, -1.0, 1.0][rest % 3];
        rest /= 3;
        best[k] + step * most[k]
    })
}

/// The initial pose, displaced.
fn pose_of(initial: &Pose, range: &SearchRange, displacement: &Displacement) -> Pose {
    let (up, across, ahead) = lattice::axes(range);
    let [x, y, z, yaw, first, second] = *displacement;
    let turn =
        UnitQuaternion::from_scaled_axis(up * yaw) * UnitQuaternion::from_scaled_axis(across * first + ahead * second);
    initial * Pose::from_parts((across * x + ahead * y + up * z).into(), turn)
}

/// The value of the cubes that the points fall into.
pub(super) fn overlapping(grid: &Occupancy, points: &[[f32; 3]], pose: &Pose) -> u32 {
    let matrix = pose.rotation.to_rotation_matrix().into_inner();
    let value = |p: &[f32; 3]| {
        let moved = matrix * Vector3::from(p.map(f64::from)) + pose.translation.vector;
        u32::from(grid.value(0, grid.cube(moved.into())))
    };
    points.iter().map(value).sum()
}
