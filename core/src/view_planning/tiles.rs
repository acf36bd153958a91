//! What planning reads from the information map, tile by tile, kept from plan to plan: a plan reads only the tiles that
//! changed. This file and [`super::grid`] are the only ones that know the map's cells.

use super::config::PlanningConfig;
use crate::information_map::{Evidence, InformationMap, LevelChoice, Reach, TILE_CELLS, TILE_SIDE, Tile, TileIndex};
use crate::threads;
use nalgebra::Point3;
use std::collections::HashMap;

/// Neighbouring levels whose ground differs by more than this are not of the same way [m].
const MAX_STEP_M: f64 = 0.5;

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
    index: TileIndex,
    revision: u64,
    /// Where the map keeps the tile's evidence: tells the tiles of two maps apart.
    address: usize,
    /// Cells with several levels, and the level of each that is shown.
    several: Vec<(u8, u8)>,
    /// Bits by row of constant y.
    pub known: [u16; SIDE],
    /// C_nc under the sight threshold.
    pub blocks: [u16; SIDE],
    /// C_nc over the navigable threshold.
    pub navigable: [u16; SIDE],
    pub bounds: TileBounds,
    pub cells: Box<TileCells>,
}

/// The settings a digest depends on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Rules {
    sight: f64,
    navigable: f64,
    obstacle_weight: f64,
    clearance_m: f64,
    start_m: f64,
    cell_m: f64,
}

/// The digests of the tiles near the robot.
#[derive(Debug, Default)]
pub(super) struct TileCache {
    rules: Rules,
    digests: Vec<TileDigest>,
    slots: HashMap<TileIndex, usize>,
    /// The map's revision when the cache last looked.
    revision: u64,
    /// For what the levels of cells were chosen last.
    chosen_for: Option<(u64, [f64; 3], TileWindow)>,
}

/// A rectangle of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct TileWindow {
    pub low: [i32; 2],
    pub cols: usize,
    pub rows: usize,
}

impl TileWindow {
    /// The place of a tile in the window, row by row.
    pub fn place(&self, tile: TileIndex) -> Option<usize> {
        let (x, y) = (i64::from(tile.x) - i64::from(self.low[0]), i64::from(tile.y) - i64::from(self.low[1]));
        let inside = (0..self.cols as i64).contains(&x) && (0..self.rows as i64).contains(&y);
        inside.then(|| y as usize * self.cols + x as usize)
    }
}

impl TileCache {
    /// Digests kept beyond those of the window; more are let go.
    const SPARE: usize = 1024;

    /// Brings the digests of the window up to date, writes where they are into `table` (one entry a tile of the window,
    /// `u32::MAX` where the map has none), and returns whether any has changed since the last call. Of a cell with several
    /// levels the one is shown that the robot gets to.
    pub fn update(
        &mut self,
        map: &InformationMap,
        window: &TileWindow,
        robot: &Point3<f64>,
        config: &PlanningConfig,
        threads: usize,
        table: &mut Vec<u32>,
    ) -> bool {
        let rules = Rules {
            sight: config.sight_threshold,
            navigable: config.navigable_threshold,
            obstacle_weight: map.config().obstacle_weight,
            clearance_m: map.config().clearance_m,
            start_m: config.start_clearance_m,
            cell_m: map.cell_m(),
        };
        // A map that is older than it was is another map.
        if rules != self.rules || map.revision() < self.revision {
            *self = Self { rules, ..Self::default() };
        }
        self.revision = map.revision();
        self.forget_far_ones(window);
        let before = std::mem::replace(table, vec![u32::MAX; window.cols * window.rows]);
        let mut stale: Vec<Option<&Tile>> = vec![None; self.digests.len()];
        for tile in map.tiles() {
            let Some(place) = window.place(tile.index()) else { continue };
            let address = tile.address();
            let slot = *self.slots.entry(tile.index()).or_insert_with(|| {
                self.digests.push(TileDigest::empty(tile.index()));
                stale.push(None);
                self.digests.len() - 1
            });
            table[place] = slot as u32;
            let digest = &self.digests[slot];
            if digest.revision != tile.revision() || digest.address != address {
                stale[slot] = Some(tile);
            }
        }
        let jobs: Vec<_> =
            self.digests.iter_mut().zip(&stale).filter_map(|(digest, tile)| tile.map(|tile| (digest, tile))).collect();
        // Tiles that are gone belong to a map that is gone.
        let has_news = !jobs.is_empty();
        threads::for_each(jobs.into_iter(), threads, |(digest, tile)| {
            digest.read(tile, &rules, &LevelChoice::default())
        });
        let levels_changed = self.choose_levels(map, window, robot, has_news);
        has_news || *table != before || levels_changed
    }

    /// Shows the levels that the robot gets to; whether others are shown than before. A search that is only needed where
    /// cells have several levels.
    fn choose_levels(
        &mut self,
        map: &InformationMap,
        window: &TileWindow,
        robot: &Point3<f64>,
        has_news: bool,
    ) -> bool {
        let key = (map.revision(), [robot.x, robot.y, robot.z], *window);
        if !has_news && self.chosen_for == Some(key) {
            return false;
        }
        self.chosen_for = Some(key);
        let is_in = |digest: &TileDigest| window.place(digest.index).is_some() && !digest.several.is_empty();
        if !self.digests.iter().any(is_in) {
            return false;
        }
        let side = f64::from(TILE_SIDE) * self.rules.cell_m;
        let choice = map.choose_levels(&Reach {
            robot: *robot,
            window_m: window.cols.max(window.rows) as f64 * side,
            start_m: self.rules.start_m,
            max_step_m: MAX_STEP_M,
            navigable_threshold: self.rules.navigable,
        });
        let mut has_changed = false;
        for tile in map.tiles() {
            let Some(&slot) = self.slots.get(&tile.index()) else { continue };
            let digest = &mut self.digests[slot];
            if window.place(digest.index).is_some() && digest.differs_from(&choice) {
                digest.read(tile, &self.rules, &choice);
                has_changed = true;
            }
        }
        has_changed
    }

    pub fn digest(&self, slot: u32) -> Option<&TileDigest> {
        self.digests.get(slot as usize)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.digests.len() * (size_of::<TileDigest>() + size_of::<TileCells>())
    }

    fn forget_far_ones(&mut self, window: &TileWindow) {
        if self.digests.len() <= window.cols * window.rows + Self::SPARE {
            return;
        }
        self.digests.retain(|digest| window.place(digest.index).is_some());
        self.slots = self.digests.iter().enumerate().map(|(slot, digest)| (digest.index, slot)).collect();
    }
}

impl TileDigest {
    fn empty(index: TileIndex) -> Self {
        let none = [0.0; TILE_CELLS];
        let cells = TileCells { moments: [none; 6], height: none, quality: none, ground: none, navigability: none };
        Self {
            index,
            revision: 0,
            address: 0,
            several: Vec::new(),
            known: [0; SIDE],
            blocks: [0; SIDE],
            navigable: [0; SIDE],
            bounds: TileBounds::NONE,
            cells: Box::new(cells),
        }
    }

    fn read(&mut self, tile: &Tile, rules: &Rules, choice: &LevelChoice) {
        (self.revision, self.address) = (tile.revision(), tile.address());
        (self.known, self.blocks, self.navigable) = ([0; SIDE], [0; SIDE], [0; SIDE]);
        self.bounds = TileBounds::NONE;
        self.several.clear();
        for (index, cell) in tile.known_cells() {
            if let Some(level) = cell.undivided(rules.clearance_m) {
                self.read_evidence(index.within_tile(), &level.evidence, rules);
                continue;
            }
            let levels = cell.levels(rules.clearance_m);
            if levels.as_slice().len() > 1 {
                self.several.push((index.within_tile() as u8, choice.of(index) as u8));
            }
            if let Some(level) = choice.pick(index, &levels) {
                self.read_evidence(index.within_tile(), &level.evidence, rules);
            }
        }
    }

    /// Whether another level is chosen for one of its cells than the one that is shown.
    fn differs_from(&self, choice: &LevelChoice) -> bool {
        self.several.iter().any(|&(within, shown)| choice.of(self.index.cell(within.into())) != usize::from(shown))
    }

    fn read_evidence(&mut self, within: usize, evidence: &Evidence, rules: &Rules) {
        let Some(navigability) = evidence.navigability(rules.obstacle_weight) else { return };
        let (row, bit) = (within / SIDE, 1u16 << (within % SIDE));
        self.known[row] |= bit;
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
        cells.ground[within] = evidence.ground_height().unwrap_or(height) as f32;
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
