//! Which level of a cell is the one the robot would be on?

use super::cell::{Level, Levels};
use super::index::{CellIndex, TileIndex};
use super::level_search::{CellBits, LevelSearch, TileLevels};
use super::map::InformationMap;
use super::tile::Tile;
use nalgebra::Point3;
use std::collections::BTreeMap;

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
    reached: BTreeMap<TileIndex, CellBits>,
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
        let Some(here) = self.cell_containing(reach.robot.x, reach.robot.y) else { return LevelChoice::default() };
        let Some((first, last)) = self.tile_bounds() else { return LevelChoice::default() };
        let window = (reach.window_m / self.config.cell_m).clamp(0.0, 1e5).ceil() as i32;
        let corner = |sign: i32| {
            CellIndex { x: here.x.saturating_add(sign * window), y: here.y.saturating_add(sign * window) }.tile()
        };
        let (low, high) = (corner(-1), corner(1));
        let low = TileIndex { x: low.x.max(first.x), y: low.y.max(first.y) };
        let high = TileIndex { x: high.x.min(last.x), y: high.y.min(last.y) };
        self.choose_levels_between(low, high, reach)
    }

    /// The same in a rectangle of tiles, both ends included.
    pub(crate) fn choose_levels_between(&self, low: TileIndex, high: TileIndex, reach: &Reach) -> LevelChoice {
        let (cols, rows) = ((high.x - low.x + 1).max(0) as usize, (high.y - low.y + 1).max(0) as usize);
        let place = |tile: TileIndex| (tile.y - low.y) as usize * cols + (tile.x - low.x) as usize;
        let mut read: Vec<Option<TileLevels>> = Vec::new();
        read.resize_with(cols * rows, || None);
        let tiles: Vec<&Tile> = self.tiles_between(low, high).collect();
        for tile in &tiles {
            read[place(tile.index())] = Some(TileLevels::of(tile, &self.config, reach.navigable_threshold));
        }
        let levels: Vec<_> = read.iter().map(Option::as_ref).collect();
        let mut search = LevelSearch::default();
        search.run(&levels, low.cell(0), cols, reach, self.config.cell_m);
        let mut choice = LevelChoice::default();
        for tile in tiles {
            choice.reached.insert(tile.index(), search.reached_cells(&levels, place(tile.index())));
        }
        for &(place, within, level) in search.higher() {
            let (x, y) = (place as usize % cols, place as usize / cols);
            let tile = TileIndex { x: low.x + x as i32, y: low.y + y as i32 };
            choice.higher.insert(tile.cell(within.into()), level.into());
        }
        choice
    }
}

#[cfg(test)]
#[path = "level_choice_tests.rs"]
mod tests;
