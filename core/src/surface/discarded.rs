//! The triangles that span two surfaces, with their adjacency: where occluded planes are found (spec section 2, step 4).

use super::topology::Topology;

/// A triangle whose legs do not follow one surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscardedTriangle {
    /// Indices of its three points.
    pub corners: [u32; 3],
    /// The discarded triangles that share an edge with it, as indices of their list, or [`DiscardedTriangle::NONE`].
    pub neighbours: [u32; 3],
    /// Its area times its unit normal, turned towards the scanner [m^2].
    pub area_vector: [f32; 3],
    /// Its area [m^2].
    pub area: f32,
}

impl DiscardedTriangle {
    /// No neighbour across this edge.
    pub const NONE: u32 = u32::MAX;
}

/// A discarded triangle and where it was found: in the quad of which cell, and which corner it leaves out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) cell: u32,
    pub(super) without: u32,
    pub(super) triangle: DiscardedTriangle,
}

/// The sides of a quad.
#[derive(Clone, Copy)]
enum Side {
    Top,
    Left,
    Right,
    Bottom,
}

/// The two legs of the triangle that leaves out corner k.
const TRIANGLE_SIDES: [[Side; 2]; 4] =
    [[Side::Right, Side::Bottom], [Side::Left, Side::Bottom], [Side::Top, Side::Right], [Side::Top, Side::Left]];

/// The corner whose triangle lies across the diagonal.
const ACROSS: [u32; 4] = [3, 2, 1, 0];

/// Lists the triangles found, which come in the order of their cells, and links those that share an edge. `triangles`
/// are the triangle bits of every cell; `first_of_cell` is scratch space, one entry a cell: the index of the cell's first
/// discarded triangle, meaningful only where there is one.
pub(super) fn list<'a>(
    found: impl Iterator<Item = &'a Found> + Clone,
    triangles: &[u8],
    topology: &Topology,
    first_of_cell: &mut [u32],
    out: &mut Vec<DiscardedTriangle>,
) {
    out.clear();
    let mut last = u32::MAX;
    for found in found.clone() {
        if found.cell != last {
            first_of_cell[found.cell as usize] = out.len() as u32;
            last = found.cell;
        }
        out.push(found.triangle);
    }
    let index = Index { triangles, first_of_cell, topology };
    for (found, triangle) in found.zip(out) {
        triangle.neighbours = index.neighbours(found.cell as usize, found.without);
    }
}

/// Finds discarded triangles by cell and left-out corner.
struct Index<'a> {
    triangles: &'a [u8],
    first_of_cell: &'a [u32],
    topology: &'a Topology,
}

impl Index<'_> {
    /// The place in the list of the first discarded triangle that leaves out one of these corners.
    fn find(&self, cell: usize, without: &[u32]) -> Option<u32> {
        let discarded = u32::from(self.triangles[cell] >> 4);
        let found = without.iter().find(|k| discarded & (1 << *k) != 0)?;
        // Triangles of a cell are listed by rising corner.
        Some(self.first_of_cell[cell] + (discarded & ((1 << found) - 1)).count_ones())
    }

    /// The discarded triangles across the two legs and the diagonal of one.
    fn neighbours(&self, cell: usize, without: u32) -> [u32; 3] {
        let [first, second] = TRIANGLE_SIDES[without as usize].map(|side| self.across_side(cell, side));
        let diagonal = self.find(cell, &[ACROSS[without as usize]]);
        [first, second, diagonal].map(|found| found.unwrap_or(DiscardedTriangle::NONE))
    }

    fn across_side(&self, cell: usize, side: Side) -> Option<u32> {
        let cols = self.topology.grid.cols;
        let (row, col) = (cell / cols, cell % cols);
        // Beyond the top lies another quad's bottom, whose triangle leaves out a or b, and so on.
        match side {
            Side::Top => self.find(self.topology.row_before(row)? * cols + col, &[0, 1]),
            Side::Bottom => self.find(self.topology.row_after(row)? * cols + col, &[2, 3]),
            Side::Left => self.find(row * cols + self.topology.col_before(col)?, &[0, 2]),
            Side::Right => self.find(row * cols + self.topology.col_after(col)?, &[1, 3]),
        }
    }
}
