//! Branch and bound over the lattice of poses.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::{Translation3, Vector3};

use super::lattice::{self, Offsets, Rotated};
use super::occupancy::{LEVELS, OCCUPIED, Occupancy};
use super::{CoarseConfig, CoarseScan, SearchRange};
use crate::geometry::Pose;
use crate::threads;

/// Two poses nearer than this and turned by less than `SAME_TURN` are one maximum [m].
pub(super) const SAME_SHIFT_M: f64 = 1.75;
/// See `SAME_SHIFT_M` [rad].
pub(super) const SAME_TURN: f64 = 0.2;
/// Nodes opened at a time, by all threads together.
const BATCH: usize = 96;

/// A maximum of the overlap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Maximum {
    /// The pose, on the lattice.
    pub target_from_source: Pose,
    /// The value of the cubes overlapped, as a share of the most there can be.
    pub overlap: f64,
}

/// A set of offsets under one rotation: a window of 2^level cubes along each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Node {
    bound: u32,
    level: u8,
    rotation: u32,
    offset: [i32; 3],
}

impl Ord for Node {
    /// The highest bound first, then the finest, then in the order of the lattice, so that ties never depend on chance.
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |node: &Self| (node.bound, u8::MAX - node.level, u32::MAX - node.rotation, node.offset);
        key(self).cmp(&key(other))
    }
}

impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// A search under way: it gives one maximum after the other, the best first.
#[derive(Debug)]
pub(super) struct Search<'a> {
    space: Space<'a>,
    heap: BinaryHeap<Node>,
    batch: Vec<Node>,
    maxima: Vec<Maximum>,
    /// What the overlap of all cubes is worth.
    most: u32,
    threads: usize,
    max_evaluations: usize,
    /// How often the source's cubes were laid over the target's.
    pub evaluations: usize,
    /// The search ended before it could tell that no better maximum exists.
    pub cut_short: bool,
}

impl<'a> Search<'a> {
    /// Begins to look for maxima of the overlap of `source` with the target's cubes, within the range about `initial`.
    pub fn new(
        grid: &'a Occupancy,
        source: &CoarseScan,
        initial: &'a Pose,
        range: &SearchRange,
        config: &CoarseConfig,
    ) -> Self {
        let space = Space::new(grid, source, initial, range, config);
        let heap = space.roots(config.threads);
        Self {
            evaluations: heap.len(),
            space,
            heap,
            batch: Vec::with_capacity(BATCH),
            maxima: Vec::with_capacity(config.hypotheses),
            most: source.sample().len() as u32 * u32::from(OCCUPIED),
            threads: config.threads,
            max_evaluations: config.max_evaluations,
            cut_short: false,
        }
    }

    /// The best maximum of those not yet given, if its overlap is greater than `floor`.
    pub fn next(&mut self, floor: f64) -> Option<Maximum> {
        let floor = (floor * f64::from(self.most)) as u32;
        loop {
            if self.evaluations >= self.max_evaluations {
                self.cut_short = true;
                return None;
            }
            match self.space.take(&mut self.heap, &mut self.batch, floor, &self.maxima) {
                Next::Nothing => return None,
                Next::Open => {
                    let children = self.space.children(&self.batch, self.threads);
                    self.evaluations += children.len();
                    self.heap.extend(children);
                }
                Next::Maximum(node) => {
                    let overlap = f64::from(node.bound) / f64::from(self.most);
                    let maximum = Maximum { target_from_source: self.space.pose(&node), overlap };
                    self.maxima.push(maximum);
                    return Some(maximum);
                }
            }
        }
    }
}

/// Everything a search looks at.
#[derive(Debug)]
struct Space<'a> {
    grid: &'a Occupancy,
    initial: &'a Pose,
    rotated: Vec<Rotated>,
    offsets: Offsets,
    cell_m: f64,
}

/// What is to be done next.
enum Next {
    /// No node is worth opening.
    Nothing,
    /// The nodes of the batch are to be opened.
    Open,
    /// Nothing that is left can be above this single pose.
    Maximum(Node),
}

impl<'a> Space<'a> {
    fn new(
        grid: &'a Occupancy,
        source: &CoarseScan,
        initial: &'a Pose,
        range: &SearchRange,
        config: &CoarseConfig,
    ) -> Self {
        let rotations = lattice::rotations(initial, range, config);
        let mut rotated: Vec<Rotated> =
            rotations.into_iter().map(|rotation| Rotated { rotation, cubes: Vec::new() }).collect();
        let part = rotated.len().div_ceil(4 * config.threads).max(1);
        threads::for_each(rotated.chunks_mut(part), config.threads, |part| {
            for entry in part {
                let points = source.sample().iter().filter_map(|index| source.points().get(*index as usize).copied());
                *entry = lattice::rotated(grid, points, entry.rotation, &initial.translation.vector);
            }
        });
        Self { grid, initial, rotated, offsets: lattice::offsets(initial, range, config.cell_m), cell_m: config.cell_m }
    }

    /// The widest windows over all offsets, for every rotation.
    fn roots(&self, threads: usize) -> BinaryHeap<Node> {
        let Offsets { low, high } = self.offsets;
        let step = 1 << (LEVELS - 1);
        let along = |axis: usize| (low[axis]..=high[axis]).step_by(step);
        let mut nodes = Vec::new();
        for rotation in 0..self.rotated.len() as u32 {
            for x in along(0) {
                for y in along(1) {
                    nodes.extend(along(2).map(|z| Node {
                        bound: 0,
                        level: LEVELS as u8 - 1,
                        rotation,
                        offset: [x, y, z],
                    }));
                }
            }
        }
        self.evaluate(&mut nodes, threads);
        nodes.into()
    }

    /// Fills `batch` with the nodes to open next.
    fn take(&self, heap: &mut BinaryHeap<Node>, batch: &mut Vec<Node>, floor: u32, maxima: &[Maximum]) -> Next {
        batch.clear();
        while batch.len() < BATCH {
            let Some(node) = heap.peek().copied().filter(|node| node.bound > floor) else { break };
            let known = self.is_known(&node, maxima);
            if node.level == 0 && !known {
                if !batch.is_empty() {
                    // What is about to be opened has a higher bound.
                    break;
                }
                heap.pop();
                return Next::Maximum(node);
            }
            heap.pop();
            if !known {
                batch.push(node);
            }
        }
        if batch.is_empty() { Next::Nothing } else { Next::Open }
    }

    /// The eighths of each window, as far as they lie within the offsets.
    fn children(&self, parents: &[Node], threads: usize) -> Vec<Node> {
        let mut nodes = Vec::with_capacity(8 * parents.len());
        for parent in parents {
            let level = parent.level - 1;
            for corner in 0..8 {
                let offset: [i32; 3] =
                    std::array::from_fn(|axis| parent.offset[axis] + ((corner >> axis & 1) << level));
                if (0..3).all(|axis| offset[axis] <= self.offsets.high[axis]) {
                    nodes.push(Node { bound: 0, level, rotation: parent.rotation, offset });
                }
            }
        }
        self.evaluate(&mut nodes, threads);
        nodes
    }

    /// Sets the bounds.
    fn evaluate(&self, nodes: &mut [Node], threads: usize) {
        // Fewer than this are done before a second thread has started.
        let workers = if nodes.len() < 2 * BATCH { 1 } else { threads };
        let part = nodes.len().div_ceil(4 * workers).max(1);
        threads::for_each(nodes.chunks_mut(part), workers, |part| {
            for node in part {
                if let Some(rotated) = self.rotated.get(node.rotation as usize) {
                    node.bound = self.grid.overlap(usize::from(node.level), &rotated.cubes, node.offset);
                }
            }
        });
    }

    /// The pose of a node's first offset.
    fn pose(&self, node: &Node) -> Pose {
        let offset = Vector3::from(node.offset.map(|o| f64::from(o) * self.cell_m));
        let rotation = self.rotated.get(node.rotation as usize).map_or(self.initial.rotation, |r| r.rotation);
        Pose::from_parts(Translation3::from(self.initial.translation.vector + offset), rotation)
    }

    /// Whether all of a node's poses belong to a maximum that was found.
    fn is_known(&self, node: &Node, maxima: &[Maximum]) -> bool {
        let width = f64::from((1 << node.level) - 1) * self.cell_m;
        let pose = self.pose(node);
        maxima.iter().any(|maximum| {
            let shift = pose.translation.vector - maximum.target_from_source.translation.vector;
            let farthest = shift.map(|s| s.abs().max((s + width).abs()));
            farthest.norm() < SAME_SHIFT_M && pose.rotation.angle_to(&maximum.target_from_source.rotation) < SAME_TURN
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    use super::*;
    use crate::registration::coarse::depth_by_depth::overlapping;
    use crate::registration::test_scenes::{YARD, scan_of};

    fn yard(seed: u64) -> CoarseScan {
        let config = CoarseConfig { search_points: 120, threads: 1, ..CoarseConfig::default() };
        let pose = Pose::new(Vector3::new(0.3 * seed as f64, 0.2, 0.0), Vector3::new(0.0, 0.0, 0.1 * seed as f64));
        let points: Vec<[f32; 3]> = scan_of(&YARD, &pose, 12.0, seed + 1).iter().map(|p| [p.x, p.y, p.z]).collect();
        CoarseScan::new(&points, 0.25, &config)
    }

    /// The poses of the lattice, and the overlap of each as the source counts it.
    fn exhaustive(grid: &Occupancy, source: &CoarseScan, initial: &Pose, range: &SearchRange) -> Vec<(Pose, u32)> {
        let config = CoarseConfig::default();
        let points: Vec<[f32; 3]> = source.sample().iter().map(|k| source.points()[*k as usize]).collect();
        let Offsets { low, high } = lattice::offsets(initial, range, config.cell_m);
        let mut all = Vec::new();
        for rotation in lattice::rotations(initial, range, &config) {
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        let offset = Vector3::new(x, y, z).map(f64::from) * config.cell_m;
                        let pose = Pose::from_parts((initial.translation.vector + offset).into(), rotation);
                        all.push((pose, overlapping(grid, &points, &pose)));
                    }
                }
            }
        }
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn it_finds_the_overlap_that_trying_every_pose_finds(
            seed in 0u64..4,
            shift in prop::array::uniform3(-1.0..1.0f64),
            yaw in -0.3..0.3f64,
        ) {
            let (target, source) = (yard(seed), yard(seed + 1));
            let grid = Occupancy::new(target.points(), 0.5);
            let initial =
                Pose::from_parts(Vector3::from(shift).into(), UnitQuaternion::from_scaled_axis(Vector3::z() * yaw));
            let range = SearchRange { translation_m: 2.0, height_m: 0.5, yaw: 0.2, tilt: 0.0, ..SearchRange::default() };
            let all = exhaustive(&grid, &source, &initial, &range);
            let config = CoarseConfig { threads: 1, ..CoarseConfig::default() };
            let mut search = Search::new(&grid, &source, &initial, &range, &config);
            let worth = |overlap: u32| f64::from(overlap) / f64::from(search.most);
            let most = all.iter().map(|(_, overlap)| *overlap).max().unwrap();
            let (most, all): (f64, Vec<_>) = (worth(most), all.iter().map(|(pose, o)| (*pose, worth(*o))).collect());
            let first = search.next(0.0).unwrap();
            // Half a cube's corner may fall either way when a pose is multiplied out in another order.
            prop_assert!((first.overlap - most).abs() < 0.01, "{} {most}", first.overlap);
            // The second is the best of those that are not the first.
            let other = |pose: &Pose| {
                let shift = pose.translation.vector - first.target_from_source.translation.vector;
                shift.norm() >= SAME_SHIFT_M || pose.rotation.angle_to(&first.target_from_source.rotation) >= SAME_TURN
            };
            let second = all.iter().filter(|(pose, _)| other(pose)).map(|(_, o)| *o).fold(0.0, f64::max);
            if let Some(found) = search.next(0.0) {
                prop_assert!((found.overlap - second).abs() < 0.01, "{} {second}", found.overlap);
            }
        }
    }
}
