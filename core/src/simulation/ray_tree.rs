//! Rays from one place against triangles, many at a time.
//!
//! parry's hierarchy is built once and copied to a flat array of 32-byte nodes. Rays go through it in packets that share
//! their origin, as those of a laser, a camera or a ranger do: what depends on box, triangle and origin alone is worked
//! out once a packet, and the lanes of a packet are the lanes of a vector register.

// Lanes are counted: zipping the many arrays of a packet hides from the compiler that they are of one length.
#![allow(clippy::needless_range_loop)]

use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode, TraversalAction};

/// Subtrees of up to so many triangles become one leaf: a triangle costs about as much as a box.
const LEAF_TRIANGLES: u32 = 4;
/// How much the triangles' boxes are widened: [m], and as a share of the largest coordinate, both far above the rounding
/// of the box test.
const BOX_MARGIN_M: f32 = 1e-4;
const BOX_MARGIN_SHARE: f32 = 1e-6;
/// Components of directions below this are taken for this, so that no inverse is infinite.
const LEAST_COMPONENT: f32 = 1e-18;
/// How much larger than they are triangles are taken, as a share of the volumes that are compared.
const EDGE_MARGIN: f32 = 4e-7;
/// A ray that runs along a triangle within this cosine of its normal does not meet it: it has no thickness.
const LEAST_COSINE: f32 = 1e-6;
/// The triangle of a ray that meets none.
pub(super) const NOTHING: u32 = u32::MAX;

/// The corners of a triangle, map frame [m].
pub(super) type Corners = [[f32; 3]; 3];

/// A box, and what is in it.
#[derive(Clone, Copy)]
struct Node {
    low: [f32; 3],
    /// Of an inner node the left child, the right one follows; of a leaf its first triangle.
    first: u32,
    high: [f32; 3],
    /// Triangles of a leaf; 0 marks an inner node.
    count: u16,
    /// Axis along which the left child lies lower than the right one.
    axis: u16,
}

/// A triangle in the order of the leaves.
#[derive(Clone, Copy)]
struct LeafTriangle {
    corners: Corners,
    id: u32,
}

/// The hierarchy over a set of triangles.
pub(super) struct RayTree {
    bvh: Bvh,
    nodes: Vec<Node>,
    triangles: Vec<LeafTriangle>,
}

/// Up to `N` rays from one origin, and the nearest triangle each has met.
pub(super) struct Packet<const N: usize> {
    origin: [f64; 3],
    /// x, y and z of the directions.
    direction: [[f32; N]; 3],
    inverse: [[f32; N]; 3],
    /// Range of the nearest hit so far, at first the range limit [m]. Negative in lanes without a ray.
    pub(super) nearest: [f32; N],
    /// Its triangle, or [`NOTHING`].
    pub(super) triangle: [u32; N],
}

impl<const N: usize> Packet<N> {
    /// A packet without rays.
    pub(super) fn new(origin: [f64; 3]) -> Self {
        Self { origin, direction: [[1.0; N]; 3], inverse: [[1.0; N]; 3], nearest: [-1.0; N], triangle: [NOTHING; N] }
    }

    /// Puts a ray of this limit [m] into a lane; `direction` has unit length.
    #[inline]
    pub(super) fn set(&mut self, lane: usize, direction: [f64; 3], range_max: f32) {
        for axis in 0..3 {
            let component = direction[axis] as f32;
            self.direction[axis][lane] = component;
            let safe = if component.abs() < LEAST_COMPONENT { LEAST_COMPONENT.copysign(component) } else { component };
            self.inverse[axis][lane] = 1.0 / safe;
        }
        self.nearest[lane] = range_max;
        self.triangle[lane] = NOTHING;
    }

    /// Whether any ray enters the box before its nearest hit.
    #[inline(always)]
    fn meets(&self, node: &Node, origin: &[f32; 3]) -> bool {
        let [lx, ly, lz] = [node.low[0] - origin[0], node.low[1] - origin[1], node.low[2] - origin[2]];
        let [hx, hy, hz] = [node.high[0] - origin[0], node.high[1] - origin[1], node.high[2] - origin[2]];
        let [ix, iy, iz] = &self.inverse;
        let mut met = 0_u32;
        for k in 0..N {
            let (x0, x1) = (lx * ix[k], hx * ix[k]);
            let (y0, y1) = (ly * iy[k], hy * iy[k]);
            let (z0, z1) = (lz * iz[k], hz * iz[k]);
            let enters = larger(larger(smaller(x0, x1), smaller(y0, y1)), larger(smaller(z0, z1), 0.0));
            let leaves = smaller(smaller(larger(x0, x1), larger(y0, y1)), smaller(larger(z0, z1), self.nearest[k]));
            met |= u32::from(enters <= leaves);
        }
        met != 0
    }

    /// Shortens the rays that meet the triangle, from either side. The sign of each edge's volume decides: neighbours
    /// that share an edge get exactly opposite values for it, so that no ray slips between them; and triangles are
    /// taken larger by the rounding of these values, some 20 micrometres at 50 m, so that none slips through a corner.
    #[inline(always)]
    fn test(&mut self, triangle: &LeafTriangle) {
        // In double precision, since the products of far corners nearly cancel.
        let [a, b, c] = &triangle.corners;
        let o = &self.origin;
        let (a, b, c) = (from(a, o), from(b, o), from(c, o));
        let normal = cross(&difference(&b, &a), &difference(&c, &a));
        let height = (normal[0] * a[0] + normal[1] * a[1] + normal[2] * a[2]) as f32;
        let (ab, bc, ca) = (single(&cross(&a, &b)), single(&cross(&b, &c)), single(&cross(&c, &a)));
        let margin = EDGE_MARGIN * larger(larger(sum(&ab), sum(&bc)), sum(&ca));
        let [x, y, z] = &self.direction;
        let mut inside = [0_u32; N];
        let mut any = 0_u32;
        for k in 0..N {
            let u = x[k] * ab[0] + y[k] * ab[1] + z[k] * ab[2];
            let v = x[k] * bc[0] + y[k] * bc[1] + z[k] * bc[2];
            let w = x[k] * ca[0] + y[k] * ca[1] + z[k] * ca[2];
            let least = smaller(smaller(u, v), w);
            let most = larger(larger(u, v), w);
            inside[k] = u32::from(least >= -margin) | u32::from(most <= margin);
            any |= inside[k];
        }
        if any == 0 {
            return;
        }
        let normal = single(&normal);
        let least_fall = LEAST_COSINE * sum(&normal);
        for k in 0..N {
            let fall = x[k] * normal[0] + y[k] * normal[1] + z[k] * normal[2];
            let range = height / fall;
            // At the same range the first triangle counts, in whatever order they are met.
            let nearer = range < self.nearest[k] || (range == self.nearest[k] && triangle.id < self.triangle[k]);
            if inside[k] != 0 && fall.abs() > least_fall && range >= 0.0 && nearer {
                self.nearest[k] = range;
                self.triangle[k] = triangle.id;
            }
        }
    }
}

impl RayTree {
    /// Builds the hierarchy over triangles; their index names them.
    pub(super) fn new(corners: &[Corners]) -> Self {
        let boxes: Vec<_> = corners.iter().map(bounds).collect();
        let bvh = Bvh::from_leaves(BvhBuildStrategy::Ploc, &boxes);
        let (nodes, triangles) = Copied::of(&bvh).flatten(corners);
        Self { bvh, nodes, triangles }
    }

    /// parry's own hierarchy; its leaves are the triangles.
    pub(super) fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// Finds the nearest triangle of every ray of the packet. `stack` is scratch.
    #[inline(always)]
    pub(super) fn trace<const N: usize>(&self, packet: &mut Packet<N>, stack: &mut Vec<u32>) {
        if self.nodes.is_empty() {
            return;
        }
        let origin = single(&packet.origin);
        // The order in which the children of a node are visited follows the first ray.
        let backwards = [0, 1, 2].map(|axis: usize| u32::from(packet.direction[axis][0] < 0.0));
        stack.clear();
        stack.push(0);
        while let Some(id) = stack.pop() {
            let node = &self.nodes[id as usize];
            if !packet.meets(node, &origin) {
                continue;
            }
            if node.count > 0 {
                let first = node.first as usize;
                for triangle in &self.triangles[first..first + usize::from(node.count)] {
                    packet.test(triangle);
                }
            } else {
                let near = backwards[usize::from(node.axis)];
                stack.push(node.first + (1 - near));
                stack.push(node.first + near);
            }
        }
    }
}

/// parry's tree as pairs of siblings in the order in which it shows them, and the pair below every inner node.
struct Copied {
    nodes: Vec<BvhNode>,
    /// Of each node the first of its two children, or 0.
    children: Vec<usize>,
    /// Triangles below each node.
    leaves: Vec<u32>,
}

impl Copied {
    fn of(bvh: &Bvh) -> Self {
        let mut nodes = Vec::new();
        bvh.traverse(|node| {
            nodes.push(*node);
            TraversalAction::Continue
        });
        let mut children = vec![0; nodes.len()];
        // parry goes down the left child first and comes back to the right one: a stack in the same order tells whose
        // children the next pair are. The first pair are the root's.
        let mut open = vec![];
        for pair in (0..nodes.len()).step_by(2) {
            if let Some(parent) = open.pop() {
                children[parent] = pair;
            }
            for node in [pair + 1, pair] {
                if nodes.get(node).is_some_and(|node: &BvhNode| !node.is_leaf()) {
                    open.push(node);
                }
            }
        }
        // Children stand behind their parents.
        let mut leaves = vec![1; nodes.len()];
        for node in (0..nodes.len()).rev().filter(|&node| children[node] > 0) {
            leaves[node] = leaves[children[node]] + leaves[children[node] + 1];
        }
        Self { nodes, children, leaves }
    }

    /// The tree as one array, small subtrees as leaves, and the triangles in the order of the leaves.
    fn flatten(&self, corners: &[Corners]) -> (Vec<Node>, Vec<LeafTriangle>) {
        let mut triangles = Vec::with_capacity(corners.len());
        let Some(first) = self.nodes.first() else { return (Vec::new(), triangles) };
        let Some(second) = self.nodes.get(1) else {
            self.gather(0, corners, &mut triangles);
            return (vec![leaf(first, 0, triangles.len())], triangles);
        };
        let mut flat = vec![inner(first, second)];
        // Pairs still to be copied: where their parent is in the new array, and where they are in the old one.
        let mut open = vec![(0, 0)];
        while let Some((parent, pair)) = open.pop() {
            let at = flat.len();
            let axis = usize::from(flat[parent].axis);
            let (left, right) = (&self.nodes[pair], &self.nodes[pair + 1]);
            let in_order = left.center()[axis] <= right.center()[axis];
            flat[parent].first = at as u32;
            for old in if in_order { [pair, pair + 1] } else { [pair + 1, pair] } {
                let node = &self.nodes[old];
                if self.leaves[old] <= LEAF_TRIANGLES {
                    let first = triangles.len();
                    self.gather(old, corners, &mut triangles);
                    flat.push(leaf(node, first, triangles.len()));
                } else {
                    let children = self.children[old];
                    open.push((flat.len(), children));
                    flat.push(inner(&self.nodes[children], &self.nodes[children + 1]));
                }
            }
        }
        (flat, triangles)
    }

    /// Appends the triangles below a node.
    fn gather(&self, node: usize, corners: &[Corners], triangles: &mut Vec<LeafTriangle>) {
        if let Some(id) = self.nodes[node].leaf_data() {
            triangles.extend(corners.get(id as usize).map(|&corners| LeafTriangle { corners, id }));
        } else {
            let children = self.children[node];
            self.gather(children, corners, triangles);
            self.gather(children + 1, corners, triangles);
        }
    }
}

/// An inner node over two siblings; where they lie is filled in later.
fn inner(left: &BvhNode, right: &BvhNode) -> Node {
    let (low, high) = (left.mins().min(right.mins()), left.maxs().max(right.maxs()));
    let apart = (left.center() - right.center()).abs();
    let axis = if apart.x >= apart.y && apart.x >= apart.z { 0 } else { 1 + u16::from(apart.z > apart.y) };
    Node { low: low.into(), first: 0, high: high.into(), count: 0, axis }
}

fn leaf(node: &BvhNode, first: usize, end: usize) -> Node {
    let (low, high) = (node.mins().into(), node.maxs().into());
    Node { low, first: first as u32, high, count: (end - first) as u16, axis: 0 }
}

fn bounds(corners: &Corners) -> Aabb {
    let corners = corners.map(Vector::from);
    let (low, high) = (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
    let largest = low.abs().max(high.abs()).max_element();
    let margin = Vector::splat(BOX_MARGIN_M + BOX_MARGIN_SHARE * largest);
    Aabb::new(low - margin, high + margin)
}

// `f32::min` and `f32::max` treat NaN with care that costs three instructions; nothing here is NaN.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn from(point: &[f32; 3], origin: &[f64; 3]) -> [f64; 3] {
    [f64::from(point[0]) - origin[0], f64::from(point[1]) - origin[1], f64::from(point[2]) - origin[2]]
}

#[inline(always)]
fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The sum of the components' sizes.
#[inline(always)]
fn sum(v: &[f32; 3]) -> f32 {
    v[0].abs() + v[1].abs() + v[2].abs()
}

#[inline(always)]
fn single(v: &[f64; 3]) -> [f32; 3] {
    [v[0] as f32, v[1] as f32, v[2] as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest triangle by trying all of them (Moller and Trumbore 1997, double precision).
    fn by_all(corners: &[Corners], origin: &[f64; 3], ray: &[f64; 3]) -> Option<f64> {
        let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let ranges = corners.iter().filter_map(|[a, b, c]| {
            let (a, b, c) = (from(a, origin), from(b, origin), from(c, origin));
            let (e1, e2) = (difference(&b, &a), difference(&c, &a));
            let p = cross(ray, &e2);
            let determinant = dot(&e1, &p);
            let t = a.map(|v| -v);
            let u = dot(&t, &p) / determinant;
            let q = cross(&t, &e1);
            let v = dot(ray, &q) / determinant;
            let range = dot(&e2, &q) / determinant;
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && range >= 0.0).then_some(range)
        });
        ranges.min_by(f64::total_cmp)
    }

    fn trace<const N: usize>(tree: &RayTree, origin: [f64; 3], rays: &[[f64; 3]]) -> Vec<(u32, f32)> {
        let mut packet = Packet::<N>::new(origin);
        for (lane, ray) in rays.iter().enumerate() {
            packet.set(lane, *ray, 1e4);
        }
        tree.trace(&mut packet, &mut Vec::new());
        (0..rays.len()).map(|lane| (packet.triangle[lane], packet.nearest[lane])).collect()
    }

    proptest! {
        #[test]
        fn packets_and_single_rays_find_what_trying_all_triangles_finds(
            seeds in prop::collection::vec(prop::array::uniform9(-1.0..1.0_f32), 1..120),
            places in prop::collection::vec(prop::array::uniform3(-20.0..20.0_f32), 120),
            origin in prop::array::uniform3(-25.0..25.0_f64),
            rays in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 16),
        ) {
            let corners: Vec<Corners> = seeds.iter().zip(&places).map(|(s, p)| {
                [0, 1, 2].map(|k: usize| [p[0] + 4.0 * s[3 * k], p[1] + 4.0 * s[3 * k + 1], p[2] + 4.0 * s[3 * k + 2]])
            }).collect();
            let rays: Vec<[f64; 3]> = rays.iter().map(|r| {
                let n = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt().max(1e-9);
                [r[0] / n, r[1] / n, r[2] / n]
            }).filter(|r| r.iter().any(|c| c.abs() > 0.1)).collect();
            let tree = RayTree::new(&corners);
            let packet = trace::<16>(&tree, origin, &rays);
            for (ray, found) in rays.iter().zip(&packet) {
                prop_assert_eq!(trace::<1>(&tree, origin, std::slice::from_ref(ray))[0], *found);
                let all = by_all(&corners, &origin, ray);
                // At the very edge of a triangle the two may differ; then the next one behind is met, or none.
                if let (Some(range), Some([a, b, c])) = (all, corners.get(found.0 as usize)) {
                    // Along a surface single precision says little about where it is met.
                    let (a, b, c) = (from(a, &origin), from(b, &origin), from(c, &origin));
                    let n = cross(&difference(&b, &a), &difference(&c, &a));
                    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
                    let cosine = (n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]).abs() / length;
                    let error = (range - f64::from(found.1)).abs();
                    prop_assert!(error * cosine < 2e-5 * (1.0 + range), "{} {:?}", range, found);
                } else {
                    prop_assert!(all.is_none() == (found.0 == NOTHING), "{:?} {:?}", all, found);
                }
            }
        }
    }

    #[test]
    fn no_ray_slips_through_a_closed_surface_from_within() {
        // A sphere of small triangles, far from the origin of the map, whose corners are rounded to single precision.
        let (rings, sides) = (60, 90);
        let at = |ring: usize, side: usize| {
            let (polar, azimuth) = (
                std::f64::consts::PI * ring as f64 / rings as f64,
                std::f64::consts::TAU * (side % sides) as f64 / sides as f64,
            );
            [
                300.3 + 7.0 * polar.sin() * azimuth.cos(),
                -200.7 + 7.0 * polar.sin() * azimuth.sin(),
                50.1 + 7.0 * polar.cos(),
            ]
            .map(|v| v as f32)
        };
        let mut corners = Vec::new();
        for ring in 0..rings {
            for side in 0..sides {
                corners.push([at(ring, side), at(ring + 1, side), at(ring + 1, side + 1)]);
                corners.push([at(ring, side), at(ring + 1, side + 1), at(ring, side + 1)]);
            }
        }
        let tree = RayTree::new(&corners);
        let origin = [300.9, -201.1, 49.2];
        // Straight at corners and at the middles of edges, where a gap would be.
        for triangle in &corners {
            for k in 0..3 {
                let (a, b) = (from(&triangle[k], &origin), from(&triangle[(k + 1) % 3], &origin));
                for to in [a, [0, 1, 2].map(|axis: usize| 0.5 * (a[axis] + b[axis]))] {
                    let n = (to[0] * to[0] + to[1] * to[1] + to[2] * to[2]).sqrt();
                    let found = trace::<1>(&tree, origin, &[to.map(|v| v / n)])[0];
                    assert!((f64::from(found.1) - n).abs() < 1e-3, "{to:?} {found:?}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_met_where_nothing_is() {
        let tree = RayTree::new(&[]);
        assert_eq!(trace::<1>(&tree, [0.0; 3], &[[1.0, 0.0, 0.0]])[0].0, NOTHING);
        let one = RayTree::new(&[[[5.0, -1.0, -1.0], [5.0, 1.0, -1.0], [5.0, 0.0, 1.0]]]);
        assert_eq!(trace::<1>(&one, [0.0; 3], &[[1.0, 0.0, 0.0]])[0], (0, 5.0));
        assert_eq!(trace::<1>(&one, [0.0; 3], &[[-1.0, 0.0, 0.0]])[0].0, NOTHING);
    }
}
