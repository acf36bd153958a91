//! The surface of one scan, as the builder leaves it.

use nalgebra::Vector3;

use super::discarded::DiscardedTriangle;
use super::mesh::TRIANGLE_CORNERS;
use super::neighbours::NeighbourList;
use super::topology::Topology;

/// The geometry of one point of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfacePoint {
    /// The unit normal in the scanner's frame, turned towards the scanner (3.13); zero where there is none.
    pub normal: [f32; 3],
    /// A(p), the point's share of the surface [m^2] (3.12).
    pub area: f32,
    /// |v.n|, v the unit ray (3.26).
    pub incidence: f32,
    /// D, in [0, 1] (3.27).
    pub quality: f32,
}

impl SurfacePoint {
    /// Whether the point belongs to the surface.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.normal != [0.0; 3]
    }
}

/// The surface of one scan: geometry per point, under the point's own index, in the scanner's frame.
#[derive(Debug, Default)]
pub struct Surface {
    pub(super) points: Vec<SurfacePoint>,
    pub(super) topology: Option<Topology>,
    /// The grid of the mesh: the scan's own, or that of the index over a scan without an order.
    pub(super) mesh_topology: Option<Topology>,
    /// The point in each cell of an index; empty for an ordered scan, whose cells are its points.
    pub(super) point_of_cell: Vec<u32>,
    /// Per cell: kept triangles in the low four bits, discarded ones in the high four; bit k leaves out corner k.
    pub(super) triangles: Vec<u8>,
    /// Per cell: which of the eight cells around share a kept triangle with it, in the order of `LINK_OFFSETS`.
    pub(super) links: Vec<u8>,
    /// Per bit of `links` the step to that cell, modulo the number of cells.
    pub(super) link_steps: [usize; 8],
    pub(super) discarded: Vec<DiscardedTriangle>,
    pub(super) lists: Vec<NeighbourList>,
    pub(super) list_of_point: Vec<u32>,
}

/// Row and column offsets of the eight cells around a cell, in the order of the bits of `links`: starting to the right,
/// turning by way of below.
pub(super) const LINK_OFFSETS: [(i8, i8); 8] = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)];

impl Surface {
    /// The number of points of the scan, returns or not.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the scan had no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// All points' geometry, under the points' indices.
    #[must_use]
    pub fn points(&self) -> &[SurfacePoint] {
        &self.points
    }

    /// The grid of an ordered scan and whether it closes on itself.
    #[must_use]
    pub fn topology(&self) -> Option<Topology> {
        self.topology
    }

    /// The unit normal of a point in the scanner's frame, towards the scanner, if it has one.
    #[must_use]
    pub fn normal(&self, index: usize) -> Option<Vector3<f32>> {
        self.points.get(index).filter(|p| p.is_valid()).map(|p| Vector3::from(p.normal))
    }

    /// The number of points that belong to the surface.
    #[must_use]
    pub fn valid_count(&self) -> usize {
        self.points.iter().filter(|p| p.is_valid()).count()
    }

    /// The kept triangles of a cell's quad: bit k is set when the triangle without corner k (a, b, c, d = 0 to 3) is
    /// kept. Shifted to [`PointScore::KEPT_WITHOUT`](crate::analysis::PointScore::KEPT_WITHOUT) these are its flags.
    /// Always 0 in a scan without an order, whose points have no quads of their own.
    #[must_use]
    pub fn kept_bits(&self, cell: usize) -> u16 {
        let bits = self.triangles.get(cell).filter(|_| self.topology.is_some());
        bits.map_or(0, |bits| u16::from(bits & 0x0f))
    }

    /// The number of kept triangles.
    #[must_use]
    pub fn kept_count(&self) -> usize {
        self.triangles.iter().map(|bits| (bits & 0x0f).count_ones() as usize).sum()
    }

    /// The kept triangles, as indices of points, in the order of the cells.
    pub fn kept_triangles(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.triangles.iter().enumerate().filter(|(_, bits)| *bits & 0x0f != 0).flat_map(move |(cell, bits)| {
            let quad = self.mesh_topology.and_then(|t| t.quad(cell));
            let point = |cell: usize| self.point_of_cell.get(cell).map_or(cell, |point| *point as usize);
            let quad = quad.map(|q| q.map(point));
            TRIANGLE_CORNERS
                .iter()
                .enumerate()
                .filter(move |(without, _)| bits & (1 << without) != 0)
                .filter_map(move |(_, corners)| quad.map(|q| corners.map(|k| q[k])))
        })
    }

    /// The triangles that span two surfaces, in the order of the cells (spec section 2, step 4).
    #[must_use]
    pub fn discarded(&self) -> &[DiscardedTriangle] {
        &self.discarded
    }

    /// Calls `visit` with every neighbour of a point: those it shares a kept triangle with, or in a scan without an
    /// order its nearest points. The sequence is always the same.
    pub fn for_each_neighbour(&self, index: usize, mut visit: impl FnMut(usize)) {
        if let Some(topology) = &self.topology {
            let links = self.links.get(index).copied().unwrap_or(0);
            if links == 0 {
                return;
            }
            let (rows, cols) = (topology.grid.rows, topology.grid.cols);
            if !topology.wraps_cols {
                // Only rows can wrap, and those do so by the number of cells; links never leave the grid otherwise.
                let cells = rows * cols;
                let mut rest = links;
                while rest != 0 {
                    let at = index + self.link_steps[rest.trailing_zeros() as usize];
                    visit(if at >= cells { at - cells } else { at });
                    rest &= rest - 1;
                }
                return;
            }
            let (row, col) = (index / cols, index % cols);
            let above = if row == 0 { rows - 1 } else { row - 1 };
            let below = if row + 1 == rows { 0 } else { row + 1 };
            let left = if col == 0 { cols - 1 } else { col - 1 };
            let right = if col + 1 == cols { 0 } else { col + 1 };
            for (bit, (down, across)) in LINK_OFFSETS.iter().enumerate() {
                if links & (1 << bit) != 0 {
                    let r = [above, row, below][(down + 1) as usize];
                    let c = [left, col, right][(across + 1) as usize];
                    visit(r * cols + c);
                }
            }
        } else if let Some(list) = self.list_of_point.get(index).and_then(|slot| self.lists.get(*slot as usize)) {
            list.as_slice().iter().for_each(|neighbour| visit(*neighbour as usize));
        }
    }

    /// Per cell of the mesh which of the cells around share a kept triangle with it, a bit each, starting to the right,
    /// turning by way of below.
    pub(crate) fn links(&self) -> &[u8] {
        &self.links
    }

    /// Per cell of the mesh its kept triangles in the low four bits and the discarded ones in the high four; bit k leaves
    /// out corner k.
    pub(crate) fn triangles(&self) -> &[u8] {
        &self.triangles
    }

    /// Works out the steps to the cells around.
    pub(super) fn set_link_steps(&mut self, topology: &Topology) {
        let (cols, cells) = (topology.grid.cols as isize, topology.grid.cells() as isize);
        self.link_steps = LINK_OFFSETS
            .map(|(down, across)| (isize::from(down) * cols + isize::from(across)).rem_euclid(cells.max(1)) as usize);
    }
}
