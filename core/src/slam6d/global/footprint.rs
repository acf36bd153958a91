//! Where the points of a keyframe lie, coarsely: enough to predict how much of one scan another has seen.

use crate::geometry::Pose;

/// Side of a cell [m]: above the error of a pose that can be registered without help, below the size of a room.
const CELL_M: f64 = 1.5;
/// Most sample points.
const SAMPLES: usize = 256;
/// Bits of a cell's index along an axis: 1,024 cells reach 768 m to every side.
const BITS: u32 = 10;

/// The occupied cells of a keyframe and a sample of its points, in the scanner's frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Footprint {
    /// Ascending, each once.
    cells: Box<[u32]>,
    samples: Box<[[f32; 3]]>,
}

impl Footprint {
    /// The footprint of reduced points.
    pub fn new(points: &[[f32; 3]]) -> Self {
        let mut cells: Vec<u32> = points.iter().filter_map(|p| cell(p.map(f64::from))).collect();
        cells.sort_unstable();
        cells.dedup();
        // One point a cell, so that what is near the scanner, where points are dense, does not count more.
        let stride = cells.len().div_ceil(SAMPLES).max(1);
        let wanted: Vec<u32> = cells.iter().copied().step_by(stride).collect();
        let mut samples: Vec<Option<[f32; 3]>> = vec![None; wanted.len()];
        for point in points {
            let place = cell(point.map(f64::from)).and_then(|cell| wanted.binary_search(&cell).ok());
            if let Some(sample) = place.and_then(|k| samples.get_mut(k)) {
                sample.get_or_insert(*point);
            }
        }
        Self { cells: cells.into(), samples: samples.into_iter().flatten().collect() }
    }

    /// The share of this footprint that lies where `target` has points, in [0, 1], if the poses are right.
    pub fn overlap_with(&self, target: &Self, target_from_self: &Pose) -> f64 {
        let isometry = target_from_self.cast::<f32>();
        let inside = self.samples.iter().filter(|point| {
            let seen = isometry * nalgebra::Point3::from(**point);
            cell([seen.x.into(), seen.y.into(), seen.z.into()]).is_some_and(|c| target.cells.binary_search(&c).is_ok())
        });
        inside.count() as f64 / self.samples.len().max(1) as f64
    }

    /// The memory held beside the struct itself [bytes].
    pub fn heap_bytes(&self) -> usize {
        size_of_val(&*self.cells) + size_of_val(&*self.samples)
    }
}

/// The cell of a point; `None` beyond the indices.
fn cell(point: [f64; 3]) -> Option<u32> {
    let half = 1_i64 << (BITS - 1);
    point.iter().try_fold(0_u32, |packed, value| {
        let index = (value / CELL_M).floor() as i64 + half;
        (0..2 * half).contains(&index).then_some(packed << BITS | index as u32)
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::registration::test_scenes::{YARD, scan_of};

    fn yard(pose: &Pose, seed: u64) -> Footprint {
        let points: Vec<[f32; 3]> = scan_of(&YARD, pose, 20.0, seed).iter().map(|p| [p.x, p.y, p.z]).collect();
        Footprint::new(&points)
    }

    #[test]
    fn two_scans_of_one_place_overlap_and_two_of_distant_places_do_not() {
        let first = yard(&Pose::identity(), 1);
        let moved = Pose::new(Vector3::new(1.0, 0.5, 0.0), Vector3::z() * 0.8);
        let second = yard(&moved, 2);
        assert!(second.overlap_with(&first, &moved) > 0.9);
        let far = Pose::new(Vector3::new(40.0, 0.0, 0.0), Vector3::zeros());
        assert!(second.overlap_with(&first, &far) < 0.05);
    }

    #[test]
    fn a_point_beyond_the_cells_is_in_none() {
        assert_eq!(cell([1e6, 0.0, 0.0]), None);
        assert_eq!(cell([0.0, 0.0, -800.0]), None);
        assert!(cell([0.0, 0.0, -700.0]).is_some());
    }

    #[test]
    fn the_footprint_of_nothing_overlaps_nothing() {
        let nothing = Footprint::new(&[]);
        assert!(nothing.overlap_with(&yard(&Pose::identity(), 1), &Pose::identity()) < f64::EPSILON);
    }
}
