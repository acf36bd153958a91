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
        for row in 0..grid.rows.saturating_sub(1) {
            for col in 0..grid.cols.saturating_sub(1) {
                let a = row * grid.cols + col;
                if scores[a].flags & ANY_KEPT == 0 {
                    continue;
                }
                let quad = [a, a + 1, a + grid.cols, a + grid.cols + 1];
                let first = cells[quad[0]];
                // Most quads lie within one cell, which has its own points.
                if quad.iter().all(|&i| cells[i] == first) {
                    continue;
                }
                for (without, corners) in [(0, [1, 2, 3]), (1, [0, 2, 3]), (2, [0, 1, 3]), (3, [0, 1, 2])] {
                    if scores[a].keeps_triangle_without(without) {
                        self.add_triangle(points, scores, corners.map(|k| quad[k]), frame, cells);
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
        let own = corners.map(|i| cells[i]);
        let is_reachable = corners.iter().any(|&i| scores[i].is_reachable());
        if !is_reachable || own.contains(&NOWHERE) || (own[0] == own[1] && own[1] == own[2]) {
            return;
        }
        let positions = corners.map(|i| frame.position(&points[i]));
        let plan = positions.map(|p| [p.x, p.y]);
        let plane = Plane::through(&positions);
        let height = positions.iter().map(|p| p.z).sum::<f64>() / 3.0;
        let mut item = mean_item(scores, corners, height, frame);
        let is_steep = item.is_obstacle;
        self.summary.triangles += 1;
        let visit = |cell: CellIndex| {
            if !own.contains(&cell) {
                if !is_steep {
                    item.height = frame.height(plane.height_at(cell));
                }
                self.cell(cell).add_interpolated(&item);
            }
        };
        let clipped = if is_steep {
            cells_under_longest_side(&plan, &own, frame.max_cells, visit)
        } else {
            cells_inside(&plan, frame.max_cells, visit)
        };
        self.summary.triangles_clipped += usize::from(clipped);
    }

    /// The cell at `index`, made if need be, and marked as touched.
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

/// The mean scores and normal of a triangle's corners; a corner out of the robot's reach has F = B = 0.
fn mean_item(scores: &[PointScore], corners: [usize; 3], height: f64, frame: &Frame) -> Item {
    let mean = |score: fn(&PointScore) -> u16| {
        let sum: u32 = corners.iter().map(|&i| u32::from(score(&scores[i]))).sum();
        ((sum + 1) / 3) as u16
    };
    let navigable = mean(|s| if s.is_reachable() { s.navigable } else { 0 });
    let obstacle = mean(|s| if s.is_reachable() { s.obstacle } else { 0 });
    let normal: Vector3<f32> = corners.iter().map(|&i| scores[i].normal()).sum();
    let normal = normal.try_normalize(1e-3).unwrap_or_else(Vector3::z);
    frame.item(navigable, obstacle, mean(|s| s.quality), height, &normal)
}
