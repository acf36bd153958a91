//! A k-d tree over f32 points whose leaves are blocks of eight, stored in the order of the leaves.
//!
//! Every split is on the widest axis and leaves a whole number of blocks on the left, so all blocks but the last are
//! full, the shape of the tree follows from the number of points alone, and no node needs a pointer.

/// Points of a leaf.
const LANES: usize = 8;
/// Enough for 2^32 points: one pending subtree a level.
const MAX_DEPTH: usize = 32;

/// Where an inner node splits space.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Split {
    axis: u32,
    value: f32,
}

/// A point and its number among those given.
type Entry = ([f32; 3], u32);

/// Eight points side by side; lanes past the end are at infinity and never nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block {
    axes: [[f32; LANES]; 3],
}

/// A k-d tree. It orders the points itself; indices refer to [`KdTree::points`].
#[derive(Debug, Clone, PartialEq)]
pub struct KdTree {
    points: Vec<[f32; 3]>,
    blocks: Vec<Block>,
    splits: Vec<Split>,
}

/// A subtree put off: inner node, range of blocks, offset of the query from its cell along each axis and squared.
#[derive(Clone, Copy)]
struct Pending {
    node: u32,
    first: u32,
    last: u32,
    offset: [f32; 3],
    distance_sq: f32,
}

impl KdTree {
    /// Builds the tree over finite points; it keeps them, in its own order.
    #[must_use]
    pub fn new(points: Vec<[f32; 3]>) -> Self {
        Self::with_order(&points).0
    }

    /// Builds the tree over finite points; also tells which of the given points each of the tree's is.
    #[must_use]
    pub fn with_order(points: &[[f32; 3]]) -> (Self, Vec<u32>) {
        let block_count = points.len().div_ceil(LANES);
        let mut splits = Vec::with_capacity(block_count.saturating_sub(1));
        let mut entries: Vec<Entry> = points.iter().copied().zip(0..).collect();
        split_range(&mut entries, &mut splits);
        let (points, order): (Vec<_>, Vec<_>) = entries.into_iter().unzip();
        let blocks = points.chunks(LANES).map(block_of).collect();
        (Self { points, blocks, splits }, order)
    }

    /// The points in the order of the leaves: neighbours in space are mostly neighbours here.
    #[must_use]
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// The memory it holds [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.points.capacity() * size_of::<[f32; 3]>()
            + self.blocks.capacity() * size_of::<Block>()
            + self.splits.capacity() * size_of::<Split>()
    }

    /// The index and squared distance of the point nearest to `query` among those closer than `sqrt(bound_sq)`, or
    /// `None` when there is none. Of points at the same distance it returns the same one every time.
    #[must_use]
    pub fn nearest(&self, query: [f32; 3], bound_sq: f32) -> Option<(u32, f32)> {
        let mut best = bound_sq;
        let mut index = None;
        self.visit(
            query,
            |first, distances| {
                for (lane, distance) in distances.iter().enumerate() {
                    if *distance < best {
                        best = *distance;
                        index = Some(first + lane as u32);
                    }
                }
                best
            },
            bound_sq,
        );
        index.map(|index| (index, best))
    }

    /// Fills `neighbours` with the points nearest to `query` closer than `sqrt(bound_sq)`, nearest first.
    pub fn nearest_many(&self, query: [f32; 3], bound_sq: f32, neighbours: &mut Neighbours) {
        neighbours.clear(bound_sq);
        self.visit(
            query,
            |first, distances| {
                for (lane, distance) in distances.iter().enumerate() {
                    if *distance < neighbours.bound_sq {
                        neighbours.insert(first + lane as u32, *distance);
                    }
                }
                neighbours.bound_sq
            },
            bound_sq,
        );
    }

    /// Shows `leaf` every block that may hold a point closer than the bound it last returned.
    #[inline(always)]
    fn visit(&self, query: [f32; 3], mut leaf: impl FnMut(u32, &[f32; LANES]) -> f32, mut bound_sq: f32) {
        let root = Pending { node: 0, first: 0, last: self.blocks.len() as u32, offset: [0.0; 3], distance_sq: 0.0 };
        let mut stack = [root; MAX_DEPTH];
        let mut height = usize::from(!self.blocks.is_empty());
        while height > 0 {
            height -= 1;
            let mut cell = stack[height];
            if cell.distance_sq >= bound_sq {
                continue;
            }
            while cell.last - cell.first > 1 {
                let split = self.splits[cell.node as usize];
                let left_blocks = (cell.last - cell.first) / 2;
                let middle = cell.first + left_blocks;
                let axis = split.axis as usize;
                let offset = query[axis] - split.value;
                let mut far = cell;
                far.offset[axis] = offset;
                far.distance_sq = squared(far.offset);
                if offset < 0.0 {
                    (far.node, far.first) = (cell.node + left_blocks, middle);
                    (cell.node, cell.last) = (cell.node + 1, middle);
                } else {
                    (far.node, far.last) = (cell.node + 1, middle);
                    (cell.node, cell.first) = (cell.node + left_blocks, middle);
                }
                if far.distance_sq < bound_sq {
                    stack[height] = far;
                    height += 1;
                }
            }
            let distances = self.blocks[cell.first as usize].distances_sq(query);
            bound_sq = leaf(cell.first * LANES as u32, &distances);
        }
    }
}

impl Block {
    /// The squared distances of the eight points from `query`.
    #[inline(always)]
    fn distances_sq(&self, query: [f32; 3]) -> [f32; LANES] {
        let [xs, ys, zs] = &self.axes;
        std::array::from_fn(|lane| squared([query[0] - xs[lane], query[1] - ys[lane], query[2] - zs[lane]]))
    }
}

/// The squared length. One order of additions everywhere keeps the bound of a cell below the distance of its points.
#[inline(always)]
fn squared(v: [f32; 3]) -> f32 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// Orders a range of points into a subtree and appends its splits: the node, its left subtree, its right subtree.
fn split_range(points: &mut [Entry], splits: &mut Vec<Split>) {
    let blocks = points.len().div_ceil(LANES);
    if blocks < 2 {
        return;
    }
    let axis = widest_axis(points);
    let (left, middle, _) = points.select_nth_unstable_by(blocks / 2 * LANES, |a, b| a.0[axis].total_cmp(&b.0[axis]));
    splits.push(Split { axis: axis as u32, value: middle.0[axis] });
    let boundary = left.len();
    let (left, right) = points.split_at_mut(boundary);
    split_range(left, splits);
    split_range(right, splits);
}

/// The axis along which the points spread most.
fn widest_axis(points: &[Entry]) -> usize {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for (point, _) in points {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let width: [f32; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
    (0..3).fold(0, |widest, axis| if width[axis] > width[widest] { axis } else { widest })
}

/// Up to eight points side by side.
fn block_of(points: &[[f32; 3]]) -> Block {
    let axes = std::array::from_fn(|axis| {
        std::array::from_fn(|lane| points.get(lane).map_or(f32::INFINITY, |point| point[axis]))
    });
    Block { axes }
}

/// The k nearest points of a query, in a buffer to be used again.
#[derive(Debug, Clone)]
pub struct Neighbours {
    found: Vec<(f32, u32)>,
    most: usize,
    bound_sq: f32,
}

impl Neighbours {
    /// Room for the `most` nearest points.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self { found: Vec::with_capacity(most.max(1)), most: most.max(1), bound_sq: 0.0 }
    }

    /// Squared distances and indices, nearest first.
    #[must_use]
    pub fn found(&self) -> &[(f32, u32)] {
        &self.found
    }

    fn clear(&mut self, bound_sq: f32) {
        self.found.clear();
        self.bound_sq = bound_sq;
    }

    #[inline]
    fn insert(&mut self, index: u32, distance_sq: f32) {
        if self.found.len() == self.most {
            self.found.pop();
        }
        let mut place = self.found.len();
        self.found.push((distance_sq, index));
        while place > 0 && self.found[place - 1].0 > distance_sq {
            self.found.swap(place - 1, place);
            place -= 1;
        }
        if self.found.len() == self.most {
            self.bound_sq = self.found[self.most - 1].0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sorted_distances(points: &[[f32; 3]], query: [f32; 3]) -> Vec<f32> {
        let mut all: Vec<f32> =
            points.iter().map(|p| squared([query[0] - p[0], query[1] - p[1], query[2] - p[2]])).collect();
        all.sort_by(f32::total_cmp);
        all
    }

    proptest! {
        #[test]
        fn it_finds_what_looking_at_every_point_finds(
            // Few distinct values make many ties.
            points in prop::collection::vec(prop::array::uniform3((-20i32..20).prop_map(|v| v as f32 * 0.5)), 0..200),
            query in prop::array::uniform3(-12.0f32..12.0),
            bound in 0.1f32..12.0,
        ) {
            let tree = KdTree::new(points);
            let expected: Vec<f32> =
                sorted_distances(tree.points(), query).into_iter().filter(|d| *d < bound * bound).collect();
            let nearest = tree.nearest(query, bound * bound);
            prop_assert_eq!(nearest.map(|n| n.1), expected.first().copied());
            if let Some((index, distance)) = nearest {
                let p = tree.points()[index as usize];
                prop_assert_eq!(distance, squared([query[0] - p[0], query[1] - p[1], query[2] - p[2]]));
            }
            let mut neighbours = Neighbours::new(7);
            tree.nearest_many(query, bound * bound, &mut neighbours);
            let found: Vec<f32> = neighbours.found().iter().map(|n| n.0).collect();
            prop_assert_eq!(found, expected.iter().copied().take(7).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_tree_without_points_has_no_nearest() {
        assert_eq!(KdTree::new(Vec::new()).nearest([0.0; 3], 1.0), None);
    }
}
