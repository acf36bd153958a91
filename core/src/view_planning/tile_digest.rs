//! A tile of the information map as planning sees it.

use super::relief::ReliefLimits;
use crate::information_map::{Level, MapConfig, TILE_CELLS, TILE_SIDE, Tile, TileIndex, TileLevels};

/// Cells along a side of a tile.
pub(super) const SIDE: usize = TILE_SIDE as usize;

/// What gain and cost need of the cells of a tile, each value for all cells in a row (rows of constant y), 10 kB. Values
/// of unknown cells mean nothing.
#[derive(Debug, Clone)]
pub(super) struct TileCells {
    /// Means of the products xx, xy, xz, yy, yz, zz of the normals' components (see `NormalStatistics::mean_moments`).
    pub moments: [[f32; TILE_CELLS]; 6],
    /// Mean height of everything seen [m, map frame].
    pub height: [f32; TILE_CELLS],
    /// Q_a (4.5).
    pub quality: [f32; TILE_CELLS],
    /// Mean height of the ground [m, map frame]; that of everything where there is no ground.
    pub ground: [f32; TILE_CELLS],
    /// C_nc (4.4).
    pub navigability: [f32; TILE_CELLS],
}

/// Bounds over the known cells of a tile, from which it is told that a view can improve none of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct TileBounds {
    pub least_quality: f32,
    /// Largest mean square of the normals' horizontal part, and of their vertical part.
    pub horizontal: f32,
    pub vertical: f32,
    pub lowest: f32,
    pub highest: f32,
}

/// A tile as planning sees it.
#[derive(Debug, Clone)]
pub(super) struct TileDigest {
    pub index: TileIndex,
    revision: u64,
    /// Where the map keeps the tile's evidence: tells the tiles of two maps apart.
    address: usize,
    /// Cells with several levels, in their order, and the level of each that is shown.
    several: Vec<(u8, u8)>,
    /// What the search for levels needs of the tile.
    pub levels: TileLevels,
    /// Bits by row of constant y.
    pub known: [u16; SIDE],
    /// Ground was seen there.
    pub grounded: [u16; SIDE],
    /// C_nc under the sight threshold.
    pub blocks: [u16; SIDE],
    /// C_nc over the navigable threshold.
    pub navigable: [u16; SIDE],
    /// Navigable cells whose own ground does not lie at one height.
    pub uneven: [u16; SIDE],
    pub bounds: TileBounds,
    pub cells: Box<TileCells>,
}

/// The settings a digest depends on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rules {
    pub sight: f64,
    pub navigable: f64,
    pub map: MapConfig,
    pub relief: ReliefLimits,
}

impl TileDigest {
    pub fn empty(index: TileIndex) -> Self {
        let none = [0.0; TILE_CELLS];
        let cells = TileCells { moments: [none; 6], height: none, quality: none, ground: none, navigability: none };
        Self {
            index,
            revision: 0,
            address: 0,
            several: Vec::new(),
            levels: TileLevels::default(),
            known: [0; SIDE],
            grounded: [0; SIDE],
            blocks: [0; SIDE],
            navigable: [0; SIDE],
            uneven: [0; SIDE],
            bounds: TileBounds::NONE,
            cells: Box::new(cells),
        }
    }

    /// Whether it is of the tile as it is.
    pub fn is_of(&self, tile: &Tile) -> bool {
        self.revision == tile.revision() && self.address == tile.address()
    }

    /// Reads the tile. Of cells with several levels those are shown that were before, until a search says better.
    pub fn read(&mut self, tile: &Tile, rules: &Rules) {
        let before = std::mem::take(&mut self.several);
        let shown =
            |within| before.binary_search_by_key(&within, |&(cell, _)| cell).map_or(0, |at| before[at].1.into());
        self.read_showing(tile, rules, shown);
    }

    /// Reads the tile, and shows the level that `choose` says of every cell with several.
    pub fn read_showing(&mut self, tile: &Tile, rules: &Rules, choose: impl Fn(u8) -> usize) {
        (self.revision, self.address) = (tile.revision(), tile.address());
        (self.known, self.grounded) = Default::default();
        (self.blocks, self.navigable, self.uneven) = Default::default();
        self.bounds = TileBounds::NONE;
        self.levels.clear();
        self.several.clear();
        for (index, cell) in tile.known_cells() {
            let within = index.within_tile();
            if let Some(level) = cell.undivided(rules.map.clearance_m) {
                self.levels.put(within, std::slice::from_ref(&level), &rules.map, rules.navigable);
                self.show(within, &level, rules);
                continue;
            }
            let levels = cell.levels(rules.map.clearance_m);
            let levels = levels.as_slice();
            self.levels.put(within, levels, &rules.map, rules.navigable);
            let mut shown = 0;
            if levels.len() > 1 {
                shown = Some(choose(within as u8)).filter(|&level| level < levels.len()).unwrap_or(0);
                self.several.push((within as u8, shown as u8));
            }
            if let Some(level) = levels.get(shown) {
                self.show(within, level, rules);
            }
        }
    }

    /// Whether another level is chosen for one of its cells than the one that is shown.
    pub fn differs_from(&self, choose: impl Fn(u8) -> usize) -> bool {
        self.several.iter().any(|&(within, shown)| choose(within) != usize::from(shown))
    }

    fn show(&mut self, within: usize, level: &Level, rules: &Rules) {
        self.read_level(within, level, rules);
        if level.highest - level.lowest > f64::from(rules.relief.diagonal) {
            self.uneven[within / SIDE] |= self.navigable[within / SIDE] & 1 << (within % SIDE);
        }
    }

    fn read_level(&mut self, within: usize, level: &Level, rules: &Rules) {
        let evidence = &level.evidence;
        let Some(navigability) = evidence.navigability(rules.map.obstacle_weight) else { return };
        let (row, bit) = (within / SIDE, 1u16 << (within % SIDE));
        self.known[row] |= bit;
        if evidence.has_ground() {
            self.grounded[row] |= bit;
        }
        if navigability < rules.sight {
            self.blocks[row] |= bit;
        }
        if navigability > rules.navigable {
            self.navigable[row] |= bit;
        }
        let cells = &mut *self.cells;
        let height = evidence.height().unwrap_or(0.0);
        let moments = evidence.mean_moments();
        for (column, moment) in cells.moments.iter_mut().zip(moments) {
            column[within] = moment;
        }
        cells.height[within] = height as f32;
        cells.quality[within] = evidence.quality().unwrap_or(0.0) as f32;
        cells.ground[within] = level.ground_height.unwrap_or(height) as f32;
        cells.navigability[within] = navigability as f32;
        self.bounds.include(&moments, cells.height[within], cells.quality[within]);
    }
}

impl TileBounds {
    const NONE: Self = Self {
        least_quality: f32::INFINITY,
        horizontal: 0.0,
        vertical: 0.0,
        lowest: f32::INFINITY,
        highest: f32::NEG_INFINITY,
    };

    fn include(&mut self, moments: &[f32; 6], height: f32, quality: f32) {
        let [xx, _, _, yy, _, zz] = *moments;
        self.least_quality = self.least_quality.min(quality);
        self.horizontal = self.horizontal.max(xx + yy);
        self.vertical = self.vertical.max(zz);
        self.lowest = self.lowest.min(height);
        self.highest = self.highest.max(height);
    }
}
