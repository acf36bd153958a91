//! Kept triangles over the cells between their corners.

use super::block::{byte, reachable_scores};
use super::condense::{Frame, NOWHERE};
use super::index::{CellIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS, INTERPOLATED, Item, OBSTACLE, Place};
use super::normal_statistics::store;
use super::rasterise::{Outline, cells_under_longest_side};
use crate::analysis::PointScore;
use crate::scan::Grid;
use nalgebra::Vector3;
use std::ops::Range;

const ANY_KEPT: u16 = PointScore::KEPT_WITHOUT * 0b1111;

/// The corners of a quad's triangles, by the corner each leaves out.
const CORNERS_WITHOUT: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

/// Triangles that were rasterised.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PatchTally {
    pub triangles: usize,
    pub clipped: usize,
}

/// A scan whose points have their places.
pub(super) struct Patches<'a> {
    pub places: &'a [Place],
    pub scores: &'a [PointScore],
    pub grid: Grid,
    pub frame: &'a Frame,
}

impl Patches<'_> {
    /// One item for every cell whose middle lies under a long triangle of the quads of these rows.
    pub fn of_rows(&self, grid_rows: Range<usize>, out: &mut Vec<Item>) -> PatchTally {
        let Grid { rows, cols } = self.grid;
        let mut tally = PatchTally::default();
        for row in grid_rows {
            // The quads of the last row and column lie across the seam; they keep triangles only where it is closed.
            let below = if row + 1 < rows { row + 1 } else { 0 };
            let (upper, lower) = (&self.places[row * cols..][..cols], &self.places[below * cols..][..cols]);
            for (col, score) in self.scores[row * cols..][..cols].iter().enumerate() {
                if score.flags & ANY_KEPT == 0 {
                    continue;
                }
                let right = if col + 1 < cols { col + 1 } else { 0 };
                // Most quads lie within one cell, which has its own points.
                let (a, b, c, d) = (&upper[col], &upper[right], &lower[col], &lower[right]);
                if is_one_cell(a, b, c, d) || is_short(a, b, c, d) {
                    continue;
                }
                let quad = [row * cols + col, row * cols + right, below * cols + col, below * cols + right];
                // One turn a kept triangle: which of the four they are cannot be predicted, that they are two can.
                let mut kept = (score.flags & ANY_KEPT) / PointScore::KEPT_WITHOUT;
                while kept != 0 {
                    let [i, j, k] = CORNERS_WITHOUT[kept.trailing_zeros() as usize];
                    self.triangle([quad[i], quad[j], quad[k]], &mut tally, out);
                    kept &= kept - 1;
                }
            }
        }
        tally
    }

    fn triangle(&self, corners: [usize; 3], tally: &mut PatchTally, out: &mut Vec<Item>) {
        // Written out: `array::map` is not inlined here and costs as much as the rest.
        let [a, b, c] = corners;
        let (p, q, r) = (&self.places[a], &self.places[b], &self.places[c]);
        if *p == NOWHERE || *q == NOWHERE || *r == NOWHERE || !is_long(p, q, r) {
            return;
        }
        let scores = [&self.scores[a], &self.scores[b], &self.scores[c]];
        if (scores[0].flags | scores[1].flags | scores[2].flags) & PointScore::REACHABLE == 0 {
            return;
        }
        tally.triangles += 1;
        let clipped = if self.is_obstacle(scores) {
            self.steep([p, q, r], scores, out)
        } else {
            // Most triangles near the scanner are small and cover no cell's centre: nothing is prepared for those.
            let mut prepared: Option<(Plane, Item)> = None;
            Outline::of([(p.x, p.y), (q.x, q.y), (r.x, r.y)]).cells_inside(self.frame.max_cells, |cell| {
                let (plane, item) = prepared.get_or_insert_with(|| {
                    (Plane::through(&[position(p), position(q), position(r)]), self.mean_item(scores))
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

    fn is_obstacle(&self, scores: [&PointScore; 3]) -> bool {
        let obstacle = |score: &PointScore| u32::from(reachable_scores(score).1);
        let sum = obstacle(scores[0]) + obstacle(scores[1]) + obstacle(scores[2]);
        self.frame.thresholds.kind(0, ((sum + 1) / 3) as u16) & OBSTACLE != 0
    }

    /// The mean scores and normal of a triangle's corners; a corner out of the robot's reach has F = B = 0.
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
#[inline]
fn over(cell: CellIndex, height: f64, item: &Item) -> Item {
    let middle = |v: i32| (v << CELL_SHIFT) + CELL_UNITS / 2;
    item.at(Place { x: middle(cell.x), y: middle(cell.y), z: floor(height + 0.5) })
}

#[inline]
fn cell_of(place: &Place) -> CellIndex {
    CellIndex { x: place.x >> CELL_SHIFT, y: place.y >> CELL_SHIFT }
}

/// The position in cells, the height in its own units.
#[inline]
fn position(place: &Place) -> Vector3<f64> {
    let cells = |v: i32| (f64::from(v) + 0.5) / f64::from(CELL_UNITS);
    Vector3::new(cells(place.x), cells(place.y), f64::from(place.z))
}

#[inline]
fn is_one_cell(a: &Place, b: &Place, c: &Place, d: &Place) -> bool {
    // Equal in all bits above those within a cell.
    let other = |p: &Place| ((p.x ^ a.x) | (p.y ^ a.y)) as u32;
    (other(b) | other(c) | other(d)) >> CELL_SHIFT == 0
}

/// Whether a triangle is longer than nine tenths of a cell. The corners of shorter ones lie in every cell they cover,
/// wherever a correction moves them.
#[inline]
fn is_long(p: &Place, q: &Place, r: &Place) -> bool {
    let extent = |a: i32, b: i32, c: i32| i64::from(a.max(b).max(c)) - i64::from(a.min(b).min(c));
    is_extent_long(extent(p.x, q.x, r.x), extent(p.y, q.y, r.y))
}

/// Whether no triangle of a quad is long, told at once; a quad with a corner nowhere may have one.
#[inline]
fn is_short(a: &Place, b: &Place, c: &Place, d: &Place) -> bool {
    let extent = |a: i32, b: i32, c: i32, d: i32| i64::from(a.max(b).max(c.max(d))) - i64::from(a.min(b).min(c.min(d)));
    let (x, y) = (extent(a.x, b.x, c.x, d.x), extent(a.y, b.y, c.y, d.y));
    // Compared first: the squares of what is nowhere may not fit.
    (x | y) < i64::from(CELL_UNITS) && !is_extent_long(x, y)
}

#[inline]
fn is_extent_long(x: i64, y: i64) -> bool {
    100 * (x * x + y * y) > 81 * i64::from(CELL_UNITS * CELL_UNITS)
}

/// The plane through a triangle's corners, to give a height to the cells between them.
struct Plane {
    corner: Vector3<f64>,
    slope: [f64; 2],
    lowest: f64,
    highest: f64,
}

impl Plane {
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
