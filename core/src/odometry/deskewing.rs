//! The frame's points, carried to where the end of the scan sees them.

use super::Odometry;
use super::deskew::MotionTable;
use super::reduce::Centroid;
use crate::geometry::Twist;

/// Points that take part in alignments in coarse voxels.
const COARSE_POINTS: usize = 1500;

impl Odometry {
    pub(super) fn has_times(&self) -> bool {
        self.config.deskew && self.centroids.iter().any(|c| c.time > 0.0)
    }

    fn table(&self, motion: &Twist) -> Option<MotionTable> {
        (self.has_times() && motion.norm() > 0.0).then(|| MotionTable::new(motion))
    }

    /// The points to be aligned, at the end of the scan.
    pub(super) fn deskew_selected(&mut self, motion: &Twist) {
        let table = self.table(motion);
        let points = self.selected.iter().filter_map(|k| self.centroids.get(*k as usize));
        self.deskewed.clear();
        self.deskewed.extend(points.map(|c| carried(table.as_ref(), c)));
        self.frame.set_points(self.deskewed.iter().copied());
        self.thinned.set_thinned(&self.frame, COARSE_POINTS);
    }

    /// All centroids, at the end of the scan.
    pub(super) fn deskew_all(&mut self, motion: &Twist) {
        let table = self.table(motion);
        self.deskewed.clear();
        self.deskewed.extend(self.centroids.iter().map(|c| carried(table.as_ref(), c)));
    }

    /// Puts the first frame into the map anew while it is alone there, now that the second has told how the scanner was
    /// moving.
    pub(super) fn deskew_first(&mut self, motion: &Twist) {
        if self.first.is_empty() {
            return;
        }
        let table = MotionTable::new(motion);
        self.map.clear();
        self.deskewed.clear();
        self.deskewed.extend(self.first.iter().map(|c| carried(Some(&table), c)));
        self.map.insert(&self.deskewed, &self.track.pose(), self.config.threads);
    }
}

fn carried(table: Option<&MotionTable>, centroid: &Centroid) -> [f32; 3] {
    table.map_or(centroid.point, |table| table.end_from(centroid.time, centroid.point))
}
