//! One scan on its way into the tiles.

use super::cell::{Cell, Item};
use super::frame::{Frame, Plane};
use super::index::{CellIndex, TileIndex};
use super::insert::InsertSummary;
use super::rasterise::{cells_inside, cells_under_longest_side};
use super::tile::{TILE_CELLS, Tile};
use crate::analysis::PointScore;
use crate::scan::{Grid, Point};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Marks a point without a cell; outside of every map.
const NOWHERE: CellIndex = CellIndex { x: i32::MAX, y: i32::MAX };

/// One insert under way.
pub(super) struct Projection<'a> {
    tiles: &'a mut Vec<Tile>,
    slots: &'a mut BTreeMap<TileIndex, usize>,
    revision: u64,
    /// The tile used last: neighbouring points mostly share it.
    current: Option<(TileIndex, usize)>,
    pub(super) summary: InsertSummary,
}

impl<'a> Projection<'a> {
    pub(super) fn new(tiles: &'a mut Vec<Tile>, slots: &'a mut BTreeMap<TileIndex, usize>, revision: u64) -> Self {
        Self { tiles, slots, revision, current: None, summary: InsertSummary::default() }
    }

    pub(super) fn add_points(
        &mut self,
        points: &[Point],
        scores: &[PointScore],
        frame: &Frame,
        cells: &mut Vec<CellIndex>,
    ) {
        cells.clear();
        cells.reserve(points.len());
        for (point, score) in points.iter().zip(scores) {
            cells.push(self.add_point(point, score, frame).unwrap_or(NOWHERE));
        }
    }

    /// Counts a point and returns its cell, if it has one.
    fn add_point(&mut self, point: &Point, score: &PointScore, frame: &Frame) -> Option<CellIndex> {
        if !point.is_return() {
            return None;
        }
        if !score.is_valid() {
            self.summary.points_without_score += 1;
            return None;
        }
        let position = frame.position(point);
        let Some(index) = CellIndex::containing(position.x, position.y) else {
            self.summary.points_outside += 1;
            return None;
        };
        let reach = u16::from(score.is_reachable());
        let (navigable, obstacle) = (score.navigable * reach, score.obstacle * reach);
        let item = frame.item(navigable, obstacle, score.quality, position.z, &score.normal());
        self.cell(index).add_measured(&item);
        self.summary.points += 1;
        Some(index)
    }

    pub(super) fn add_triangles(
        &mut self,
        points: &[Point],
        scores: &[PointScore],
        grid: Grid,
        frame: &Frame,
        cells: &[CellIndex],
    ) {
        const ANY_KEPT: u16 = PointScore::KEPT_WITHOUT * 0b1111;
        let Grid { rows, cols } = grid;
        for row in 0..rows {
            // The quads of the last row and column lie across the seam; they keep triangles only where it is closed.
            let below = if row + 1 < rows { row + 1 } else { 0 };
            for col in 0..cols {
                let a = row * cols + col;
                if scores[a].flags & ANY_KEPT == 0 {
                    continue;
                }
                let right = if col + 1 < cols { col + 1 } else { 0 };
                let quad = [a, row * cols + right, below * cols + col, below * cols + right];
                let first = cells[quad[0]];
                // Most quads lie within one cell, which has its own points.
                if quad.iter().all(|&i| cells[i] == first) {
                    continue;
                }
                for (without, corners) in [(0, [1, 2, 3]), (1, [0, 2, 3]), (2, [0, 1, 3]), (3, [0, 1, 2])] {
                    if scores[a].keeps_triangle_without(without) {
                        let [i, j, k] = corners;
                        self.add_triangle(points, scores, [quad[i], quad[j], quad[k]], frame, cells);
                    }
                }
            }
        }
    }

    fn add_triangle(
        &mut self,
        points: &[Point],
        scores: &[PointScore],
        corners: [usize; 3],
        frame: &Frame,
        cells: &[CellIndex],
    ) {
        // Written out: `array::map` is not inlined here and costs as much as the rest.
        let [a, b, c] = corners;
        let own = [cells[a], cells[b], cells[c]];
        let is_reachable = corners.iter().any(|&i| scores[i].is_reachable());
        if own.contains(&NOWHERE) || !is_reachable || !has_cells_between(&own) {
            return;
        }
        let positions = [frame.position(&points[a]), frame.position(&points[b]), frame.position(&points[c])];
        let [p, q, r] = &positions;
        let plan = [[p.x, p.y], [q.x, q.y], [r.x, r.y]];
        self.summary.triangles += 1;
        let obstacle = mean_obstacle(scores, corners);
        let clipped = if frame.is_obstacle(obstacle) {
            let height = (p.z + q.z + r.z) / 3.0;
            let item = mean_item(scores, corners, height, frame);
            cells_under_longest_side(&plan, &own, frame.max_cells, |cell| self.interpolate(cell, &own, &item))
        } else {
            // Most triangles near the scanner are small and cover no cell's centre: nothing is prepared for those.
            let mut prepared: Option<(Plane, Item)> = None;
            cells_inside(&plan, frame.max_cells, |cell| {
                let (plane, item) = prepared
                    .get_or_insert_with(|| (Plane::through(&positions), mean_item(scores, corners, 0.0, frame)));
                item.height = frame.height(plane.height_at(cell));
                self.interpolate(cell, &own, item);
            })
        };
        self.summary.triangles_clipped += usize::from(clipped);
    }

    /// Gives a triangle's evidence to a cell that holds none of its corners; the others have points of their own.
    fn interpolate(&mut self, index: CellIndex, own: &[CellIndex; 3], item: &Item) {
        if !own.contains(&index) {
            self.cell(index).add_interpolated(item);
        }
    }

    /// The cell at `index`, made if need be, and marked as touched.
    #[inline]
    fn cell(&mut self, index: CellIndex) -> &mut Cell {
        let slot = self.slot(index.tile());
        let tile = &mut self.tiles[slot];
        if tile.revision != self.revision {
            tile.revision = self.revision;
            tile.touched = [0; TILE_CELLS / 64];
            self.summary.tiles_changed += 1;
        }
        let within = index.within_tile();
        let cell = &mut tile.cells[within];
        let (word, bit) = (within / 64, 1 << (within % 64));
        if tile.touched[word] & bit == 0 {
            tile.touched[word] |= bit;
            self.summary.cells_touched += 1;
            self.summary.new_cells += usize::from(cell.is_unknown());
        }
        cell
    }

    #[inline]
    fn slot(&mut self, index: TileIndex) -> usize {
        if let Some((current, slot)) = self.current
            && current == index
        {
            return slot;
        }
        let slot = *self.slots.entry(index).or_insert_with(|| {
            self.tiles.push(Tile::new(index));
            self.tiles.len() - 1
        });
        self.current = Some((index, slot));
        slot
    }
}

/// Whether a triangle with corners in these cells can cover another cell.
fn has_cells_between(own: &[CellIndex; 3]) -> bool {
    let span = |a: i32, b: i32, c: i32| i64::from(a.max(b).max(c)) - i64::from(a.min(b).min(c)) + 1;
    // One cell, or two side by side, are all taken by the corners themselves.
    span(own[0].x, own[1].x, own[2].x) * span(own[0].y, own[1].y, own[2].y) > 2
}

/// The mean of a score over a triangle's corners, rounded.
fn mean(scores: &[PointScore], corners: [usize; 3], score: impl Fn(&PointScore) -> u16) -> u16 {
    let [a, b, c] = corners;
    let sum = u32::from(score(&scores[a])) + u32::from(score(&scores[b])) + u32::from(score(&scores[c]));
    ((sum + 1) / 3) as u16
}

/// The mean B of the corners; a corner out of the robot's reach has none.
fn mean_obstacle(scores: &[PointScore], corners: [usize; 3]) -> u16 {
    mean(scores, corners, |s| if s.is_reachable() { s.obstacle } else { 0 })
}

/// The mean scores and normal of a triangle's corners; a corner out of the robot's reach has F = B = 0.
fn mean_item(scores: &[PointScore], corners: [usize; 3], height: f64, frame: &Frame) -> Item {
    let navigable = mean(scores, corners, |s| if s.is_reachable() { s.navigable } else { 0 });
    let quality = mean(scores, corners, |s| s.quality);
    let [a, b, c] = corners;
    let normal = scores[a].normal() + scores[b].normal() + scores[c].normal();
    let normal = normal.try_normalize(1e-3).unwrap_or_else(Vector3::z);
    frame.item(navigable, mean_obstacle(scores, corners), quality, height, &normal)
}
