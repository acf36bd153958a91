//! The part of the information map that a plan looks at, as planes of bits around the robot, so that sweeps work on
//! whole words of cells. Beyond the map everything is unknown.

mod keep_out;

use super::bits::{BitPlane, WORD};
use super::config::{FootprintRule, PlanningConfig};
use super::relief::{Patch, ReliefLimits};
use super::sweep::Blocking;
use super::tile_digest::{SIDE, TileDigest};
use super::tiles::{TileCache, TileWindow};
use crate::information_map::{CellIndex, InformationMap, Obstruction, TILE_SIDE};
use crate::simd;
use nalgebra::Point3;

/// The window of a plan: the ground that candidates and paths may use, and the scanner's range around it, so that no
/// sweep needs a check of its bounds.
#[derive(Debug, Default)]
pub(super) struct PlanningGrid {
    window: TileWindow,
    /// Cells along x, a multiple of 64.
    pub width: usize,
    /// Cells along y, a multiple of 64.
    pub height: usize,
    /// Side of a cell [m].
    pub cell_m: f64,
    tiles: TileCache,
    /// Slots of the tiles of the window.
    table: Vec<u32>,
    /// What the planes were laid out for.
    laid_out: Option<(Extent, PlanningConfig, Vec<Obstruction>, usize)>,
    /// C_nc under the sight threshold: blocks the view, is an obstacle. Rows of constant y.
    pub blocks: BitPlane,
    /// The same, rows of constant x.
    blocks_by_column: BitPlane,
    /// Known cells in the work area.
    pub known: BitPlane,
    /// Cells in which ground was measured, wherever the work area is.
    grounded: BitPlane,
    /// Cells of the work area of which nothing was ever seen.
    pub unexplored: BitPlane,
    /// C_nc over the navigable threshold, near enough to be driven to (wherever the work area is).
    pub navigable: BitPlane,
    /// In the work area.
    pub area: BitPlane,
    /// Cells that can be driven on at a step: the ground of a neighbour, or their own, lies lower than the robot masters.
    pub steps: BitPlane,
    /// Cells with steep ground.
    pub steep: BitPlane,
    /// Cells in which something held the robot.
    pub held: BitPlane,
    /// Cells that the robot has driven over, and that neither hold it nor block its view now.
    pub driven: BitPlane,
    /// Cells near ground that was never seen, wider than the gaps between the scanner's rings.
    hidden: BitPlane,
    /// Cells so near to ground without a measurement that the robot does not turn there.
    pub precarious: BitPlane,
    /// The footprint would touch an obstacle, steep ground, a step, hidden ground or what held the robot, or what its rule
    /// forbids.
    pub cramped: BitPlane,
    /// So near to an obstacle, steep ground, a step or known ground that is not proven that a metre costs more: all such cells,
    /// and those in the inner half of the way to the clearance asked for.
    pub beside: BitPlane,
    pub close_beside: BitPlane,
    scratch: BitPlane,
}

/// What a window is laid out for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extent {
    window: TileWindow,
    /// Cells that can be driven to lie between these, both included.
    near: [CellIndex; 2],
    /// From here levels are reached [m, map frame].
    robot: Point3<f64>,
}

impl Extent {
    /// Ground to `reach_m` from the robot along each axis, and the scanner's range around it. `None` when the robot is
    /// not on the map's plane.
    pub fn new(map: &InformationMap, robot: &Point3<f64>, reach_m: f64, config: &PlanningConfig) -> Option<Self> {
        let here = map.cell_containing(robot.x, robot.y)?;
        let cells = |metres: f64| (metres / map.cell_m()).ceil() as i32;
        let reach = cells(reach_m.max(config.start_clearance_m));
        let around = config.footprint_radius_m.max(config.step_clearance_m);
        let margin = cells(config.scanner.range_m).max(cells(around)) + 2;
        let tiles = |low: i32, high: i32| {
            let (first, last) = (low.div_euclid(TILE_SIDE), high.div_euclid(TILE_SIDE));
            // Whole words of cells, which a row of four tiles is.
            (first, ((last - first + 1) as usize).next_multiple_of(WORD / SIDE))
        };
        let (low_x, cols) = tiles(here.x - reach - margin, here.x + reach + margin);
        let (low_y, rows) = tiles(here.y - reach - margin, here.y + reach + margin);
        let near = [-reach, reach].map(|by| CellIndex { x: here.x + by, y: here.y + by });
        Some(Self { window: TileWindow { low: [low_x, low_y], cols, rows }, near, robot: *robot })
    }

    /// Whether the map has tiles that the window leaves out.
    pub fn leaves_out_some_of(&self, map: &InformationMap) -> bool {
        let [low, high] = self.near.map(CellIndex::tile);
        map.tiles_between(low, high).count() < map.tile_count()
    }

    /// Whether a cell can be driven to, if it is ground to drive on: so far from the window's rim that all around it is in the
    /// window, too.
    pub fn is_near(&self, cell: CellIndex) -> bool {
        let [low, high] = self.near;
        (low.x..=high.x).contains(&cell.x) && (low.y..=high.y).contains(&cell.y)
    }
}

impl PlanningGrid {
    /// Lays out the window, unless that is done. `config` is without preferences. Returns whether anything the layout
    /// depends on has changed since the last call.
    pub fn lay_out(&mut self, map: &InformationMap, extent: &Extent, config: &PlanningConfig, threads: usize) -> bool {
        let obstructions = map.obstructions();
        let driven = map.driven();
        let is_layout = |(of, with, among, pieces): &(Extent, PlanningConfig, Vec<Obstruction>, usize)| {
            of == extent && with == config && among == obstructions && *pieces == driven.len()
        };
        let is_same = self.laid_out.as_ref().is_some_and(is_layout);
        self.window = extent.window;
        (self.width, self.height) = (extent.window.cols * SIDE, extent.window.rows * SIDE);
        self.cell_m = map.cell_m();
        let has_changed = self.tiles.update(map, &self.window, &extent.robot, config, threads, &mut self.table);
        if is_same && !has_changed {
            return false;
        }
        self.mark_area(config);
        self.gather();
        self.mark_hidden(extent, config);
        self.leave_out_what_is_outside();
        self.mark_held(obstructions);
        self.mark_relief(config);
        self.mark_beside(config);
        self.keep_near(extent);
        self.mark_cramped(config);
        self.mark_driven(driven, extent);
        self.laid_out = Some((*extent, config.clone(), obstructions.to_vec(), driven.len()));
        true
    }

    /// The work area is a rectangle, so a row and a column are in it or not.
    fn mark_area(&mut self, config: &PlanningConfig) {
        let stride = self.width / WORD;
        self.area.reset(self.height, stride, u64::MAX);
        let Some(area) = config.work_area else { return };
        let is_in = |axis: usize, cell: i32| {
            let middle = (f64::from(cell) + 0.5) * self.cell_m;
            (area.min[axis]..=area.max[axis]).contains(&middle)
        };
        let corner = self.corner();
        let mut columns = vec![0u64; stride];
        for bit in (0..self.width).filter(|&bit| is_in(0, corner.x + bit as i32)) {
            columns[bit / WORD] |= 1 << (bit % WORD);
        }
        for row in 0..self.height {
            let is_row_in = is_in(1, corner.y + row as i32);
            for (word, column) in self.area.row_mut(row).iter_mut().zip(&columns) {
                *word = if is_row_in { *column } else { 0 };
            }
        }
    }

    /// Puts the tiles' bits in their places.
    fn gather(&mut self) {
        let (height, stride) = (self.height, self.width / WORD);
        for plane in [&mut self.blocks, &mut self.known, &mut self.grounded, &mut self.navigable] {
            plane.reset(height, stride, 0);
        }
        for (place, &slot) in self.table.iter().enumerate() {
            let Some(digest) = self.tiles.digest(slot) else { continue };
            let (first_row, group) = (place / self.window.cols * SIDE, place % self.window.cols);
            for k in 0..SIDE {
                self.blocks.or_sixteen(first_row + k, group, digest.blocks[k]);
                self.known.or_sixteen(first_row + k, group, digest.known[k]);
                self.grounded.or_sixteen(first_row + k, group, digest.grounded[k]);
                self.navigable.or_sixteen(first_row + k, group, digest.navigable[k]);
            }
        }
        self.blocks_by_column.reset(self.width, height / WORD, 0);
        self.blocks.or_transposed_into(&mut self.blocks_by_column);
    }

    /// Outside the work area nothing is looked for.
    fn leave_out_what_is_outside(&mut self) {
        self.unexplored.reset(self.height, self.width / WORD, 0);
        let known = self.known.words.iter_mut().zip(&mut self.unexplored.words);
        for ((known, unexplored), area) in known.zip(&self.area.words) {
            *unexplored = !*known & area;
            *known &= area;
        }
    }

    /// Calls `visit` with row and bit of every cell of the window whose centre lies within a distance of a place.
    fn for_each_cell_within(
        &mut self,
        [x, y]: [f64; 2],
        radius_m: f64,
        mut visit: impl FnMut(&mut Self, usize, usize),
    ) {
        let (corner, cell_m) = (self.corner(), self.cell_m);
        let cells = |middle: f64, corner: i32, count: usize| {
            let [low, high] =
                [middle - radius_m, middle + radius_m].map(|end| (end / cell_m).floor() - f64::from(corner));
            low.max(0.0) as usize..(high + 1.0).clamp(0.0, count as f64) as usize
        };
        for row in cells(y, corner.y, self.height) {
            for bit in cells(x, corner.x, self.width) {
                let [cell_x, cell_y] = self.centre(row * self.width + bit);
                if (cell_x - x).hypot(cell_y - y) <= radius_m {
                    visit(self, row, bit);
                }
            }
        }
    }

    /// Marks the ground that is left to be driven on only where there is no other.
    fn mark_beside(&mut self, config: &PlanningConfig) {
        self.scratch.stride = self.blocks.stride;
        self.scratch.words.clear();
        let relief = self.steps.words.iter().zip(&self.steep.words).zip(&self.held.words);
        let planes = self.known.words.iter().zip(&self.navigable.words).zip(relief);
        let kept_from =
            planes.map(|((known, navigable), ((steps, steep), held))| (known & !navigable) | steps | steep | held);
        self.scratch.words.extend(kept_from);
        let inner = 0.5 * (config.footprint_radius_m.min(config.clearance_m) + config.clearance_m);
        self.scratch.dilate_into(config.clearance_m / self.cell_m, &mut self.beside);
        self.scratch.dilate_into(inner / self.cell_m, &mut self.close_beside);
    }

    /// How near a cell lies to what is kept away from: 0 not near, 1 beside, 2 close beside, 3 so that the footprint touches it.
    pub fn closeness(&self, at: usize) -> u8 {
        match () {
            () if self.has(&self.cramped, at) => 3,
            () if self.has(&self.close_beside, at) => 2,
            () => u8::from(self.has(&self.beside, at)),
        }
    }

    /// Lets go of navigable cells beyond the reach.
    fn keep_near(&mut self, extent: &Extent) {
        let corner = self.corner();
        let bit = |end: usize| (extent.near[end].x - corner.x) as usize;
        let row = |end: usize| (extent.near[end].y - corner.y) as usize;
        let mut columns = BitPlane::default();
        columns.reset(1, self.navigable.stride, 0);
        columns.set_range(0, bit(0), bit(1));
        for at in 0..self.height {
            let is_near = (row(0)..=row(1)).contains(&at);
            for (word, column) in self.navigable.row_mut(at).iter_mut().zip(&columns.words) {
                *word &= if is_near { *column } else { 0 };
            }
        }
    }

    /// Marks the cells at a step and those with steep ground.
    fn mark_relief(&mut self, config: &PlanningConfig) {
        let limits = ReliefLimits::new(config, self.cell_m);
        let mut planes = [&mut self.steps, &mut self.steep].map(std::mem::take);
        for plane in &mut planes {
            plane.reset(self.height, self.width / WORD, 0);
        }
        let [steps, steep] = &mut planes;
        for (place, &slot) in self.table.iter().enumerate() {
            let Some(digest) = self.tiles.digest(slot) else { continue };
            let (group, tile_row) = (place % self.window.cols, place / self.window.cols);
            let patch = Patch::of(self, group, tile_row);
            let (over, steep_rows) = simd::widest(|| (patch.over_steps(&limits), patch.steep(&limits)));
            for row in 0..SIDE {
                steps.or_sixteen(tile_row * SIDE + row, group, over[row] & digest.navigable[row] | digest.uneven[row]);
                steep.or_sixteen(tile_row * SIDE + row, group, steep_rows[row]);
            }
        }
        [self.steps, self.steep] = planes;
    }

    /// Marks every cell that has the middle of an obstacle, of steep ground or of what held the robot within the footprint's
    /// radius of its own, by the strict rule also any cell that is not proven ground, or that of a cell at a step within the
    /// distance kept from those; and what lies near hidden ground.
    fn mark_cramped(&mut self, config: &PlanningConfig) {
        self.scratch.stride = self.blocks.stride;
        self.scratch.words.clear();
        let is_strict = config.footprint == FootprintRule::Verified;
        let unproven = |navigable: &u64| if is_strict { !navigable } else { 0 };
        let solid = self.blocks.words.iter().zip(&self.steep.words).zip(&self.held.words);
        let planes = solid.map(|((blocks, steep), held)| blocks | steep | held).zip(&self.navigable.words);
        self.scratch.words.extend(planes.map(|(solid, navigable)| solid | unproven(navigable)));
        self.scratch.dilate_into(config.footprint_radius_m / self.cell_m, &mut self.cramped);
        self.steps.dilate_into(config.step_clearance_m / self.cell_m, &mut self.scratch);
        let near = self.scratch.words.iter().zip(&self.hidden.words);
        for (cramped, (near_step, near_hidden)) in self.cramped.words.iter_mut().zip(near) {
            *cramped |= near_step | near_hidden;
        }
    }

    fn corner(&self) -> CellIndex {
        CellIndex { x: self.window.low[0] * TILE_SIDE, y: self.window.low[1] * TILE_SIDE }
    }

    /// What sweeps read.
    pub fn blocking(&self) -> Blocking<'_> {
        Blocking { rows: &self.blocks, columns: &self.blocks_by_column }
    }

    /// The number of cells.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// The place of a cell in arrays over the window, or `None` outside.
    pub fn at(&self, index: CellIndex) -> Option<usize> {
        let corner = self.corner();
        let (x, y) = (i64::from(index.x) - i64::from(corner.x), i64::from(index.y) - i64::from(corner.y));
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// The cell at a place.
    pub fn index(&self, at: usize) -> CellIndex {
        let corner = self.corner();
        CellIndex { x: corner.x + (at % self.width) as i32, y: corner.y + (at / self.width) as i32 }
    }

    /// The centre of a cell [m, map frame].
    pub fn centre(&self, at: usize) -> [f64; 2] {
        let index = self.index(at);
        [index.x, index.y].map(|i| (f64::from(i) + 0.5) * self.cell_m)
    }

    /// Whether a plane of this grid has the cell's bit.
    pub fn has(&self, plane: &BitPlane, at: usize) -> bool {
        plane.has(at / self.width, at % self.width)
    }

    /// The tile over a group of sixteen columns and sixteen rows.
    pub fn tile(&self, group: usize, tile_row: usize) -> Option<&TileDigest> {
        if group >= self.window.cols || tile_row >= self.window.rows {
            return None;
        }
        self.tiles.digest(self.table[tile_row * self.window.cols + group])
    }

    /// The tile of a cell that is known, and the cell's place in it.
    pub fn known_cell(&self, at: usize) -> Option<(&TileDigest, usize)> {
        let (x, y) = (at % self.width, at / self.width);
        let digest = self.tile(x / SIDE, y / SIDE)?;
        (digest.known[y % SIDE] >> (x % SIDE) & 1 == 1).then_some((digest, y % SIDE * SIDE + x % SIDE))
    }

    /// Height of the ground of a cell [m, map frame], where any was seen.
    pub fn ground(&self, at: usize) -> Option<f32> {
        let (digest, within) = self.known_cell(at)?;
        (digest.grounded[within / SIDE] >> (within % SIDE) & 1 == 1).then(|| digest.cells.ground[within])
    }

    /// Offsets, as places, to all cells whose centres lie within `radius_m`, this cell included.
    pub fn disc(&self, radius_m: f64) -> Vec<isize> {
        let radius = radius_m / self.cell_m;
        let reach = radius.floor() as isize;
        let within = |x: isize, y: isize| ((x * x + y * y) as f64) <= radius * radius;
        (-reach..=reach)
            .flat_map(|y| (-reach..=reach).filter(move |&x| within(x, y)).map(move |x| (x, y)))
            .map(|(x, y)| y * self.width as isize + x)
            .collect()
    }

    /// The square of the distance between the centres of two cells [cells^2].
    pub fn square_distance(&self, a: usize, b: usize) -> usize {
        (a % self.width).abs_diff(b % self.width).pow(2) + (a / self.width).abs_diff(b / self.width).pow(2)
    }

    /// The eight cells around one that is not at the edge of the window, and whether they share a side with it.
    pub fn neighbours(&self, at: usize) -> impl Iterator<Item = (usize, bool)> {
        let width = self.width as isize;
        let around = [(1, true), (-1, true), (width, true), (-width, true)].into_iter();
        let corners = [width + 1, width - 1, 1 - width, -width - 1].map(|offset| (offset, false));
        around.chain(corners).map(move |(offset, is_beside)| (at.wrapping_add_signed(offset), is_beside))
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let planes = [
            &self.blocks,
            &self.blocks_by_column,
            &self.known,
            &self.grounded,
            &self.unexplored,
            &self.navigable,
            &self.area,
            &self.steps,
            &self.steep,
            &self.held,
            &self.driven,
            &self.hidden,
            &self.precarious,
            &self.cramped,
            &self.beside,
            &self.close_beside,
            &self.scratch,
        ];
        self.tiles.bytes() + planes.iter().map(|plane| 8 * plane.words.len()).sum::<usize>() + 4 * self.table.len()
    }
}
