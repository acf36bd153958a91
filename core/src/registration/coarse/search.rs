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
/// A maximum below this share of the best is not followed up.
const WORTHWHILE: f64 = 0.55;
/// Nodes opened at a time, by all threads together.
const BATCH: usize = 64;

/// A maximum of the overlap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Maximum {
    /// The pose, on the lattice.
    pub target_from_source: Pose,
    /// The value of the cubes overlapped, as a share of the most there can be.
    pub overlap: f64,
}

/// What a search found.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Found {
    /// Different maxima, the best first.
    pub maxima: Vec<Maximum>,
    /// How often the source's cubes were laid over the target's.
    pub evaluations: usize,
    /// The search ended before it could tell that no better maximum exists.
    pub cut_short: bool,
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

/// Everything a search looks at.
struct Space<'a> {
    grid: &'a Occupancy,
    initial: &'a Pose,
    rotated: Vec<Rotated>,
    offsets: Offsets,
    cell_m: f64,
}

/// The best maxima of the overlap of `source` with the target's cubes, within the range about `initial`.
pub(super) fn branch_and_bound(
    grid: &Occupancy,
    source: &CoarseScan,
    initial: &Pose,
    range: &SearchRange,
    config: &CoarseConfig,
) -> Found {
    let most = source.sample().len() as u32 * u32::from(OCCUPIED);
    if most == 0 {
        return Found::default();
    }
    let space = Space::new(grid, source, initial, range, config);
    let mut heap = space.roots(config.threads);
    let mut found = Found { evaluations: heap.len(), ..Found::default() };
    let mut batch = Vec::with_capacity(BATCH);
    while found.maxima.len() < config.hypotheses {
        if found.evaluations >= config.max_evaluations {
            found.cut_short = true;
            break;
        }
        let floor = found.maxima.first().map_or(0, |best| (best.overlap * WORTHWHILE * f64::from(most)) as u32);
        match space.take(&mut heap, &mut batch, floor, &found.maxima) {
            Next::Nothing => break,
            Next::Open => {
                let children = space.children(&batch, config.threads);
                found.evaluations += children.len();
                heap.extend(children);
            }
            Next::Maximum(node) => {
                let overlap = f64::from(node.bound) / f64::from(most);
                found.maxima.push(Maximum { target_from_source: space.pose(&node), overlap });
            }
        }
    }
    found
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
