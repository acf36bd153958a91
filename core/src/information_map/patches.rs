//! Kept triangles over the cells between their corners.

use super::block::{byte, reachable_scores};
use super::condense::{Frame, NOWHERE};
use super::index::{CellIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS, INTERPOLATED, Item, OBSTACLE, Place};
use super::normal_statistics::store;
use super::rasterise::{cells_inside, cells_under_longest_side};
use crate::analysis::PointScore;
use crate::scan::Grid;
use nalgebra::Vector3;
use std::ops::Range;

const ANY_KEPT: u16 = PointScore::KEPT_WITHOUT * 0b1111;

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
                if is_one_cell(&upper[col], &upper[right], &lower[col], &lower[right]) {
                    continue;
                }
                let quad = [row * cols + col, row * cols + right, below * cols + col, below * cols + right];
                for (without, [i, j, k]) in [(0, [1, 2, 3]), (1, [0, 2, 3]), (2, [0, 1, 3]), (3, [0, 1, 2])] {
                    if score.keeps_triangle_without(without) {
                        self.triangle([quad[i], quad[j], quad[k]], &mut tally, out);
                    }
                }
            }
        }
        tally
    }

    fn triangle(&self, corners: [usize; 3], tally: &mut PatchTally, out: &mut Vec<Item>) {
        // Written out: `array::map` is not inlined here and costs as much as the rest.
        let [a, b, c] = corners;
        let (p, q, r) = (self.places[a], self.places[b], self.places[c]);
        if p == NOWHERE || q == NOWHERE || r == NOWHERE || !is_long(&p, &q, &r) {
            return;
        }
        let scores = [&self.scores[a], &self.scores[b], &self.scores[c]];
        if !scores.iter().any(|score| score.is_reachable()) {
            return;
        }
        tally.triangles += 1;
        let own = [cell_of(&p), cell_of(&q), cell_of(&r)];
        let positions = [position(&p), position(&q), position(&r)];
        let plan =
            [[positions[0].x, positions[0].y], [positions[1].x, positions[1].y], [positions[2].x, positions[2].y]];
        let mut put = |cell: CellIndex, height: f64, item: &Item| {
            let middle = |v: i32| (v << CELL_SHIFT) + CELL_UNITS / 2;
            out.push(item.at(Place { x: middle(cell.x), y: middle(cell.y), z: floor(height + 0.5) }));
        };
        let clipped = if self.is_obstacle(scores) {
            let height = (positions[0].z + positions[1].z + positions[2].z) / 3.0;
            let item = self.mean_item(scores);
            cells_under_longest_side(&plan, &own, self.frame.max_cells, |cell| put(cell, height, &item))
        } else {
            // Most triangles near the scanner are small and cover no cell's centre: nothing is prepared for those.
            let mut prepared: Option<(Plane, Item)> = None;
            cells_inside(&plan, self.frame.max_cells, |cell| {
                let (plane, item) =
                    prepared.get_or_insert_with(|| (Plane::through(&positions), self.mean_item(scores)));
                put(cell, plane.height_at(cell), item);
            })
        };
        tally.clipped += usize::from(clipped);
    }

    fn is_obstacle(&self, scores: [&PointScore; 3]) -> bool {
        let sum: u32 = scores.iter().map(|score| u32::from(reachable_scores(score).1)).sum();
        self.frame.thresholds.kind(0, ((sum + 1) / 3) as u16) & OBSTACLE != 0
    }

    /// The mean scores and normal of a triangle's corners; a corner out of the robot's reach has F = B = 0.
    fn mean_item(&self, scores: [&PointScore; 3]) -> Item {
        let (mut navigable, mut obstacle, mut quality) = (0, 0, 0);
        let mut normal = Vector3::zeros();
        for score in scores {
            let (f, b) = reachable_scores(score);
            navigable += u32::from(f);
            obstacle += u32::from(b);
            quality += u32::from(score.quality);
            normal += score.normal();
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
    let extent = |a: i32, b: i32, c: i32| i64::from(a.max(b).max(c) - a.min(b).min(c));
    let (x, y) = (extent(p.x, q.x, r.x), extent(p.y, q.y, r.y));
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
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
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
