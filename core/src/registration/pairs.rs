//! The pass every method makes at each step: find each source point's partner and sum what the method needs.

use nalgebra::Vector3;

use super::PreparedScan;
use super::keyframe::{Cell, LastBrick, PreparedCloud};
use crate::geometry::Pose;
use crate::{simd, threads};

/// Source points summed up by one thread at a time. Sums are combined in the order of the blocks.
const BLOCK: usize = 2048;
/// Pairs found before they are summed up.
pub(super) const BATCH: usize = 256;
/// Pairs summed up at once.
pub(super) const LANES: usize = 8;

/// Source points and their nearest points of the target, in the axes of the target's frame under the pose on trial,
/// side by side [m]. Past `count` the values mean nothing, but are finite.
#[derive(Debug, Clone)]
pub(super) struct Pairs<'a> {
    pub count: usize,
    /// The target's distributions, to which `cell` points.
    cells: &'a [Cell],
    with_source_planes: bool,
    /// The source point from its scanner: the arm with which a rotation moves it.
    pub arm: [[f32; BATCH]; 3],
    /// The source point in the target's frame.
    pub moved: [[f32; BATCH]; 3],
    /// Its partner.
    pub partner: [[f32; BATCH]; 3],
    /// The normal of the partner's plane, zero when it has none.
    pub normal: [[f32; BATCH]; 3],
    /// The distance of the source point from the partner's plane.
    pub residual: [f32; BATCH],
    /// The mean squared distance of the target's returns from that plane [m^2].
    pub variance: [f32; BATCH],
    /// The squared distance of the two points [m^2].
    pub distance_sq: [f32; BATCH],
    /// The normal of the source point's own plane, turned; zero when it has none or the method does not ask.
    pub source_normal: [[f32; BATCH]; 3],
    /// The distance of the source point from its own plane.
    pub source_residual: [f32; BATCH],
    /// The number of the target's brick into which the source point falls.
    cell: [u32; BATCH],
}

/// Which points of the scans take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Detail {
    /// One in each four voxels cubed, for the way from a distant start.
    Sparse,
    /// All.
    Full,
}

/// What a method adds up over the pairs.
pub(super) trait PairSum: Copy + Default + Send {
    /// What stays the same during one pass: scales, distances.
    type Settings: Sync;
    /// Whether it looks at the planes of the source points.
    const USES_SOURCE_PLANES: bool = false;

    /// Adds a batch of pairs.
    fn add(&mut self, settings: &Self::Settings, pairs: &Pairs<'_>);

    /// Adds the sum of another block.
    fn merge(&mut self, other: &Self);
}

/// Two scans.
#[derive(Clone, Copy)]
pub(super) struct Scans<'a> {
    pub target: &'a PreparedCloud,
    pub source: &'a PreparedCloud,
}

impl Scans<'_> {
    /// The number of source points that take part.
    pub fn count(&self, detail: Detail) -> usize {
        match detail {
            Detail::Sparse => self.source.sparse().1.len(),
            Detail::Full => self.source.points().len(),
        }
    }

    /// Sums over the source points that have a partner closer than `within_m` under `target_from_source`; `sums` is
    /// room for the blocks' sums.
    pub fn sum<S: PairSum>(
        &self,
        detail: Detail,
        target_from_source: &Pose,
        within_m: f64,
        threads: usize,
        settings: &S::Settings,
        sums: &mut Vec<S>,
    ) -> S {
        let search = Search::new(self, detail, target_from_source, within_m);
        let blocks = self.count(detail).div_ceil(BLOCK);
        sums.clear();
        sums.resize(blocks, S::default());
        threads::for_each(sums.iter_mut().enumerate(), threads.min(blocks), |(block, sum)| {
            simd::widest(|| search.block(block, settings, sum));
        });
        sums.iter().fold(S::default(), |mut total, sum| {
            total.merge(sum);
            total
        })
    }
}

/// The search of one pass.
struct Search<'a> {
    scans: Scans<'a>,
    detail: Detail,
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    within_sq: f32,
}

impl<'a> Search<'a> {
    fn new(scans: &Scans<'a>, detail: Detail, target_from_source: &Pose, within_m: f64) -> Self {
        let rotation = target_from_source.rotation.to_rotation_matrix().into_inner().map(|v| v as f32);
        let translation = target_from_source.translation.vector.map(|v| v as f32);
        Self {
            scans: *scans,
            detail,
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)])),
            translation: translation.into(),
            within_sq: (within_m * within_m) as f32,
        }
    }

    /// Finds the pairs of one block of source points and adds them up.
    #[inline(always)]
    fn block<S: PairSum>(&self, block: usize, settings: &S::Settings, sum: &mut S) {
        let cells = self.scans.target.cells();
        let (mut pairs, mut last) = (Pairs::new(cells, S::USES_SOURCE_PLANES), LastBrick::default());
        let (begin, end) = (block * BLOCK, ((block + 1) * BLOCK).min(self.scans.count(self.detail)));
        for place in begin..end {
            let index = match self.detail {
                Detail::Sparse => self.scans.source.sparse().1[place],
                Detail::Full => place as u32,
            };
            self.pair(index, &mut last, &mut pairs);
            if pairs.count == BATCH {
                sum.add(settings, &pairs);
                pairs.count = 0;
            }
        }
        sum.add(settings, &pairs);
    }

    /// Appends the pair of one source point, if it has a partner.
    #[inline(always)]
    fn pair(&self, index: u32, last: &mut LastBrick, pairs: &mut Pairs<'_>) {
        let p = self.scans.source.points()[index as usize];
        let (mut arm, mut moved) = ([0.0; 3], [0.0; 3]);
        for k in 0..3 {
            let row = self.rotation[k];
            arm[k] = row[0] * p[0] + row[1] * p[1] + row[2] * p[2];
            moved[k] = arm[k] + self.translation[k];
        }
        let target = self.scans.target;
        let found = match self.detail {
            Detail::Sparse => {
                let (tree, order) = target.sparse();
                tree.nearest(moved, self.within_sq).map(|(k, distance_sq)| (order[k as usize], distance_sq))
            }
            Detail::Full => target.voxels().nearest(target.points(), moved, self.within_sq, last),
        };
        let Some((partner, distance_sq)) = found else { return };
        let (point, plane) = (target.points()[partner as usize], &target.planes()[partner as usize]);
        if plane.is_seen_from_behind(&point, &self.translation, &arm) {
            return;
        }
        let n = pairs.count;
        for k in 0..3 {
            pairs.arm[k][n] = arm[k];
            pairs.moved[k][n] = moved[k];
            pairs.partner[k][n] = point[k];
            pairs.normal[k][n] = plane.normal[k];
        }
        let along: f32 = plane.normal[0] * moved[0] + plane.normal[1] * moved[1] + plane.normal[2] * moved[2];
        pairs.residual[n] = along - plane.offset;
        pairs.variance[n] = plane.variance;
        pairs.distance_sq[n] = distance_sq;
        pairs.cell[n] = last.number();
        if pairs.with_source_planes {
            let own = &self.scans.source.planes()[index as usize];
            for k in 0..3 {
                let row = self.rotation[k];
                pairs.source_normal[k][n] = row[0] * own.normal[0] + row[1] * own.normal[1] + row[2] * own.normal[2];
            }
            pairs.source_residual[n] = own.normal[0] * p[0] + own.normal[1] * p[1] + own.normal[2] * p[2] - own.offset;
        }
        pairs.count += 1;
    }
}

impl<'a> Pairs<'a> {
    fn new(cells: &'a [Cell], with_source_planes: bool) -> Self {
        let (vectors, numbers) = ([[0.0; BATCH]; 3], [0.0; BATCH]);
        Self {
            count: 0,
            cells,
            with_source_planes,
            arm: vectors,
            moved: vectors,
            partner: vectors,
            normal: vectors,
            residual: numbers,
            variance: numbers,
            distance_sq: numbers,
            source_normal: vectors,
            source_residual: numbers,
            cell: [0; BATCH],
        }
    }

    /// Whether the partner of pair k has a plane.
    #[inline(always)]
    pub fn has_plane(&self, k: usize) -> bool {
        self.normal[0][k] != 0.0 || self.normal[1][k] != 0.0 || self.normal[2][k] != 0.0
    }

    /// The distribution of the target's returns around the source point of pair k.
    #[inline(always)]
    pub fn cell(&self, k: usize) -> Option<&Cell> {
        self.cells.get(self.cell[k] as usize).filter(|cell| cell.is_known())
    }

    /// The way from the partner to the source point of pair k.
    #[inline(always)]
    pub fn offset(&self, k: usize) -> [f32; 3] {
        let along = |axis: usize| self.moved[axis][k] - self.partner[axis][k];
        [along(0), along(1), along(2)]
    }

    /// The normal of the partner of pair k.
    #[inline(always)]
    pub fn normal_of(&self, k: usize) -> [f32; 3] {
        [self.normal[0][k], self.normal[1][k], self.normal[2][k]]
    }

    /// The normal of the source point of pair k.
    #[inline(always)]
    pub fn source_normal_of(&self, k: usize) -> [f32; 3] {
        [self.source_normal[0][k], self.source_normal[1][k], self.source_normal[2][k]]
    }

    /// The source point of pair k.
    #[inline(always)]
    pub fn moved_point(&self, k: usize) -> Vector3<f64> {
        Vector3::new(self.moved[0][k], self.moved[1][k], self.moved[2][k]).map(f64::from)
    }

    /// The partner of pair k.
    #[inline(always)]
    pub fn partner_point(&self, k: usize) -> Vector3<f64> {
        Vector3::new(self.partner[0][k], self.partner[1][k], self.partner[2][k]).map(f64::from)
    }
}

#[cfg(test)]
mod tests {
    use crate::geometry::Pose;
    use crate::registration::test_scenes::{Rectangle, scan_of};
    use crate::registration::{Limits, RegistrationConfig, Registry};
    use crate::scan::ScanView;

    /// A hall, one face of the wall across its middle, and a high wall that is seen over that from both sides.
    fn half_of_a_hall(face_x_m: f64, scanner: &Pose, seed: u64) -> Vec<crate::scan::Point> {
        let scene: [Rectangle; 5] = [
            ([-10.0, -8.0, -1.0], [20.0, 0.0, 0.0], [0.0, 16.0, 0.0]),
            ([-10.0, -8.0, -1.0], [20.0, 0.0, 0.0], [0.0, 0.0, 3.0]),
            ([-10.0, 8.0, -1.0], [20.0, 0.0, 0.0], [0.0, 0.0, 3.0]),
            ([face_x_m, -8.0, -1.0], [0.0, 16.0, 0.0], [0.0, 0.0, 2.0]),
            ([9.0, -3.0, 2.5], [0.0, 6.0, 0.0], [0.0, 0.0, 1.5]),
        ];
        scan_of(&scene, scanner, 40.0, seed)
    }

    #[test]
    fn the_two_faces_of_a_wall_between_the_scanners_are_no_pairs() {
        let places = [Pose::translation(-4.0, 1.0, 0.0), Pose::translation(4.0, -1.0, 0.0)];
        let truth = places[0].inverse() * places[1];
        let scans = [half_of_a_hall(-0.125, &places[0], 1), half_of_a_hall(0.125, &places[1], 2)];
        for name in ["point_to_plane", "gicp", "vgicp", "symmetric_point_to_plane"] {
            let mut method = Registry::default().create(name, &RegistrationConfig::default()).unwrap();
            let source = method.prepare(ScanView::unordered(&scans[1])).unwrap();
            let target = method.prepare(ScanView::unordered(&scans[0])).unwrap();
            let found = method.align(&*target, &*source, &truth, &Limits::default()).unwrap();
            let off = (truth.inverse() * found.target_from_source).translation.vector.norm();
            assert!(off < 0.02, "{name}: {off} m");
        }
    }
}
