//! Which level of a cell is the one the robot would be on?

use super::cell::{Level, Levels};
use super::config::MapConfig;
use super::index::{CellIndex, TileIndex};
use super::map::InformationMap;
use super::navigability::CellState;
use super::tile::{TILE_CELLS, Tile};
use nalgebra::Point3;
use std::collections::{BTreeMap, VecDeque};

/// From where, and over what, a robot gets from level to level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Position of the robot's base [m, map frame].
    pub robot: Point3<f64>,
    /// Cells within this distance of the robot along x and y are looked at [m].
    pub window_m: f64,
    /// Known ground within this distance of the robot is where it can begin [m]: right under the scanner nothing is
    /// seen.
    pub start_m: f64,
    /// The largest difference in height between neighbouring levels that the robot masters [m].
    pub max_step_m: f64,
    /// C_nc that a level must exceed for the robot to go on from it, 0 to 1.
    pub navigable_threshold: f64,
}

/// For every cell the level that is reached first from the robot. Levels of neighbouring cells (all eight) connect when
/// the ground of both lies within one step; an obstacle counts to the level it stands on or in.
///
/// Where several levels of a cell can be reached, as with a bridge and the road under it when a ramp leads from one to
/// the other, the nearer one (in cells) is chosen; a planner that is to use both looks at [`Cell::levels`] and
/// [`Level::connects`] itself.
///
/// [`Cell::levels`]: super::Cell::levels
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LevelChoice {
    /// Only of cells in which it is not the lowest.
    higher: BTreeMap<CellIndex, usize>,
    /// Cells that are reached, one bit each, by tile.
    reached: BTreeMap<TileIndex, [u64; TILE_CELLS / 64]>,
}

impl LevelChoice {
    /// The level chosen in a cell, counted from the lowest.
    #[must_use]
    #[inline]
    pub fn of(&self, index: CellIndex) -> usize {
        if self.higher.is_empty() { 0 } else { self.higher.get(&index).copied().unwrap_or(0) }
    }

    /// Whether the robot gets to the chosen level of a cell, or could touch the obstacle there.
    #[must_use]
    pub fn is_reached(&self, index: CellIndex) -> bool {
        let within = index.within_tile();
        self.reached.get(&index.tile()).is_some_and(|bits| bits[within / 64] >> (within % 64) & 1 == 1)
    }

    /// The chosen one of a cell's levels.
    #[must_use]
    pub fn pick<'a>(&self, index: CellIndex, levels: &'a Levels) -> Option<&'a Level> {
        let levels = levels.as_slice();
        levels.get(self.of(index)).or_else(|| levels.first())
    }
}

impl InformationMap {
    /// Chooses the level of every cell in the window that is reached first from where the robot stands. The order of
    /// the search is fixed: the same map and place give the same choice. Nothing is reached from a place that is not on
    /// the map.
    #[must_use]
    pub fn choose_levels(&self, reach: &Reach) -> LevelChoice {
        let cells = |metres: f64| (metres / self.config.cell_m).clamp(0.0, 1e5).ceil() as i32;
        let Some(here) = self.cell_containing(reach.robot.x, reach.robot.y) else { return LevelChoice::default() };
        let mut search = Search::new(self, here, cells(reach.window_m), reach);
        let start = cells(reach.start_m);
        for (dx, dy) in (-start..=start).flat_map(|x| (-start..=start).map(move |y| (x, y))) {
            if f64::from(dx * dx + dy * dy).sqrt() * self.config.cell_m <= reach.start_m {
                let z = reach.robot.z;
                search.visit(CellIndex { x: here.x + dx, y: here.y + dy }, |node| node.is_at(z, z, reach.max_step_m));
            }
        }
        while let Some((index, from)) = search.queue.pop_front() {
            for (dx, dy) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
                let next = CellIndex { x: index.x + dx, y: index.y + dy };
                search.visit(next, |node| from.leads_to(node, reach.max_step_m));
            }
        }
        search.choice()
    }
}

/// One level as the search sees it.
#[derive(Clone, Copy)]
struct Node {
    lowest: f64,
    highest: f64,
    is_passable: bool,
    is_reached: bool,
}

impl Node {
    /// Whether it is where something stands that reaches from `low` to `high`.
    fn is_at(&self, low: f64, high: f64, step: f64) -> bool {
        self.lowest - step <= high && low <= self.highest + step
    }

    fn leads_to(&self, other: &Self, step: f64) -> bool {
        if other.is_passable {
            self.highest.max(other.highest) - self.lowest.min(other.lowest) <= step
        } else {
            other.is_at(self.lowest, self.highest, step)
        }
    }
}

/// The levels of a tile's cells.
struct TileNodes {
    index: TileIndex,
    /// Where those of each cell begin.
    first: [u32; TILE_CELLS + 1],
    nodes: Vec<Node>,
    /// The level of each cell that was reached first.
    chosen: [u8; TILE_CELLS],
}

const NOT_REACHED: u8 = u8::MAX;

impl TileNodes {
    fn new(tile: &Tile, config: &MapConfig, threshold: f64) -> Self {
        let mut nodes = Self {
            index: tile.index(),
            first: [0; TILE_CELLS + 1],
            nodes: Vec::new(),
            chosen: [NOT_REACHED; TILE_CELLS],
        };
        let node = |level: &Level| Node {
            lowest: level.lowest,
            highest: level.highest,
            is_passable: matches!(level.state(config.obstacle_weight), CellState::Known(c) if c > threshold),
            is_reached: false,
        };
        for within in 0..TILE_CELLS {
            let cell = tile.cell(within);
            match cell.undivided(config.clearance_m) {
                Some(level) => nodes.nodes.push(node(&level)),
                None => nodes.nodes.extend(cell.levels(config.clearance_m).as_slice().iter().map(node)),
            }
            nodes.first[within + 1] = nodes.nodes.len() as u32;
        }
        nodes
    }
}

/// A search over the tiles of a window, breadth first.
struct Search {
    low: TileIndex,
    width: i32,
    /// Rows of constant y.
    tiles: Vec<Option<TileNodes>>,
    queue: VecDeque<(CellIndex, Node)>,
}

impl Search {
    fn new(map: &InformationMap, here: CellIndex, window: i32, reach: &Reach) -> Self {
        let corner = |sign: i32| {
            CellIndex { x: here.x.saturating_add(sign * window), y: here.y.saturating_add(sign * window) }.tile()
        };
        let (mut low, mut high) = (corner(-1), corner(1));
        if let Some((first, last)) = map.tile_bounds() {
            low = TileIndex { x: low.x.max(first.x), y: low.y.max(first.y) };
            high = TileIndex { x: high.x.min(last.x), y: high.y.min(last.y) };
        }
        let (width, height) = ((high.x - low.x + 1).max(0), (high.y - low.y + 1).max(0));
        let mut search = Self { low, width, tiles: Vec::new(), queue: VecDeque::new() };
        search.tiles.resize_with(width as usize * height as usize, || None);
        for tile in map.tiles() {
            if let Some(place) = search.place(tile.index()) {
                search.tiles[place] = Some(TileNodes::new(tile, map.config(), reach.navigable_threshold));
            }
        }
        search
    }

    fn place(&self, tile: TileIndex) -> Option<usize> {
        let (x, y) = (tile.x - self.low.x, tile.y - self.low.y);
        let place = y.checked_mul(self.width)?.checked_add(x)?;
        let is_inside = (0..self.width).contains(&x) && (0..self.tiles.len() as i64).contains(&i64::from(place));
        (is_inside && y >= 0).then_some(place as usize)
    }

    /// Reaches the levels of a cell that `touches` holds for; the search goes on from those that can be driven on.
    fn visit(&mut self, index: CellIndex, touches: impl Fn(&Node) -> bool) {
        let Some(place) = self.place(index.tile()) else { return };
        let Some(Some(tile)) = self.tiles.get_mut(place) else { return };
        let within = index.within_tile();
        let own = tile.first[within] as usize..tile.first[within + 1] as usize;
        for (level, node) in (0..).zip(&mut tile.nodes[own]) {
            if !node.is_reached && touches(node) {
                node.is_reached = true;
                if tile.chosen[within] == NOT_REACHED {
                    tile.chosen[within] = level;
                }
                if node.is_passable {
                    self.queue.push_back((index, *node));
                }
            }
        }
    }

    fn choice(self) -> LevelChoice {
        let mut choice = LevelChoice::default();
        for tile in self.tiles.into_iter().flatten() {
            let mut bits = [0; TILE_CELLS / 64];
            for (within, &level) in tile.chosen.iter().enumerate().filter(|(_, level)| **level != NOT_REACHED) {
                bits[within / 64] |= 1 << (within % 64);
                if level > 0 {
                    choice.higher.insert(tile.index.cell(within), usize::from(level));
                }
            }
            choice.reached.insert(tile.index, bits);
        }
        choice
    }
}

#[cfg(test)]
#[path = "level_choice_tests.rs"]
mod tests;
