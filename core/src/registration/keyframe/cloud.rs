//! A scan reduced to the centroids of its voxels, with tangent planes and an index for near and for far.

use std::any::Any;
use std::sync::{Mutex, OnceLock, PoisonError};

use super::cells::{self, Cell};
use super::moments::Moments;
use super::planes::{self, Plane};
use super::search::LastBrick;
use super::voxels::{self, Brick, Voxels};
use crate::registration::kdtree::KdTree;
use crate::registration::{PrepareError, PreparedScan, RegistrationConfig};
use crate::scan::ScanView;
use crate::simd;

/// What is fitted to the returns.
#[derive(Debug)]
struct Shape {
    planes: Vec<Plane>,
    cells: Vec<Cell>,
}

/// A scan reduced to the centroids of its voxels, with tangent planes. All in the scanner's frame [m].
#[derive(Debug)]
pub struct PreparedCloud {
    voxels: Voxels,
    points: Vec<[f32; 3]>,
    /// Fitted when first asked for: as a source the scan may never need them.
    shape: OnceLock<Shape>,
    /// What the shape is fitted to, until it is.
    moments: Mutex<Vec<Moments>>,
    threads: usize,
    /// One point of each brick, for the first steps, when much is still to be searched.
    sparse: KdTree,
    /// Of each sparse point, in the tree's order, the index of the point.
    sparse_of: Vec<u32>,
}

impl PreparedCloud {
    /// Filters and thins the scan, fits planes and indexes the points.
    ///
    /// # Errors
    /// [`PrepareError::NoPoints`] and [`PrepareError::TooFewPoints`].
    pub fn new(scan: ScanView<'_>, config: &RegistrationConfig) -> Result<Self, PrepareError> {
        let preparation = &config.preparation;
        let thinned = simd::widest(|| voxels::thin(scan, preparation));
        if thinned.moments.is_empty() {
            return Err(PrepareError::NoPoints {
                returns: scan.returns(),
                min_range_m: preparation.min_range_m,
                max_range_m: preparation.max_range_m,
            });
        }
        if thinned.moments.len() < preparation.minimum_points {
            let (points, required) = (thinned.moments.len(), preparation.minimum_points);
            return Err(PrepareError::TooFewPoints { points, required });
        }
        let points = thinned.centroids();
        let (sparse, sparse_of) = sparse(&thinned.voxels, &points, &thinned.moments);
        Ok(Self {
            voxels: thinned.voxels,
            points,
            shape: OnceLock::new(),
            moments: Mutex::new(thinned.moments),
            threads: config.threads,
            sparse,
            sparse_of,
        })
    }
}

impl PreparedCloud {
    /// The index and squared distance [m^2] of the point nearest to `query` [m, scanner frame] among those closer than
    /// `sqrt(bound_sq)`.
    #[must_use]
    pub fn nearest(&self, query: [f32; 3], bound_sq: f32) -> Option<(u32, f32)> {
        simd::widest(|| self.voxels.nearest(&self.points, query, bound_sq, &mut LastBrick::default()))
    }

    /// The tangent plane of a point, `normal . x = offset`: unit normal towards the scanner, and offset [m]; `None` where
    /// the returns around it span no plane.
    #[must_use]
    pub fn plane(&self, index: usize) -> Option<([f32; 3], f32)> {
        self.planes().get(index).filter(|plane| plane.normal != [0.0; 3]).map(|plane| (plane.normal, plane.offset))
    }

    /// The tangent planes, under the indices of the points.
    pub(in crate::registration) fn planes(&self) -> &[Plane] {
        &self.shape().planes
    }

    /// The distributions of the returns, under the numbers of the bricks.
    pub(in crate::registration) fn cells(&self) -> &[Cell] {
        &self.shape().cells
    }

    fn shape(&self) -> &Shape {
        self.shape.get_or_init(|| {
            let moments = std::mem::take(&mut *self.moments.lock().unwrap_or_else(PoisonError::into_inner));
            let planes = planes::fit(&self.voxels, &moments, self.threads);
            let cells = cells::fit(&self.voxels, &moments, &planes);
            Shape { planes, cells }
        })
    }

    /// The voxels that [`PreparedScan::points`] are the centroids of.
    pub(in crate::registration) fn voxels(&self) -> &Voxels {
        &self.voxels
    }

    /// One point in each four voxels cubed.
    pub(in crate::registration) fn sparse(&self) -> (&KdTree, &[u32]) {
        (&self.sparse, &self.sparse_of)
    }
}

impl Shape {
    fn bytes(&self) -> usize {
        self.planes.capacity() * size_of::<Plane>() + self.cells.capacity() * size_of::<Cell>()
    }
}

/// Of each brick the point that most returns speak for, in a tree.
fn sparse(voxels: &Voxels, points: &[[f32; 3]], moments: &[Moments]) -> (KdTree, Vec<u32>) {
    let best_of = |brick: &Brick| {
        let own = brick.first..brick.first + brick.mask.count_ones();
        own.fold((brick.first, 0.0), |best, index| {
            let count = moments[index as usize].count;
            if count > best.1 { (index, count) } else { best }
        })
    };
    let chosen: Vec<u32> = voxels.bricks.iter().map(|brick| best_of(brick).0).collect();
    let chosen_points: Vec<[f32; 3]> = chosen.iter().map(|index| points[*index as usize]).collect();
    let (tree, order) = KdTree::with_order(&chosen_points);
    (tree, order.into_iter().map(|k| chosen[k as usize]).collect())
}

impl PreparedScan for PreparedCloud {
    fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.voxels.bytes()
            + self.points.capacity() * size_of::<[f32; 3]>()
            + self.shape.get().map_or(0, Shape::bytes)
            + self.moments.lock().unwrap_or_else(PoisonError::into_inner).capacity() * size_of::<Moments>()
            + self.sparse.bytes()
            + self.sparse_of.capacity() * size_of::<u32>()
    }

    fn prepare_as_target(&self) {
        self.shape();
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
