//! The model so far: all aligned scans, thinned. It moves with corrected poses, and takes bounded memory and bandwidth
//! however long a run is.

use std::collections::{BTreeMap, HashMap};

use mirador_core::geometry::Pose;

use crate::points::ScoredPoint;

/// Points kept of a scan at first.
const KEPT_OF_SCAN: usize = 8_000;
/// Points kept of all scans together; beyond it every second point of every scan goes.
const KEPT: usize = 400_000;
/// Most points of the model as it is drawn.
pub(crate) const DRAWN: usize = 30_000;
/// Side of the first voxels, of which each shows its best point [m]; it doubles when there are too many.
const VOXEL_M: f32 = 0.1;

/// Thinned scans in the scanner's frame, and how finely they are drawn.
pub(crate) struct Model {
    scans: BTreeMap<u32, Vec<ScoredPoint>>,
    voxel_m: f32,
}

impl Model {
    pub(crate) fn new() -> Self {
        Self { scans: BTreeMap::new(), voxel_m: VOXEL_M }
    }

    /// Keeps a part of an aligned scan.
    pub(crate) fn add(&mut self, scan: u32, points: &[ScoredPoint]) {
        let step = points.len().div_ceil(KEPT_OF_SCAN).max(1);
        self.scans.insert(scan, points.iter().step_by(step).copied().collect());
        while self.scans.values().map(Vec::len).sum::<usize>() > KEPT {
            for points in self.scans.values_mut() {
                *points = points.iter().step_by(2).copied().collect();
            }
        }
    }

    /// The best point of every voxel of the map, at the present poses; scans without one are left out.
    pub(crate) fn points(&mut self, poses: &BTreeMap<u32, Pose>) -> Vec<ScoredPoint> {
        loop {
            match self.try_points(poses) {
                Some(points) => return points,
                None => self.voxel_m *= 2.0,
            }
        }
    }

    /// `None` when there are more than can be drawn.
    fn try_points(&self, poses: &BTreeMap<u32, Pose>) -> Option<Vec<ScoredPoint>> {
        let mut found: Vec<ScoredPoint> = Vec::new();
        let mut places: HashMap<[i32; 3], usize> = HashMap::new();
        for (scan, points) in &self.scans {
            let Some(pose) = poses.get(scan).map(|pose| pose.cast::<f32>()) else { continue };
            for (position, quality) in points {
                let position: [f32; 3] = (pose * nalgebra::Point3::from(*position)).coords.into();
                let voxel = position.map(|c| (c / self.voxel_m).floor() as i32);
                let place = *places.entry(voxel).or_insert(found.len());
                match found.get_mut(place) {
                    None if place == DRAWN => return None,
                    None => found.push((position, *quality)),
                    Some(best) if best.1 < *quality => *best = (position, *quality),
                    Some(_) => {}
                }
            }
        }
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(n: usize, quality: f32) -> Vec<ScoredPoint> {
        (0..n).map(|k| ([k as f32 * 0.5, 0.0, 0.0], Some(quality))).collect()
    }

    #[test]
    fn a_place_seen_twice_shows_its_best_point() {
        let mut model = Model::new();
        model.add(0, &along(5, 0.25));
        model.add(1, &along(3, 0.75));
        let poses: BTreeMap<_, _> = (0..2).map(|scan| (scan, Pose::identity())).collect();
        let qualities: Vec<_> = model.points(&poses).iter().map(|p| p.1).collect();
        assert_eq!(qualities, [Some(0.75), Some(0.75), Some(0.75), Some(0.25), Some(0.25)]);
    }

    #[test]
    fn the_model_moves_with_its_poses_and_leaves_out_scans_without_one() {
        let mut model = Model::new();
        model.add(0, &along(2, 0.5));
        model.add(1, &along(2, 0.5));
        let poses = BTreeMap::from([(1, Pose::translation(0.0, 7.0, 0.0))]);
        assert_eq!(model.points(&poses).iter().map(|p| p.0).collect::<Vec<_>>(), [[0.0, 7.0, 0.0], [0.5, 7.0, 0.0]]);
    }

    #[test]
    fn memory_and_drawing_are_bounded() {
        let mut model = Model::new();
        let poses: BTreeMap<_, _> = (0..120).map(|n| (n, Pose::translation(0.0, f64::from(n) * 3.0, 0.0))).collect();
        for scan in 0..120 {
            model.add(scan, &along(9_000, 0.5));
        }
        let kept: usize = model.scans.values().map(Vec::len).sum();
        assert!(kept <= KEPT && kept > KEPT / 4, "{kept}");
        let drawn = model.points(&poses).len();
        assert!(drawn <= DRAWN && drawn > DRAWN / 16, "{drawn}");
    }
}
