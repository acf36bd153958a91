//! The map the scans are aligned with: planes in voxels of two sizes, around the scanner, in bounded memory.

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::level::{Level, LevelHead};
use super::surfel::Surfel;
use crate::geometry::Pose;
use crate::threads;

/// A voxel of the coarse level is so many of the fine one wide.
pub(super) const COARSE_FACTOR: i32 = 2;
/// The share of the voxels a sweep looks at: after eight frames every far voxel is gone.
const SWEEP_SHARE: f32 = 0.125;

/// Two levels of voxels. Coordinates handed to it are local: single precision from an origin near the scanner, which
/// is whole coarse voxels away from the map's, so that kilometres cost no digits.
#[derive(Debug)]
pub(super) struct LocalMap {
    pub fine: Level,
    pub coarse: Level,
    /// The local origin, in coarse voxels.
    origin: [i32; 3],
    /// Voxels farther than this are removed [m].
    radius_m: f32,
    /// What remains of it while the map is too full.
    shrunk_m: f32,
}

/// What stands beside the bytes of a map's voxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct MapHead {
    levels: [LevelHead; 2],
    origin: [i32; 3],
    shrunk_m: f32,
}

/// A pose in local coordinates: rotation and translation from the local origin [m].
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalPose {
    pub rotation: [[f32; 3]; 3],
    pub translation: [f32; 3],
}

impl LocalPose {
    /// The point in local coordinates.
    #[inline(always)]
    pub fn transform(&self, p: [f32; 3]) -> [f32; 3] {
        let (r, t) = (&self.rotation, &self.translation);
        [
            r[0][0] * p[0] + r[0][1] * p[1] + r[0][2] * p[2] + t[0],
            r[1][0] * p[0] + r[1][1] * p[1] + r[1][2] * p[2] + t[1],
            r[2][0] * p[0] + r[2][1] * p[1] + r[2][2] * p[2] + t[2],
        ]
    }
}

impl LocalMap {
    pub fn new(voxel_m: f64, radius_m: f64, most_voxels: usize) -> Self {
        Self {
            fine: Level::new(voxel_m as f32, most_voxels),
            coarse: Level::new(voxel_m as f32 * COARSE_FACTOR as f32, most_voxels / 2),
            origin: [0; 3],
            radius_m: radius_m as f32,
            shrunk_m: radius_m as f32,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.fine.len() == 0
    }

    pub fn bytes(&self) -> usize {
        self.fine.bytes() + self.coarse.bytes()
    }

    pub fn clear(&mut self) {
        self.fine.clear();
        self.coarse.clear();
        self.shrunk_m = self.radius_m;
    }

    /// Moves the local origin next to a place in the map.
    pub fn recentre(&mut self, map_from_scanner: &Pose) {
        let edge = f64::from(self.coarse.edge_m());
        // Saturates far out, where the caller has refused the pose already.
        self.origin = [0, 1, 2].map(|k: usize| (map_from_scanner.translation.vector[k] / edge).round() as i32);
    }

    fn origin_m(&self) -> Vector3<f64> {
        Vector3::from(self.origin.map(|v| f64::from(v) * f64::from(self.coarse.edge_m())))
    }

    /// A pose in local coordinates.
    pub fn local(&self, map_from_scanner: &Pose) -> LocalPose {
        let rotation: Matrix3<f64> = map_from_scanner.rotation.to_rotation_matrix().into_inner();
        let translation = map_from_scanner.translation.vector - self.origin_m();
        LocalPose {
            rotation: [0, 1, 2].map(|r: usize| [0, 1, 2].map(|c: usize| rotation[(r, c)] as f32)),
            translation: translation.cast::<f32>().into(),
        }
    }

    fn fine_origin(&self) -> [i32; 3] {
        let [x, y, z] = self.origin;
        [x.wrapping_mul(COARSE_FACTOR), y.wrapping_mul(COARSE_FACTOR), z.wrapping_mul(COARSE_FACTOR)]
    }

    /// The plane of a fine voxel, given relative to the local origin.
    #[inline]
    pub fn fine_surfel(&self, voxel: [i32; 3]) -> Option<&Surfel> {
        self.fine.surfel(sum(voxel, self.fine_origin()))
    }

    /// The plane of a coarse voxel, given relative to the local origin.
    #[inline]
    pub fn coarse_surfel(&self, voxel: [i32; 3]) -> Option<&Surfel> {
        self.coarse.surfel(sum(voxel, self.origin))
    }

    /// Adds the points of a frame to both levels, fits the planes they touched, and takes away what is far.
    pub fn insert(&mut self, points: &[[f32; 3]], map_from_scanner: &Pose, threads: usize) {
        let pose = self.local(map_from_scanner);
        let (origin, fine_origin) = (self.origin, self.fine_origin());
        if self.fine.is_crowded() || self.coarse.is_crowded() {
            self.shrunk_m *= 0.9;
        } else {
            self.shrunk_m = (1.02 * self.shrunk_m).min(self.radius_m);
        }
        let radius = self.shrunk_m;
        // One level a thread: neither depends on the other.
        let levels = [(&mut self.fine, fine_origin), (&mut self.coarse, origin)];
        threads::for_each(levels.into_iter(), threads.min(2), |(level, origin)| {
            for point in points {
                let local = pose.transform(*point);
                let voxel = level.voxel(local);
                let corner = level.corner(voxel);
                level.add(sum(voxel, origin), [local[0] - corner[0], local[1] - corner[1], local[2] - corner[2]]);
            }
            level.fit();
            let centre = sum(level.voxel(pose.translation), origin);
            level.sweep(centre, radius / level.edge_m(), SWEEP_SHARE);
        });
    }

    /// The map as bytes, and what stands beside them.
    pub fn write(&self, out: &mut Vec<u8>) -> MapHead {
        let levels = [self.fine.write(out), self.coarse.write(out)];
        MapHead { levels, origin: self.origin, shrunk_m: self.shrunk_m }
    }

    /// Takes over what [`Self::write`] wrote, into an empty map; what is left of the bytes. `None` when they are not
    /// such bytes.
    pub fn read<'b>(&mut self, head: &MapHead, bytes: &'b [u8]) -> Option<&'b [u8]> {
        (self.origin, self.shrunk_m) = (head.origin, head.shrunk_m);
        let rest = self.fine.read(&head.levels[0], bytes)?;
        self.coarse.read(&head.levels[1], rest)
    }

    /// The mean of every fine voxel [m, map frame].
    pub fn points(&self) -> impl Iterator<Item = Point3<f64>> {
        let edge = f64::from(self.fine.edge_m());
        self.fine.surfels(self.fine_origin()).map(move |(voxel, surfel)| {
            Point3::from(Vector3::from(voxel).cast::<f64>() * edge + Vector3::from(surfel.mean).cast::<f64>())
        })
    }
}

#[inline(always)]
fn sum(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0].wrapping_add(b[0]), a[1].wrapping_add(b[1]), a[2].wrapping_add(b[2])]
}
