//! Triangles from honest legs, and the normals and areas they give to their points (3.12, 3.13).

use super::legs::{COL_HONEST, COL_THERE, ROW_HONEST, ROW_THERE, Sample};
use super::quality::QualityScale;
use super::topology::Topology;
use super::view::SurfacePoint;
use crate::threads::for_blocks2;

/// The corners of the triangle that leaves out corner k, in the quad a, b (right), c (below), d.
pub(super) const TRIANGLE_CORNERS: [[usize; 3]; 4] = [[1, 3, 2], [0, 3, 2], [0, 1, 3], [0, 1, 2]];

/// For each corner a quad's cell can be (a to d) and each set of kept triangles: the bits of `links` that follow.
pub(super) const CORNER_LINKS: [[u8; 16]; 4] = corner_links();

const fn corner_links() -> [[u8; 16]; 4] {
    // The bit of `links` under which corner `from` knows corner `to`.
    const BIT: [[u8; 4]; 4] = [
        [0, 1 << 0, 1 << 2, 1 << 1],
        [1 << 4, 0, 1 << 3, 1 << 2],
        [1 << 6, 1 << 7, 0, 1 << 0],
        [1 << 5, 1 << 6, 1 << 4, 0],
    ];
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

/// How a quad with certain legs is cut: the triangles along either diagonal, kept ones in the low four bits, discarded
/// ones in the high four, and which diagonal keeps more.
#[derive(Clone, Copy)]
struct Cut {
    along_bc: u8,
    along_ad: u8,
    /// Positive when b-c keeps more, negative when a-d does, zero when the shorter one decides.
    preference: i8,
}

/// The cuts by the quad's legs: bits 0 to 3 tell which of ab, ac, bd, cd are there, bits 4 to 7 which are honest.
const CUTS: [Cut; 256] = cuts();

/// A triangle needs both its legs (spec section 2, step 3): with one that spans two surfaces it is discarded, with one
/// that is not there it does not exist.
const fn cuts() -> [Cut; 256] {
    /// The legs of the triangle that leaves out corner k.
    const LEGS: [u8; 4] = [0b1100, 0b1010, 0b0101, 0b0011];
    let mut cuts = [Cut { along_bc: 0, along_ad: 0, preference: 0 }; 256];
    let mut legs = 0;
    while legs < 256 {
        let (there, honest) = (legs as u8 & 0x0f, legs as u8 >> 4);
        let (mut triangles, mut worth) = ([0u8; 4], [0i8; 4]);
        let mut without = 0;
        while without < 4 {
            let wanted = LEGS[without];
            if there & wanted == wanted {
                let is_kept = honest & wanted == wanted;
                triangles[without] = 1 << if is_kept { without } else { without + 4 };
                worth[without] = if is_kept { 5 } else { 1 };
            }
            without += 1;
        }
        cuts[legs] = Cut {
            along_bc: triangles[0] | triangles[3],
            along_ad: triangles[1] | triangles[2],
            preference: worth[0] + worth[3] - worth[1] - worth[2],
        };
        legs += 1;
    }
    cuts
}

/// Normal times area in the first three places, area in the last [m^2].
type AreaSum = [f32; 4];

fn plus(a: AreaSum, b: AreaSum) -> AreaSum {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

fn only_if(condition: bool, a: AreaSum) -> AreaSum {
    if condition { a } else { [0.0; 4] }
}

/// Adds to the sums of a point that are gathered in its normal and area until its row is finished.
fn add(point: &mut SurfacePoint, sum: AreaSum) {
    point.normal[0] += sum[0];
    point.normal[1] += sum[1];
    point.normal[2] += sum[2];
    point.area += sum[3];
}

/// What the triangles of one quad give to its corners.
#[derive(Clone, Copy, Default)]
struct CornerSums {
    a: AreaSum,
    b: AreaSum,
    c: AreaSum,
    d: AreaSum,
}

/// The rows of a block that a row of quads adds to; either may belong to another block.
struct OwnRows<'a> {
    upper: Option<&'a mut [SurfacePoint]>,
    lower: Option<&'a mut [SurfacePoint]>,
}

impl OwnRows<'_> {
    fn add(&mut self, col: usize, upper: AreaSum, lower: AreaSum) {
        if let Some(point) = self.upper.as_mut().and_then(|row| row.get_mut(col)) {
            add(point, upper);
        }
        if let Some(point) = self.lower.as_mut().and_then(|row| row.get_mut(col)) {
            add(point, lower);
        }
    }
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
            triangles.fill(0);
            // The quads above the block also touch its first row.
            if let Some(above) = self.topology.row_before(first_row) {
                self.quad_row(above, OwnRows { upper: None, lower: points.get_mut(..cols) }, &mut []);
            }
            let rows = points.chunks(cols).len();
            for (offset, bits) in triangles.chunks_mut(cols).enumerate() {
                let (upper, below) = points[offset * cols..].split_at_mut(cols);
                let lower = if offset + 1 < rows { below.get_mut(..cols) } else { None };
                self.quad_row(first_row + offset, OwnRows { upper: Some(&mut *upper), lower }, bits);
                self.finish_row((first_row + offset) * cols, upper);
            }
        });
    }

    /// Meshes the quads between `row` and the next one; `bits`, unless empty, takes the triangles of each column's quad.
    fn quad_row(&self, row: usize, mut own: OwnRows<'_>, bits: &mut [u8]) {
        let cols = self.topology.grid.cols;
        let Some(below) = self.topology.row_after(row) else { return };
        let line = |r: usize| (&self.samples[r * cols..(r + 1) * cols], &self.legs[r * cols..(r + 1) * cols]);
        let ((upper, upper_legs), (lower, lower_legs)) = (line(row), line(below));
        // A quad's right corners are the next one's left corners: what they get is carried along.
        let (mut carry_upper, mut carry_lower) = ([0.0; 4], [0.0; 4]);
        let quads = if self.topology.wraps_cols { cols } else { cols - 1 };
        for col in 0..quads {
            let right = if col + 1 < cols { col + 1 } else { 0 };
            let legs = quad_legs(upper_legs[col], upper_legs[right], lower_legs[col]);
            if legs == 0 {
                own.add(col, carry_upper, carry_lower);
                (carry_upper, carry_lower) = ([0.0; 4], [0.0; 4]);
                continue;
            }
            let (cut, sums) = mesh_quad(legs, [&upper[col], &upper[right], &lower[col], &lower[right]]);
            if let Some(bits) = bits.get_mut(col) {
                *bits = cut;
            }
            own.add(col, plus(carry_upper, sums.a), plus(carry_lower, sums.c));
            (carry_upper, carry_lower) = (sums.b, sums.d);
        }
        own.add(if quads < cols { quads } else { 0 }, carry_upper, carry_lower);
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
            let scale = 1.0 / norm;
            point.normal = [x * scale, y * scale, z * scale];
            let ray = [sample[0] * sample[3], sample[1] * sample[3], sample[2] * sample[3]];
            point.incidence = super::quality::incidence_quality(ray, point.normal);
            point.area *= 1.0 / 3.0;
            point.quality = self.quality.of(point.area, point.incidence);
        }
    }
}

/// The legs of a quad as an index of [`CUTS`], from the leg bits of its corners a, b and c.
fn quad_legs(a: u8, b: u8, c: u8) -> u8 {
    let pick = |legs: u8, bit: u8, to: u8| u8::from(legs & bit != 0) << to;
    pick(a, ROW_THERE, 0)
        | pick(a, COL_THERE, 1)
        | pick(b, COL_THERE, 2)
        | pick(c, ROW_THERE, 3)
        | pick(a, ROW_HONEST, 4)
        | pick(a, COL_HONEST, 5)
        | pick(b, COL_HONEST, 6)
        | pick(c, ROW_HONEST, 7)
}

/// Cuts a quad along the diagonal that keeps most of it, the shorter one when both keep the same: its triangle bits, and
/// what its kept triangles give to its corners. Noise makes the choice as good as random, so it is made without jumps.
fn mesh_quad(legs: u8, [a, b, c, d]: [&Sample; 4]) -> (u8, CornerSums) {
    let cut = &CUTS[usize::from(legs)];
    let is_bc_shorter = distance2(b, c) <= distance2(a, d);
    let is_bc = (cut.preference > 0) | ((cut.preference == 0) & is_bc_shorter);
    let bits = if is_bc { cut.along_bc } else { cut.along_ad };
    // Along b-c: a b c (without d) and b d c (without a). Along a-d: a b d (without c) and a d c (without b).
    let is_upper_kept = bits & 0b1100 != 0;
    let is_lower_kept = bits & 0b0011 != 0;
    let upper = only_if(is_upper_kept, facing_area([a, b, if is_bc { c } else { d }]));
    let lower = only_if(is_lower_kept, facing_area([if is_bc { b } else { a }, d, c]));
    let sums = CornerSums {
        a: plus(upper, only_if(!is_bc, lower)),
        b: plus(upper, only_if(is_bc, lower)),
        c: plus(lower, only_if(is_bc, upper)),
        d: plus(lower, only_if(!is_bc, upper)),
    };
    (bits, sums)
}

fn distance2(p: &Sample, q: &Sample) -> f32 {
    let square = |k: usize| (p[k] - q[k]) * (p[k] - q[k]);
    square(0) + square(1) + square(2)
}

/// The area vector of a triangle [m^2], turned towards the scanner, and its length.
pub(super) fn facing_area([p, q, r]: [&Sample; 3]) -> AreaSum {
    let u = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
    let v = [r[0] - p[0], r[1] - p[1], r[2] - p[2]];
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let away = n[0] * p[0] + n[1] * p[1] + n[2] * p[2];
    let half = (-0.5f32).copysign(-away);
    let area = 0.5 * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    [n[0] * half, n[1] * half, n[2] * half, area]
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
    fn a_corner_off_the_surface_leaves_the_triangle_of_the_other_three() {
        // All legs are there, those of b span two surfaces: cut along a-d, without b kept, without c discarded.
        let cut = CUTS[0b1010_1111];
        assert!(cut.preference < 0);
        assert_eq!(cut.along_ad, 1 << 1 | 1 << (2 + 4));
        // The return of d is missing: only the triangle without d exists.
        let cut = CUTS[0b0011_0011];
        assert!(cut.preference > 0 && cut.along_bc == 1 << 3);
    }

    #[test]
    fn the_area_vector_faces_the_scanner_whatever_the_order_of_the_corners() {
        let p: Vec<Sample> = vec![[5.0, 0.0, 0.0, 0.2], [5.0, 1.0, 0.0, 0.2], [5.0, 0.0, 1.0, 0.2]];
        assert_eq!(facing_area([&p[0], &p[1], &p[2]]), [-0.5, 0.0, 0.0, 0.5]);
        assert_eq!(facing_area([&p[0], &p[2], &p[1]]), [-0.5, 0.0, 0.0, 0.5]);
    }
}
