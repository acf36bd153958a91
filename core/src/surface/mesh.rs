//! Triangles from honest legs, and the normals and areas they give to their points (3.12, 3.13).

use super::for_blocks2;
use super::legs::{COL_HONEST, COL_THERE, ROW_HONEST, ROW_THERE, Sample};
use super::quality::QualityScale;
use super::topology::Topology;
use super::view::SurfacePoint;

/// The corners of the triangle that leaves out corner k, in the quad a, b (right), c (below), d.
pub(super) const TRIANGLE_CORNERS: [[usize; 3]; 4] = [[1, 3, 2], [0, 3, 2], [0, 1, 3], [0, 1, 2]];

/// For each corner a quad's cell can be (a to d) and each set of kept triangles: the bits of `links` that follow.
pub(super) const CORNER_LINKS: [[u8; 16]; 4] = corner_links();

const fn corner_links() -> [[u8; 16]; 4] {
    // The bit of `links` under which corner `from` knows corner `to`.
    const BIT: [[u8; 4]; 4] = [[0, 1 << 0, 1 << 2, 1 << 1], [1 << 4, 0, 1 << 3, 1 << 2], [1 << 6, 1 << 7, 0, 1 << 0], [
        1 << 5,
        1 << 6,
        1 << 4,
        0,
    ]];
    let mut links = [[0u8; 16]; 4];
    let mut from = 0;
    while from < 4 {
        let mut kept = 0;
        while kept < 16 {
            let mut without = 0;
            while without < 4 {
                if kept & (1 << without) != 0 && without != from {
                    let mut to = 0;
                    while to < 4 {
                        if to != without {
                            links[from][kept] |= BIT[from][to];
                        }
                        to += 1;
                    }
                }
                without += 1;
            }
            kept += 1;
        }
        from += 1;
    }
    links
}

/// The scan's samples and their legs, ready to be meshed.
pub(super) struct Mesh<'a> {
    pub(super) samples: &'a [Sample],
    pub(super) legs: &'a [u8],
    pub(super) topology: Topology,
    pub(super) quality: QualityScale,
}

impl Mesh<'_> {
    /// Fills geometry and triangle bits of every cell. Per point the triangles add up in the order of the quads above
    /// it, then beside it, so that blocks of rows give the same bits as the whole.
    pub(super) fn build(&self, points: &mut [SurfacePoint], triangles: &mut [u8], threads: usize) {
        let cols = self.topology.grid.cols;
        for_blocks2(points, triangles, cols, threads, |first_row, points, triangles| {
            points.fill(SurfacePoint::default());
            // The quads above the block also touch its first row.
            if let Some(above) = self.topology.row_before(first_row) {
                self.quad_row(above, first_row * cols, &mut points[..cols], &mut []);
            }
            let rows = points.len() / cols;
            for offset in 0..rows {
                let start = offset * cols;
                let end = points.len().min(start + 2 * cols);
                let bits = &mut triangles[start..start + cols];
                bits.fill(0);
                self.quad_row(first_row + offset, (first_row + offset) * cols, &mut points[start..end], bits);
                self.finish_row((first_row + offset) * cols, &mut points[start..start + cols]);
            }
        });
    }

    /// Meshes the quads between `row` and the next one, adding to those of their points that lie in `own`, whose first
    /// cell is `own_first`; `bits`, unless empty, takes the triangles of each column's quad.
    fn quad_row(&self, row: usize, own_first: usize, own: &mut [SurfacePoint], bits: &mut [u8]) {
        let cols = self.topology.grid.cols;
        let Some(below) = self.topology.row_after(row) else { return };
        let quads = if self.topology.wraps_cols { cols } else { cols - 1 };
        for col in 0..quads {
            let right = if col + 1 < cols { col + 1 } else { 0 };
            let cells = [row * cols + col, row * cols + right, below * cols + col, below * cols + right];
            let split = self.split(cells);
            if split == 0 {
                continue;
            }
            if let Some(bits) = bits.get_mut(col) {
                *bits = split;
            }
            for (without, corners) in TRIANGLE_CORNERS.iter().enumerate() {
                if split & (1 << without) != 0 {
                    self.add(corners.map(|k| cells[k]), own_first, own);
                }
            }
        }
    }

    /// Cuts a quad into triangles along the diagonal that keeps most of it, the shorter one when both keep the same.
    /// A triangle needs both its legs (spec section 2, step 3): with one that spans two surfaces it is discarded, with
    /// one that is not there it does not exist.
    fn split(&self, [a, b, c, d]: [usize; 4]) -> u8 {
        let (legs_a, legs_b, legs_c) = (self.legs[a], self.legs[b], self.legs[c]);
        // In the order ab, ac, bd, cd.
        let there = [legs_a & ROW_THERE, legs_a & COL_THERE, legs_b & COL_THERE, legs_c & ROW_THERE].map(|v| v != 0);
        let honest =
            [legs_a & ROW_HONEST, legs_a & COL_HONEST, legs_b & COL_HONEST, legs_c & ROW_HONEST].map(|v| v != 0);
        if there == [false; 4] {
            return 0;
        }
        let triangle = |first: usize, second: usize, without: u8| -> (u8, u8) {
            let kept = u8::from(honest[first] && honest[second]) << without;
            let exists = u8::from(there[first] && there[second]) << without;
            (kept | (exists & !kept) << 4, 4 * u8::from(kept != 0) + u8::from(exists != 0))
        };
        let ((t_d, worth_d), (t_a, worth_a)) = (triangle(0, 1, 3), triangle(2, 3, 0));
        let ((t_b, worth_b), (t_c, worth_c)) = (triangle(1, 3, 1), triangle(0, 2, 2));
        let (along_bc, along_ad) = (t_d | t_a, t_b | t_c);
        match (worth_d + worth_a).cmp(&(worth_b + worth_c)) {
            std::cmp::Ordering::Greater => along_bc,
            std::cmp::Ordering::Less => along_ad,
            std::cmp::Ordering::Equal if self.distance2(b, c) <= self.distance2(a, d) => along_bc,
            std::cmp::Ordering::Equal => along_ad,
        }
    }

    fn distance2(&self, i: usize, j: usize) -> f32 {
        let (p, q) = (&self.samples[i], &self.samples[j]);
        (0..3).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum()
    }

    /// Adds A_T n_T and A_T of a kept triangle to its points.
    fn add(&self, cells: [usize; 3], own_first: usize, own: &mut [SurfacePoint]) {
        let (vector, area) = facing_area(cells.map(|cell| &self.samples[cell]));
        for cell in cells {
            if let Some(point) = own.get_mut(cell.wrapping_sub(own_first)) {
                for (sum, part) in point.normal.iter_mut().zip(vector) {
                    *sum += part;
                }
                point.area += area;
            }
        }
    }

    /// Turns the sums of a row whose triangles are all in into normals, areas and qualities.
    fn finish_row(&self, first: usize, row: &mut [SurfacePoint]) {
        for (point, sample) in row.iter_mut().zip(&self.samples[first..]) {
            let [x, y, z] = point.normal;
            let norm = (x * x + y * y + z * z).sqrt();
            if !(norm > f32::MIN_POSITIVE && norm.is_finite()) {
                *point = SurfacePoint::default();
                continue;
            }
            point.normal = [x / norm, y / norm, z / norm];
            let ray = [sample[0] * sample[3], sample[1] * sample[3], sample[2] * sample[3]];
            point.incidence = super::quality::incidence_quality(ray, point.normal);
            point.area /= 3.0;
            point.quality = self.quality.of(point.area, point.incidence);
        }
    }
}

/// The area vector of a triangle [m^2], turned towards the scanner, and its length.
pub(super) fn facing_area([p, q, r]: [&Sample; 3]) -> ([f32; 3], f32) {
    let u = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
    let v = [r[0] - p[0], r[1] - p[1], r[2] - p[2]];
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let away = n[0] * p[0] + n[1] * p[1] + n[2] * p[2];
    let half = if away > 0.0 { -0.5 } else { 0.5 };
    let vector = n.map(|c| c * half);
    (vector, (vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_kept_triangle_are_linked_and_the_left_out_one_is_not() {
        // Kept: the triangle without d. Corner a is linked to its right and below, d to nothing.
        assert_eq!(CORNER_LINKS[0][1 << 3], 0b101);
        assert_eq!(CORNER_LINKS[3][1 << 3], 0);
        // b knows a (left) and c (below left).
        assert_eq!(CORNER_LINKS[1][1 << 3], 1 << 4 | 1 << 3);
    }

    #[test]
    fn the_area_vector_faces_the_scanner_whatever_the_order_of_the_corners() {
        let p: Vec<Sample> = vec![[5.0, 0.0, 0.0, 0.2], [5.0, 1.0, 0.0, 0.2], [5.0, 0.0, 1.0, 0.2]];
        assert_eq!(facing_area([&p[0], &p[1], &p[2]]), ([-0.5, 0.0, 0.0], 0.5));
        assert_eq!(facing_area([&p[0], &p[2], &p[1]]), ([-0.5, 0.0, 0.0], 0.5));
    }
}
