//! Kept triangles over the cells between their corners.

use super::block::{byte, reachable_scores};
use super::condense::Frame;
use super::index::{CellIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS, INTERPOLATED, Item, OBSTACLE, Place};
use super::normal_statistics::store;
use super::places::SomePlaces;
use super::rasterise::{Outline, cells_under_longest_side};
use crate::analysis::PointScore;
use nalgebra::Vector3;

const ANY_KEPT: u16 = PointScore::KEPT_WITHOUT * 0b1111;

/// The corners of a quad's triangles, by the corner each leaves out.
const CORNERS_WITHOUT: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

/// Triangles that were rasterised.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PatchTally {
    pub triangles: usize,
    pub clipped: usize,
}

/// Quads looked at together.
const WIDE: usize = 32;

/// Some rows of a scan whose points have their places.
pub(super) struct Patches<'a> {
    /// Of the rows, and of the one below the last.
    pub places: SomePlaces<'a>,
    /// Of the rows.
    pub scores: &'a [PointScore],
    /// Of the row below the last.
    pub below: &'a [PointScore],
    pub cols: usize,
    pub frame: &'a Frame,
}

/// A corner of a quad, if it has a place.
type Corner<'a> = (Option<Place>, &'a PointScore);

impl Patches<'_> {
    /// One item for every cell whose middle lies under a long triangle of the quads of these rows.
    #[inline(always)]
    pub fn rasterise(&self, out: &mut Vec<Item>) -> PatchTally {
        let cols = self.cols;
        let mut tally = PatchTally::default();
        for (row, upper) in self.scores.chunks_exact(cols).enumerate() {
            let (begin, next) = (row * cols, (row + 1) * cols);
            let lower = self.scores.get(next..next + cols).unwrap_or(self.below);
            for first in (0..cols).step_by(WIDE) {
                let large = self.large_quads(begin, first);
                if large == [0; WIDE] {
                    continue;
                }
                for (col, large) in (first..cols).zip(large) {
                    // One turn a kept triangle: which of the four they are cannot be predicted, that they are two can.
                    let mut kept = (upper[col].flags & ANY_KEPT) / PointScore::KEPT_WITHOUT;
                    if large == 0 || kept == 0 {
                        continue;
                    }
                    let right = if col + 1 < cols { col + 1 } else { 0 };
                    let place = |index: usize| self.places.get(index);
                    let quad: [Corner<'_>; 4] = [
                        (place(begin + col), &upper[col]),
                        (place(begin + right), &upper[right]),
                        (place(next + col), &lower[col]),
                        (place(next + right), &lower[right]),
                    ];
                    while kept != 0 {
                        let [i, j, k] = CORNERS_WITHOUT[kept.trailing_zeros() as usize];
                        self.triangle([quad[i], quad[j], quad[k]], &mut tally, out);
                        kept &= kept - 1;
                    }
                }
            }
        }
        tally
    }

    /// Which of some quads of a row may have a long triangle: most lie within one cell, which has its own points, or are
    /// short. A quad with a corner nowhere may have one.
    #[inline(always)]
    fn large_quads(&self, begin: usize, first: usize) -> [u32; WIDE] {
        let cols = self.cols;
        let row = |axis: &[i32], begin: usize| {
            let axis = &axis[begin..begin + cols];
            let mut some = [0i32; WIDE + 1];
            match axis[first..].first_chunk() {
                Some(whole) => some = *whole,
                None => {
                    // The last quad's right corners are the first of the row.
                    let rest = &axis[first..];
                    some[..rest.len()].copy_from_slice(rest);
                    some[rest.len()] = axis[0];
                }
            }
            some
        };
        let next = begin + cols;
        let (upper_x, upper_y) = (row(self.places.x, begin), row(self.places.y, begin));
        let (lower_x, lower_y) = (row(self.places.x, next), row(self.places.y, next));
        let mut large = [0; WIDE];
        for k in 0..WIDE {
            let x = [upper_x[k], upper_x[k + 1], lower_x[k], lower_x[k + 1]];
            let y = [upper_y[k], upper_y[k + 1], lower_y[k], lower_y[k + 1]];
            // Equal in all bits above those within a cell.
            let differ = (x[1] ^ x[0]) | (x[2] ^ x[0]) | (x[3] ^ x[0]) | (y[1] ^ y[0]) | (y[2] ^ y[0]) | (y[3] ^ y[0]);
            let is_one_cell = differ as u32 >> CELL_SHIFT == 0;
            let (x, y) = (extent(x), extent(y));
            // Compared first: the squares of larger ones may not fit.
            let is_small = (x | y) < CELL_UNITS as u32;
            let square = x.wrapping_mul(x).wrapping_add(y.wrapping_mul(y));
            let is_short = is_small & (square.wrapping_mul(100) <= LONG);
            large[k] = u32::from(!is_one_cell & !is_short);
        }
        large
    }

    #[inline(always)]
    fn triangle(&self, corners: [Corner<'_>; 3], tally: &mut PatchTally, out: &mut Vec<Item>) {
        let [(Some(p), a), (Some(q), b), (Some(r), c)] = corners else { return };
        if !is_long(&p, &q, &r) || (a.flags | b.flags | c.flags) & PointScore::REACHABLE == 0 {
            return;
        }
        let scores = [a, b, c];
        tally.triangles += 1;
        let clipped = if self.is_obstacle(scores) {
            self.steep([&p, &q, &r], scores, out)
        } else {
            // Most triangles near the scanner are small and cover no cell's centre: nothing is prepared for those.
            let mut prepared: Option<(Plane, Item)> = None;
            Outline::of([(p.x, p.y), (q.x, q.y), (r.x, r.y)]).cells_inside(self.frame.max_cells, |cell| {
                let (plane, item) = prepared.get_or_insert_with(|| {
                    (Plane::through(&[position(&p), position(&q), position(&r)]), self.mean_item(scores))
                });
                out.push(over(cell, plane.height_at(cell), item));
            })
        };
        tally.clipped += usize::from(clipped);
    }

    /// An obstacle is as high as its middle all along its longest side.
    fn steep(&self, [p, q, r]: [&Place; 3], scores: [&PointScore; 3], out: &mut Vec<Item>) -> bool {
        let positions = [position(p), position(q), position(r)];
        let plan =
            [[positions[0].x, positions[0].y], [positions[1].x, positions[1].y], [positions[2].x, positions[2].y]];
        let height = (positions[0].z + positions[1].z + positions[2].z) / 3.0;
        let item = self.mean_item(scores);
        let own = [cell_of(p), cell_of(q), cell_of(r)];
        cells_under_longest_side(&plan, &own, self.frame.max_cells, |cell| out.push(over(cell, height, &item)))
    }

    #[inline(always)]
    fn is_obstacle(&self, scores: [&PointScore; 3]) -> bool {
        let obstacle = |score: &PointScore| u32::from(reachable_scores(score).1);
        let sum = obstacle(scores[0]) + obstacle(scores[1]) + obstacle(scores[2]);
        self.frame.thresholds.kind(0, ((sum + 1) / 3) as u16) & OBSTACLE != 0
    }

    /// The mean scores and normal of a triangle's corners; a corner out of the robot's reach has F = B = 0.
    #[inline(always)]
    fn mean_item(&self, scores: [&PointScore; 3]) -> Item {
        let (mut navigable, mut obstacle, mut quality) = (0, 0, 0);
        let mut normal = Vector3::new(0.0, 0.0, 0.0);
        for score in scores {
            let (f, b) = reachable_scores(score);
            navigable += u32::from(f);
            obstacle += u32::from(b);
            quality += u32::from(score.quality);
            let own = score.normal();
            normal.x += own.x;
            normal.y += own.y;
            normal.z += own.z;
        }
        let mean = |sum: u32| ((sum + 1) / 3) as u16;
        let kind = self.frame.thresholds.kind(mean(navigable), mean(obstacle)) | INTERPOLATED;
        let mut item = Item::new(Place { x: 0, y: 0, z: 0 }, kind, 1);
        item.quality = mean(quality);
        (item.navigable, item.obstacle) = (byte(navigable, 3), byte(obstacle, 3));
        let normal = normal.try_normalize(1e-3).map_or_else(Vector3::z, |normal| self.frame.turn(&normal));
        item.normal = store(&normal);
        item
    }
}

/// The item over the middle of a cell, at a height.
#[inline(always)]
fn over(cell: CellIndex, height: f64, item: &Item) -> Item {
    let middle = |v: i32| (v << CELL_SHIFT) + CELL_UNITS / 2;
    item.at(Place { x: middle(cell.x), y: middle(cell.y), z: floor(height + 0.5) })
}

#[inline]
fn cell_of(place: &Place) -> CellIndex {
    CellIndex { x: place.x >> CELL_SHIFT, y: place.y >> CELL_SHIFT }
}

/// The position in cells, the height in its own units.
#[inline(always)]
fn position(place: &Place) -> Vector3<f64> {
    let cells = |v: i32| (f64::from(v) + 0.5) / f64::from(CELL_UNITS);
    Vector3::new(cells(place.x), cells(place.y), f64::from(place.z))
}

/// Whether a triangle is longer than nine tenths of a cell. The corners of shorter ones lie in every cell they cover,
/// wherever a correction moves them.
#[inline(always)]
fn is_long(p: &Place, q: &Place, r: &Place) -> bool {
    let (x, y) = (u64::from(extent([p.x, q.x, r.x, r.x])), u64::from(extent([p.y, q.y, r.y, r.y])));
    100 * (x * x + y * y) > u64::from(LONG)
}

/// A hundred times the square of nine tenths of a cell's side.
const LONG: u32 = 81 * (CELL_UNITS * CELL_UNITS) as u32;

/// From the least to the greatest.
#[inline(always)]
fn extent([a, b, c, d]: [i32; 4]) -> u32 {
    let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
    high.wrapping_sub(low) as u32
}

/// The plane through a triangle's corners, to give a height to the cells between them.
struct Plane {
    corner: Vector3<f64>,
    slope: [f64; 2],
    lowest: f64,
    highest: f64,
}

impl Plane {
    #[inline(always)]
    fn through(corners: &[Vector3<f64>; 3]) -> Self {
        // Written out, as nalgebra's products are not inlined here.
        let [a, b, c] = corners;
        let (u, v) = ([b.x - a.x, b.y - a.y, b.z - a.z], [c.x - a.x, c.y - a.y, c.z - a.z]);
        let normal = Vector3::new(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
        // Seen edge on there is no slope: the clamp below keeps whatever comes out within the corners.
        let finite = |s: f64| if s.is_finite() { s } else { 0.0 };
        let slope = [finite(-normal.x / normal.z), finite(-normal.y / normal.z)];
        let zs = [corners[0].z, corners[1].z, corners[2].z];
        let (lowest, highest) = (zs[0].min(zs[1]).min(zs[2]), zs[0].max(zs[1]).max(zs[2]));
        Self { corner: corners[0], slope, lowest, highest }
    }

    /// The height over the cell's centre, never beyond the corners' heights.
    #[inline(always)]
    fn height_at(&self, cell: CellIndex) -> f64 {
        let (dx, dy) = (f64::from(cell.x) + 0.5 - self.corner.x, f64::from(cell.y) + 0.5 - self.corner.y);
        (self.corner.z + self.slope[0] * dx + self.slope[1] * dy).clamp(self.lowest, self.highest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_between_the_corners_follow_the_slope() {
        let plane = Plane::through(&[[0.0, 0.0, 0.0], [10.0, 0.0, 20.0], [0.0, 10.0, 0.0]].map(Vector3::from));
        assert!((plane.height_at(CellIndex { x: 4, y: 2 }) - 9.0).abs() < 1e-9);
        assert_eq!(plane.height_at(CellIndex { x: 40, y: 2 }), 20.0);
    }

    #[test]
    fn an_upright_triangle_keeps_within_its_corners() {
        let plane = Plane::through(&[[0.0, 0.0, 1.0], [10.0, 0.0, 2.0], [5.0, 0.0, 9.0]].map(Vector3::from));
        assert!((1.0..=9.0).contains(&plane.height_at(CellIndex { x: 4, y: 0 })));
    }
}
