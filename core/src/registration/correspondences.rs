//! The pass every method makes at each step: find each source point's partner and sum what the method needs.

use nalgebra::Vector3;

use super::PreparedScan;
use super::prepared::PreparedCloud;
use crate::geometry::Pose;
use crate::threads;

/// Source points summed up by one thread at a time. Sums are combined in the order of the blocks.
const BLOCK: usize = 1024;
/// No partner found so far.
const NO_PARTNER: u32 = u32::MAX;

/// A source point and its nearest point of the target, both in the source's frame under the pose on trial [m]: that
/// is the frame in which a perturbation on the right acts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    /// The source point.
    pub source: Vector3<f64>,
    /// Its partner.
    pub target: Vector3<f64>,
    /// The partner's normal, zero when it has none.
    pub normal: Vector3<f64>,
    /// Their squared distance [m^2].
    pub distance_sq: f64,
}

/// What a method adds up over the pairs.
pub(super) trait PairSum: Copy + Default + Send {
    /// What stays the same during one pass: scales, distances.
    type Settings: Sync;

    /// Adds one pair.
    fn add(&mut self, settings: &Self::Settings, pair: &Pair);

    /// Adds the sum of another block.
    fn merge(&mut self, other: &Self);
}

/// One block of source points: the partners found last and the block's sum.
#[derive(Debug, Clone, Default)]
struct Block<S> {
    partners: Vec<u32>,
    sum: S,
}

/// Finds partners and sums over them; holds the buffers between passes.
#[derive(Debug, Clone, Default)]
pub(super) struct Matcher<S> {
    blocks: Vec<Block<S>>,
}

impl<S: PairSum> Matcher<S> {
    /// Forgets the partners of an earlier alignment.
    pub fn start(&mut self, source: &PreparedCloud) {
        let count = source.points().len();
        self.blocks.resize_with(count.div_ceil(BLOCK), Block::default);
        for (k, block) in self.blocks.iter_mut().enumerate() {
            block.partners.clear();
            block.partners.resize(BLOCK.min(count - k * BLOCK), NO_PARTNER);
        }
    }

    /// Sums over the source points that have a partner closer than `within_m` under `target_from_source`.
    pub fn sum(
        &mut self,
        target: &PreparedCloud,
        source: &PreparedCloud,
        target_from_source: &Pose,
        within_m: f64,
        threads: usize,
        settings: &S::Settings,
    ) -> S {
        let search = Search::new(target, target_from_source, within_m);
        let most = threads.min(self.blocks.len());
        threads::for_each(self.blocks.iter_mut().enumerate(), most, |(k, block)| {
            block.sum = S::default();
            for (point, partner) in source.points().iter().skip(k * BLOCK).zip(&mut block.partners) {
                if let Some(pair) = search.pair(*point, partner) {
                    block.sum.add(settings, &pair);
                }
            }
        });
        self.blocks.iter().fold(S::default(), |mut total, block| {
            total.merge(&block.sum);
            total
        })
    }
}

/// The search of one pass.
struct Search<'a> {
    target: &'a PreparedCloud,
    rotation: nalgebra::Matrix3<f64>,
    translation: Vector3<f64>,
    within_sq: f32,
}

impl<'a> Search<'a> {
    fn new(target: &'a PreparedCloud, target_from_source: &Pose, within_m: f64) -> Self {
        Self {
            target,
            rotation: target_from_source.rotation.to_rotation_matrix().into_inner(),
            translation: target_from_source.translation.vector,
            within_sq: (within_m * within_m) as f32,
        }
    }

    /// The pair of one source point. The partner of the last pass bounds the search: it is mostly still the nearest.
    #[inline]
    fn pair(&self, point: [f32; 3], partner: &mut u32) -> Option<Pair> {
        let source = Vector3::from(point.map(f64::from));
        let moved = self.rotation * source + self.translation;
        let query = [moved.x as f32, moved.y as f32, moved.z as f32];
        let points = self.target.points();
        let mut bound_sq = self.within_sq;
        let mut nearest = None;
        if let Some(last) = points.get(*partner as usize) {
            let offset: [f32; 3] = std::array::from_fn(|k| query[k] - last[k]);
            let distance_sq = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
            if distance_sq < bound_sq {
                bound_sq = distance_sq;
                nearest = Some(*partner);
            }
        }
        if let Some((closer, _)) = self.target.tree().nearest(query, bound_sq) {
            nearest = Some(closer);
        }
        let index = nearest? as usize;
        *partner = index as u32;
        let partner_point = Vector3::from(points.get(index)?.map(f64::from));
        let normal = Vector3::from(self.target.normals().get(index)?.map(f64::from));
        let target = self.rotation.tr_mul(&(partner_point - self.translation));
        let distance_sq = (source - target).norm_squared();
        Some(Pair { source, target, normal: self.rotation.tr_mul(&normal), distance_sq })
    }
}
