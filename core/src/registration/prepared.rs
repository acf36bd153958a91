//! The keyframe of the built-in methods: thinned points in a k-d tree, with normals.

use std::any::Any;

use super::kdtree::KdTree;
use super::{PrepareError, PreparedScan, RegistrationConfig, normals, voxel};
use crate::scan::ScanView;

/// A scan reduced to the centroids of its voxels, indexed, with normals. All in the scanner's frame [m].
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedCloud {
    tree: KdTree,
    normals: Vec<[f32; 3]>,
}

impl PreparedCloud {
    /// Filters, thins, indexes and fits normals.
    ///
    /// # Errors
    /// [`PrepareError::NoPoints`] and [`PrepareError::TooFewPoints`].
    pub fn new(scan: ScanView<'_>, config: &RegistrationConfig) -> Result<Self, PrepareError> {
        let preparation = &config.preparation;
        let points = voxel::downsample(scan, preparation);
        if points.is_empty() {
            return Err(PrepareError::NoPoints {
                returns: scan.returns(),
                min_range_m: preparation.min_range_m,
                max_range_m: preparation.max_range_m,
            });
        }
        if points.len() < preparation.minimum_points {
            return Err(PrepareError::TooFewPoints { points: points.len(), required: preparation.minimum_points });
        }
        let tree = KdTree::new(points);
        let normals = normals::estimate(&tree, preparation, config.threads);
        Ok(Self { tree, normals })
    }

    /// The index over [`PreparedScan::points`].
    #[must_use]
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// Unit normals towards the scanner, under the indices of the points; zero where there is none.
    #[must_use]
    pub fn normals(&self) -> &[[f32; 3]] {
        &self.normals
    }
}

impl PreparedScan for PreparedCloud {
    fn points(&self) -> &[[f32; 3]] {
        self.tree.points()
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + self.tree.bytes() + self.normals.capacity() * size_of::<[f32; 3]>()
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
