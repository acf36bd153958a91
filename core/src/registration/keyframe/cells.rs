//! The distribution of the returns in each brick, for the methods that match points to distributions.

use super::moments::Moments;
use super::planes::Plane;
use super::voxels::Voxels;
use crate::registration::symmetric3::{Symmetric3, inverse, surface_covariance};

/// Fewer returns than this define no distribution.
const LEAST_RETURNS: f32 = 6.0;
/// Added to the covariance: the variance of a range finder [m^2], and the share of the spread below which no direction
/// counts as known (Magnusson 2009, 6.2.1).
const LEAST_VARIANCE: f32 = 1e-4;
const LEAST_SHARE: f32 = 1e-3;

/// The distribution of the returns of one brick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(in crate::registration) struct Cell {
    /// Their mean [m].
    pub mean: [f32; 3],
    /// The mean of the covariances of its voxels as surface points; unknown when zero.
    pub surface: Symmetric3,
    /// The inverse of the covariance of the returns [1/m^2].
    pub information: Symmetric3,
}

impl Cell {
    /// Whether there were returns enough.
    #[inline(always)]
    pub fn is_known(&self) -> bool {
        self.surface[0] > 0.0
    }
}

/// The distributions of all bricks, under their numbers.
pub(super) fn fit(voxels: &Voxels, moments: &[Moments], planes: &[Plane]) -> Vec<Cell> {
    let cell_of = |(first, count): (u32, u32), centre: [f32; 3]| {
        let own = first as usize..(first + count) as usize;
        let mut total = Moments::default();
        moments[own.clone()].iter().for_each(|voxel| total.merge(voxel));
        if total.count < LEAST_RETURNS {
            return Cell::default();
        }
        let mut surface = [0.0; 6];
        for plane in &planes[own] {
            let covariance = surface_covariance(plane.normal);
            for k in 0..6 {
                surface[k] += covariance[k] / count as f32;
            }
        }
        let spread = total.spread();
        let mut covariance = spread.covariance;
        let least = LEAST_VARIANCE + LEAST_SHARE * (covariance[0] + covariance[3] + covariance[5]);
        for diagonal in [0, 3, 5] {
            covariance[diagonal] += least;
        }
        let mean = [centre[0] + spread.mean[0], centre[1] + spread.mean[1], centre[2] + spread.mean[2]];
        Cell { mean, surface, information: inverse(covariance, 1.0) }
    };
    let bricks = voxels.bricks.iter();
    bricks.map(|brick| cell_of((brick.first, brick.mask.count_ones()), voxels.centre(brick))).collect()
}
