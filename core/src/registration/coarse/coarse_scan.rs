//! A scan as coarse alignment keeps it.

use super::range_image::RangeImage;
use super::{CoarseConfig, sampling, thinning};
use crate::registration::KdTree;

/// Planes are fitted to neighbours within so many cells.
const PLANE_RADIUS_CELLS: f64 = 3.0;

/// A scan reduced to one point a cube, with normals, and the ranges seen in every direction; all in the scanner's
/// frame [m]. It is made from the points of a keyframe, so that one that was stored serves as well as one just taken.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseScan {
    tree: KdTree,
    normals: Vec<[f32; 3]>,
    bins: Vec<u8>,
    sample: Vec<u32>,
    ranges: RangeImage,
    fingerprint: u64,
}

impl CoarseScan {
    /// Reduces points [m, scanner frame] that lie about `spacing_m` apart. Points that are not finite or beyond
    /// `config.max_range_m` are left out; a scan of which nothing is left is valid and fits nothing.
    #[must_use]
    pub fn new(points: &[[f32; 3]], spacing_m: f64, config: &CoarseConfig) -> Self {
        let tree = KdTree::new(thinning::thin(points, config.cell_m, config.max_range_m));
        let normals = thinning::normals(&tree, PLANE_RADIUS_CELLS * config.cell_m, config.threads);
        let bins = sampling::bins(&normals);
        let sample = sampling::even_over_directions(&bins, config.search_points);
        let fingerprint = fingerprint(tree.points());
        Self { tree, normals, bins, sample, ranges: RangeImage::new(points, spacing_m as f32), fingerprint }
    }

    /// One point a cube [m], in the order of the index.
    #[must_use]
    pub fn points(&self) -> &[[f32; 3]] {
        self.tree.points()
    }

    /// Unit normals towards the scanner, under the indices of the points; zero where no plane fits.
    #[must_use]
    pub fn normals(&self) -> &[[f32; 3]] {
        &self.normals
    }

    /// The indices of the points that are laid over another scan.
    #[must_use]
    pub fn sample(&self) -> &[u32] {
        &self.sample
    }

    /// The direction that each point's surface faces, as a number.
    pub(super) fn bins(&self) -> &[u8] {
        &self.bins
    }

    /// The index over [`CoarseScan::points`].
    pub(crate) fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// The ranges seen.
    pub(super) fn ranges(&self) -> &RangeImage {
        &self.ranges
    }

    /// The same for the same points.
    pub(super) fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// The memory it holds [bytes]: about 72 kB and 50 to 70 bytes a cube.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.tree.bytes()
            + self.normals.capacity() * size_of::<[f32; 3]>()
            + self.bins.capacity()
            + self.sample.capacity() * size_of::<u32>()
            + self.ranges.bytes()
    }
}

/// FNV-1a over the bits of the coordinates.
fn fingerprint(points: &[[f32; 3]]) -> u64 {
    points
        .iter()
        .flatten()
        .fold(0xcbf2_9ce4_8422_2325, |hash, v| (hash ^ u64::from(v.to_bits())).wrapping_mul(0x0000_0100_0000_01b3))
}
