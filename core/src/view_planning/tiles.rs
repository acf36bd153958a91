//! What planning reads from the information map, tile by tile, kept from plan to plan: a plan reads only the tiles that
//! changed. This file and [`super::grid`] are the only ones that know the map's cells.

use super::config::PlanningConfig;
use super::relief::ReliefLimits;
use super::tile_digest::{Rules, TileCells, TileDigest};
use crate::information_map::{InformationMap, LevelSearch, Reach, Tile, TileIndex};
use crate::threads;
use nalgebra::Point3;
use std::collections::HashMap;

/// The digests of the tiles near the robot.
#[derive(Debug, Default)]
pub(super) struct TileCache {
    rules: Rules,
    digests: Vec<TileDigest>,
    slots: HashMap<TileIndex, usize>,
    /// The map's revision when the cache last looked.
    revision: u64,
    /// For what the levels of cells were chosen last.
    chosen_for: Option<(u64, Reach, TileWindow)>,
    search: LevelSearch,
}

/// A rectangle of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct TileWindow {
    pub low: [i32; 2],
    pub cols: usize,
    pub rows: usize,
}

impl TileWindow {
    /// Its tile of the smallest coordinates.
    fn low(&self) -> TileIndex {
        TileIndex { x: self.low[0], y: self.low[1] }
    }

    /// Its tile of the largest coordinates.
    fn high(&self) -> TileIndex {
        let [x, y] = self.low;
        TileIndex { x: x + self.cols as i32 - 1, y: y + self.rows as i32 - 1 }
    }

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
            map: *map.config(),
            relief: ReliefLimits::new(config, map.cell_m()),
        };
        // A map that is older than it was is another map.
        if rules != self.rules || map.revision() < self.revision {
            *self = Self { rules, ..Self::default() };
        }
        self.revision = map.revision();
        self.forget_far_ones(window);
        let before = std::mem::replace(table, vec![u32::MAX; window.cols * window.rows]);
        let mut stale: Vec<Option<&Tile>> = vec![None; self.digests.len()];
        for tile in map.tiles_between(window.low(), window.high()) {
            let Some(place) = window.place(tile.index()) else { continue };
            let slot = *self.slots.entry(tile.index()).or_insert_with(|| {
                self.digests.push(TileDigest::empty(tile.index()));
                stale.push(None);
                self.digests.len() - 1
            });
            table[place] = slot as u32;
            if !self.digests[slot].is_of(tile) {
                stale[slot] = Some(tile);
            }
        }
        let jobs: Vec<_> =
            self.digests.iter_mut().zip(&stale).filter_map(|(digest, tile)| tile.map(|tile| (digest, tile))).collect();
        // Tiles that are gone belong to a map that is gone.
        let has_news = !jobs.is_empty();
        threads::for_each(jobs.into_iter(), threads, |(digest, tile)| digest.read(tile, &rules));
        let reach = Reach {
            robot: *robot,
            window_m: f64::INFINITY,
            start_m: config.start_clearance_m,
            max_step_m: ReliefLimits::between_levels(config, map.cell_m()),
            navigable_threshold: rules.navigable,
        };
        let levels_changed = self.choose_levels(map, window, &reach, has_news, table);
        has_news || *table != before || levels_changed
    }

    /// Shows the levels that the robot gets to; whether others are shown than before. The search is only needed where cells
    /// have several levels.
    fn choose_levels(
        &mut self,
        map: &InformationMap,
        window: &TileWindow,
        reach: &Reach,
        has_news: bool,
        table: &[u32],
    ) -> bool {
        let key = (map.revision(), *reach, *window);
        if !has_news && self.chosen_for == Some(key) {
            return false;
        }
        self.chosen_for = Some(key);
        let mut search = std::mem::take(&mut self.search);
        let levels: Vec<_> = table.iter().map(|&slot| self.digest(slot).map(|digest| &digest.levels)).collect();
        if !levels.iter().flatten().any(|levels| levels.has_several()) {
            return false;
        }
        search.run(&levels, window.low().cell(0), window.cols, reach, map.cell_m());
        let mut has_changed = false;
        for (place, &slot) in table.iter().enumerate() {
            let Some(digest) = self.digests.get_mut(slot as usize) else { continue };
            let choose = |within| search.level_of(place, within);
            if digest.differs_from(choose)
                && let Some(tile) = map.tile(digest.index)
            {
                digest.read_showing(tile, &self.rules, choose);
                has_changed = true;
            }
        }
        self.search = search;
        has_changed
    }

    pub fn digest(&self, slot: u32) -> Option<&TileDigest> {
        self.digests.get(slot as usize)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let upper: usize = self.digests.iter().map(|digest| digest.levels.bytes()).sum();
        self.digests.len() * (size_of::<TileDigest>() + size_of::<TileCells>()) + upper
    }

    fn forget_far_ones(&mut self, window: &TileWindow) {
        if self.digests.len() <= window.cols * window.rows + Self::SPARE {
            return;
        }
        self.digests.retain(|digest| window.place(digest.index).is_some());
        self.slots = self.digests.iter().enumerate().map(|(slot, digest)| (digest.index, slot)).collect();
    }
}

#[cfg(test)]
#[path = "tiles_tests.rs"]
mod tests;
