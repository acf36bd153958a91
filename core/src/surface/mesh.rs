//! Triangles from honest legs, and the normals and areas they give to their points (3.12, 3.13); many quads at a time.

use super::legs::Sample;
use super::lines::{Lines, WIDE};
use super::quality::{QualityScale, at_most_one};
use super::view::SurfacePoint;

/// The corners of the triangle that leaves out corner k, in the quad a, b (right), c (below), d.
pub(super) const TRIANGLE_CORNERS: [[usize; 3]; 4] = [[1, 3, 2], [0, 3, 2], [0, 1, 3], [0, 1, 2]];

/// Normal times area in the first three places, area in the last [m^2].
pub(super) type AreaSum = [f32; 4];

/// Of some values each: normal times area in the first three places, area in the last [m^2].
type AreaLanes = [[f32; WIDE]; 4];

/// What the triangles of one line of quads, and of the line above, give to the points between.
#[derive(Debug, Default)]
pub(super) struct QuadSums {
    /// The triangle of each quad at its upper side, zero where it is not kept.
    upper: [Lines<f32>; 4],
    /// The triangle at its lower side.
    lower: [Lines<f32>; 4],
    /// All bits where the quad is cut along b-c, none where along a-d.
    along_bc: Lines<u32>,
    /// What the quads above the next line of points have given to it.
    pending: [Lines<f32>; 4],
    /// Whether any of the quads worked on together from a column on has a triangle, in this line and the one above; the
    /// first entry stands for those before the first column.
    is_active: Vec<bool>,
    was_active: Vec<bool>,
}

/// The corners of some quads: x, y, z of each.
pub(super) struct QuadCorners {
    pub(super) a: [[f32; WIDE]; 3],
    pub(super) b: [[f32; WIDE]; 3],
    pub(super) c: [[f32; WIDE]; 3],
    pub(super) d: [[f32; WIDE]; 3],
}

/// The bits ([`THERE`](super::legs::THERE), [`HONEST`](super::legs::HONEST)) of the legs of some quads.
pub(super) struct QuadLegs {
    pub(super) ab: [u8; WIDE],
    pub(super) ac: [u8; WIDE],
    pub(super) bd: [u8; WIDE],
    pub(super) cd: [u8; WIDE],
}

/// The triangles of a quad with these legs: there in the low four bits, kept in the high four; bit k leaves out corner
/// k. A triangle needs both its legs (spec section 2, step 3): with one that spans two surfaces it is discarded, with
/// one that is not there it does not exist.
#[inline(always)]
fn triangles_of(ab: u32, ac: u32, bd: u32, cd: u32) -> u32 {
    both(bd, cd) | both(ac, cd) << 1 | both(ab, bd) << 2 | both(ab, ac) << 3
}

/// Bit 0 of a leg tells whether it is there, bit 1 whether it is honest: bits 0 and 4 of what is returned.
#[inline(always)]
fn both(first: u32, second: u32) -> u32 {
    let legs = first & second;
    (legs & 1) | (legs & 2) << 3
}

/// How much of a quad is kept along b-c more than along a-d: positive, negative, or zero where the shorter diagonal
/// decides. A kept triangle is worth five times a discarded one.
#[inline(always)]
fn preference(triangles: u32) -> i32 {
    // Wrapping, which it never does: a check of each would keep it from being done for many at once.
    let (bc, ad) = (worth(triangles, 0) + worth(triangles, 3), worth(triangles, 1) + worth(triangles, 2));
    (bc as i32).wrapping_sub(ad as i32)
}

#[inline(always)]
fn worth(triangles: u32, without: u32) -> u32 {
    (triangles >> without & 1) | (triangles >> (without + 4) & 1) << 2
}

/// The triangles along one diagonal: kept ones in the low four bits, discarded ones in the high four.
#[inline(always)]
fn cut(triangles: u32, along_bc: u32) -> u32 {
    let (there, kept) = (triangles & 0x0f, triangles >> 4);
    let chosen = 0b0110 ^ (along_bc & 0b1111);
    (kept & chosen) | ((there & !kept & chosen) << 4)
}

impl QuadSums {
    /// Empties all for lines of this shape.
    pub(super) fn reset(&mut self, shape: super::lines::LineShape) {
        let all = self.upper.iter_mut().chain(&mut self.lower).chain(&mut self.pending);
        all.for_each(|lines| lines.reset(shape, 1));
        self.along_bc.reset(shape, 1);
        let groups = shape.cols.div_ceil(WIDE) + 1;
        for flags in [&mut self.is_active, &mut self.was_active] {
            flags.clear();
            flags.resize(groups, false);
        }
    }

    /// Says that the quads worked on together from `col` on have no triangles.
    #[inline(always)]
    pub(super) fn skip(&mut self, col: usize) {
        self.is_active[col / WIDE + 1] = false;
        for part in 0..4 {
            self.upper[part].put(0, col, [0.0; WIDE]);
            self.lower[part].put(0, col, [0.0; WIDE]);
        }
    }

    /// Cuts the quads from `col` on, each along the diagonal that keeps most of it, the shorter one when both keep
    /// the same, and returns their triangle bits. Noise makes the choice as good as random, so it is made without jumps.
    #[inline(always)]
    pub(super) fn cut(&mut self, col: usize, corners: &QuadCorners, legs: &QuadLegs) -> [u8; WIDE] {
        let (QuadCorners { a, b, c, d }, mut bits) = (corners, [0; WIDE]);
        let (mut bc, mut upper_kept, mut lower_kept) = ([0u32; WIDE], [0u32; WIDE], [0u32; WIDE]);
        for k in 0..WIDE {
            let is_shorter = distance2(b, c, k) <= distance2(a, d, k);
            let leg = |legs: &[u8; WIDE]| u32::from(legs[k]);
            let triangles = triangles_of(leg(&legs.ab), leg(&legs.ac), leg(&legs.bd), leg(&legs.cd));
            let preference = preference(triangles);
            bc[k] = mask((preference > 0) | ((preference == 0) & is_shorter));
            let cut = cut(triangles, bc[k]);
            bits[k] = cut as u8;
            // Along b-c: a b c (without d) and b d c (without a). Along a-d: a b d (without c) and a d c (without b).
            upper_kept[k] = mask(cut & 0b1100 != 0);
            lower_kept[k] = mask(cut & 0b0011 != 0);
        }
        let (mut third, mut first) = ([[0.0; WIDE]; 3], [[0.0; WIDE]; 3]);
        for axis in 0..3 {
            for k in 0..WIDE {
                third[axis][k] = either(bc[k], c[axis][k], d[axis][k]);
                first[axis][k] = either(bc[k], b[axis][k], a[axis][k]);
            }
        }
        self.is_active[col / WIDE + 1] = true;
        self.along_bc.put(0, col, bc);
        store(&mut self.upper, col, &facing_areas(a, b, &third, &upper_kept));
        store(&mut self.lower, col, &facing_areas(&first, d, c, &lower_kept));
        bits
    }

    /// Ends a line of quads: what it and the line above give to the points between goes through `finish`, some points
    /// from a column on at a time; `None` where there is nothing. What it gives to the next line is kept.
    #[inline(always)]
    pub(super) fn gather(&mut self, cols: usize, is_closed: bool, mut finish: impl FnMut(usize, Option<&AreaLanes>)) {
        for part in 0..4 {
            self.upper[part].close(0);
            self.lower[part].close(0);
        }
        self.along_bc.close(0);
        let last = self.is_active.len() - 1;
        // The cell before the first one, where lines are closed, is the last one.
        self.is_active[0] = is_closed && (self.is_active[last] || self.is_active[last.saturating_sub(1)]);
        let [u0, u1, u2, u3] = &self.upper;
        let [l0, l1, l2, l3] = &self.lower;
        let all_upper = [u0.at(0), u1.at(0), u2.at(0), u3.at(0)];
        let all_lower = [l0.at(0), l1.at(0), l2.at(0), l3.at(0)];
        let along_bc = self.along_bc.at(0);
        for col in (0..cols).step_by(WIDE) {
            let group = col / WIDE;
            let is_active = self.is_active[group] | self.is_active[group + 1];
            if !is_active && !self.was_active[group + 1] {
                finish(col, None);
                continue;
            }
            let (mut sums, mut next) = ([[0.0; WIDE]; 4], [[0.0; WIDE]; 4]);
            let (bc, bc_left): ([u32; WIDE], [u32; WIDE]) = (along_bc.some(col), along_bc.some_before(col));
            for part in 0..4 {
                // Corner a of the quad to the right and b of the one to the left; then c and d.
                let (upper, lower): ([f32; WIDE], [f32; WIDE]) = (all_upper[part].some(col), all_lower[part].some(col));
                let left_upper: [f32; WIDE] = all_upper[part].some_before(col);
                let left_lower: [f32; WIDE] = all_lower[part].some_before(col);
                let pending: [f32; WIDE] = self.pending[part].at(0).some(col);
                for k in 0..WIDE {
                    let a = upper[k] + either(bc[k], 0.0, lower[k]);
                    let b = left_upper[k] + either(bc_left[k], left_lower[k], 0.0);
                    let c = lower[k] + either(bc[k], upper[k], 0.0);
                    let d = left_lower[k] + either(bc_left[k], 0.0, left_upper[k]);
                    sums[part][k] = pending[k] + (a + b);
                    next[part][k] = c + d;
                }
                self.pending[part].put(0, col, next[part]);
            }
            // Only now: the group to the right asks for this line's flag, the next line for this group's.
            self.was_active[group + 1] = is_active;
            finish(col, Some(&sums));
        }
    }
}

/// All bits, or none.
#[inline(always)]
fn mask(is_set: bool) -> u32 {
    if is_set { u32::MAX } else { 0 }
}

/// The first value where `mask` has all bits, the second where it has none. By its bits: the compiler makes jumps of a
/// condition, and which way noise goes cannot be predicted.
#[inline(always)]
fn either(mask: u32, first: f32, second: f32) -> f32 {
    f32::from_bits((first.to_bits() & mask) | (second.to_bits() & !mask))
}

/// The square of the distance between the points at place `k` [m^2].
#[inline(always)]
fn distance2(p: &[[f32; WIDE]; 3], q: &[[f32; WIDE]; 3], k: usize) -> f32 {
    let (x, y, z) = (p[0][k] - q[0][k], p[1][k] - q[1][k], p[2][k] - q[2][k]);
    x * x + y * y + z * z
}

/// Writes the area vectors of some triangles.
#[inline(always)]
fn store(lines: &mut [Lines<f32>; 4], col: usize, areas: &AreaLanes) {
    for part in 0..4 {
        lines[part].put(0, col, areas[part]);
    }
}

/// Turns the sums of some points whose triangles are all in into normals, areas and qualities. `rays` are their unit
/// directions.
#[inline(always)]
pub(super) fn finish_points(
    sums: &AreaLanes,
    rays: &[[f32; WIDE]; 3],
    quality: &QualityScale,
    out: &mut [SurfacePoint],
) {
    let [mut x, mut y, mut z, mut area] = *sums;
    let (mut incidence, mut good) = ([0.0; WIDE], [0.0; WIDE]);
    for k in 0..WIDE {
        let norm = (x[k] * x[k] + y[k] * y[k] + z[k] * z[k]).sqrt();
        let is_there = mask((norm > f32::MIN_POSITIVE) & (norm < f32::INFINITY));
        let scale = either(is_there, 1.0 / norm, 0.0);
        (x[k], y[k], z[k]) = (x[k] * scale, y[k] * scale, z[k] * scale);
        area[k] = either(is_there, area[k] * (1.0 / 3.0), 0.0);
        let cosine = at_most_one((rays[0][k] * x[k] + rays[1][k] * y[k] + rays[2][k] * z[k]).abs());
        good[k] = either(is_there, quality.of(area[k], cosine), 0.0);
        incidence[k] = either(is_there, cosine, 0.0);
    }
    let count = out.len().min(WIDE);
    for (k, point) in out[..count].iter_mut().enumerate() {
        *point = SurfacePoint { normal: [x[k], y[k], z[k]], incidence: incidence[k], area: area[k], quality: good[k] };
    }
}

/// The area vectors of some triangles [m^2], turned towards the scanner, and their lengths; zeros for those that are not
/// kept.
#[inline(always)]
fn facing_areas(p: &[[f32; WIDE]; 3], q: &[[f32; WIDE]; 3], r: &[[f32; WIDE]; 3], kept: &[u32; WIDE]) -> AreaLanes {
    let mut areas = [[0.0; WIDE]; 4];
    for k in 0..WIDE {
        let u = [q[0][k] - p[0][k], q[1][k] - p[1][k], q[2][k] - p[2][k]];
        let v = [r[0][k] - p[0][k], r[1][k] - p[1][k], r[2][k] - p[2][k]];
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let away = n[0] * p[0][k] + n[1] * p[1][k] + n[2] * p[2][k];
        let half = (-0.5f32).copysign(-away);
        let area = 0.5 * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        areas[0][k] = either(kept[k], n[0] * half, 0.0);
        areas[1][k] = either(kept[k], n[1] * half, 0.0);
        areas[2][k] = either(kept[k], n[2] * half, 0.0);
        areas[3][k] = either(kept[k], area, 0.0);
    }
    areas
}

/// The bits of `links` of some cells from the kept triangles of their own quads and of those to the left, above, and
/// above left: the cell is corner a of the first, b of the second, c of the third, d of the fourth.
#[inline(always)]
pub(super) fn links_of(own: &[u8], left: &[u8], above: &[u8], above_left: &[u8], out: &mut [u8]) {
    let count = out.len();
    let (own, left) = (&own[..count], &left[..count]);
    let (above, above_left) = (&above[..count], &above_left[..count]);
    for k in 0..count {
        let (own, left, above, above_left) = (own[k], left[k], above[k], above_left[k]);
        out[k] = without(own, 2, 3)
            | without(own, 1, 2) << 1
            | without(own, 1, 3) << 2
            | without(left, 0, 2) << 2
            | without(left, 0, 3) << 3
            | without(left, 2, 3) << 4
            | without(above, 0, 1)
            | without(above, 1, 3) << 6
            | without(above, 0, 3) << 7
            | without(above_left, 0, 1) << 4
            | without(above_left, 1, 2) << 5
            | without(above_left, 0, 2) << 6;
    }
}

/// 1 if a quad keeps a triangle without corner `i`, or without corner `k`, else 0.
#[inline(always)]
fn without(kept: u8, i: u8, k: u8) -> u8 {
    (kept >> i | kept >> k) & 1
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
        // Kept: the triangle without d.
        let (kept, none) = ([1u8 << 3], [0u8]);
        let links = |own, left, above, above_left| {
            let mut out = [0];
            links_of(own, left, above, above_left, &mut out);
            out[0]
        };
        // Corner a is linked to its right and below, b to its left and below left, d to nothing.
        assert_eq!(links(&kept, &none, &none, &none), 0b101);
        assert_eq!(links(&none, &kept, &none, &none), 1 << 4 | 1 << 3);
        assert_eq!(links(&none, &none, &none, &kept), 0);
    }

    #[test]
    fn a_link_is_there_exactly_where_a_kept_triangle_has_both_corners() {
        // The steps from each corner to each other one, in the order of the bits of `links`.
        const BIT: [[u8; 4]; 4] = [[0, 0, 2, 1], [4, 0, 3, 2], [6, 7, 0, 0], [5, 6, 4, 0]];
        for from in 0..4 {
            for kept in 0..16u8 {
                let mut quads = [[0u8]; 4];
                quads[from] = [kept];
                let mut out = [0];
                links_of(&quads[0], &quads[1], &quads[2], &quads[3], &mut out);
                let mut expected = 0u8;
                for to in (0..4).filter(|to| *to != from) {
                    let is_shared = (0..4).any(|k| kept & (1 << k) != 0 && k != from && k != to);
                    expected |= u8::from(is_shared) << BIT[from][to];
                }
                assert_eq!(out[0], expected, "corner {from}, kept {kept:b}");
            }
        }
    }

    #[test]
    fn a_corner_off_the_surface_leaves_the_triangle_of_the_other_three() {
        // All legs are there, those of b span two surfaces: cut along a-d, without b kept, without c discarded.
        let triangles = triangles_of(0b01, 0b11, 0b01, 0b11);
        assert!(preference(triangles) < 0);
        assert_eq!(cut(triangles, 0), 1 << 1 | 1 << (2 + 4));
        // The return of d is missing: only the triangle without d exists.
        let triangles = triangles_of(0b11, 0b11, 0, 0);
        assert!(preference(triangles) > 0 && cut(triangles, u32::MAX) == 1 << 3);
    }

    #[test]
    fn the_area_vector_faces_the_scanner_whatever_the_order_of_the_corners() {
        let p: Vec<Sample> = vec![[5.0, 0.0, 0.0, 0.2], [5.0, 1.0, 0.0, 0.2], [5.0, 0.0, 1.0, 0.2]];
        assert_eq!(facing_area([&p[0], &p[1], &p[2]]), [-0.5, 0.0, 0.0, 0.5]);
        assert_eq!(facing_area([&p[0], &p[2], &p[1]]), [-0.5, 0.0, 0.0, 0.5]);
    }
}
