//! The map itself: tiles by their place, a revision counted up with every scan, and the zones of interest.

use super::cell::Cell;
use super::config::{MapConfig, MapConfigError};
use super::index::{CellIndex, TileIndex};
use super::insert::InsertBuffers;
use super::navigability::CellState;
use super::tile::Tile;
use super::zones::{Zone, ZoneConfig, ZoneList, ZoneUpdate};
use nalgebra::Point3;
use std::collections::BTreeMap;

/// The information map: sparse tiles of cells in the map frame (z up), growing in every direction.
#[derive(Debug, Clone)]
pub struct InformationMap {
    pub(super) config: MapConfig,
    pub(super) revision: u64,
    /// In order of creation; `slots` gives the fixed order of iteration.
    pub(super) tiles: Vec<Tile>,
    pub(super) slots: BTreeMap<TileIndex, usize>,
    pub(super) zones: ZoneList,
    pub(super) buffers: InsertBuffers,
}

impl InformationMap {
    /// An empty map.
    ///
    /// # Errors
    /// The settings are checked by [`MapConfig::validate`].
    pub fn new(config: MapConfig) -> Result<Self, MapConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            revision: 0,
            tiles: Vec::new(),
            slots: BTreeMap::new(),
            zones: ZoneList::default(),
            buffers: InsertBuffers::default(),
        })
    }

    /// The settings the map was made with.
    #[must_use]
    pub fn config(&self) -> &MapConfig {
        &self.config
    }

    /// Side of a cell [m].
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.config.cell_m
    }

    /// Counted up by one for every scan inserted and every update of the zones; 0 for an empty map.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The cell at `index`, or `None` where no tile is; a cell of an existing tile may still be unknown.
    #[must_use]
    pub fn cell(&self, index: CellIndex) -> Option<&Cell> {
        let slot = *self.slots.get(&index.tile())?;
        self.tiles.get(slot)?.cells.get(index.within_tile())
    }

    /// The state of the cell at `index`.
    #[must_use]
    pub fn state(&self, index: CellIndex) -> CellState {
        self.cell(index).map_or(CellState::Unknown, |cell| cell.state(self.config.obstacle_weight))
    }

    /// The cell that contains the position (x, y) of the map frame [m], or `None` when it is not finite or too far.
    #[must_use]
    pub fn cell_containing(&self, x: f64, y: f64) -> Option<CellIndex> {
        CellIndex::containing(x / self.config.cell_m, y / self.config.cell_m)
    }

    /// The centre of a cell in the map frame [m].
    #[must_use]
    pub fn centre_of(&self, index: CellIndex) -> [f64; 2] {
        [index.x, index.y].map(|i| (f64::from(i) + 0.5) * self.config.cell_m)
    }

    /// All tiles, ordered by their place.
    pub fn tiles(&self) -> impl Iterator<Item = &Tile> + '_ {
        self.slots.values().filter_map(|&slot| self.tiles.get(slot))
    }

    /// The tiles that changed after `revision`, ordered by their place.
    pub fn tiles_changed_since(&self, revision: u64) -> impl Iterator<Item = &Tile> + '_ {
        self.tiles().filter(move |tile| tile.revision > revision)
    }

    /// The known cells with their places, in a fixed order.
    pub fn known_cells(&self) -> impl Iterator<Item = (CellIndex, &Cell)> + '_ {
        self.tiles().flat_map(Tile::known_cells)
    }

    /// The smallest and largest tile coordinates in use, or `None` for an empty map.
    #[must_use]
    pub fn tile_bounds(&self) -> Option<(TileIndex, TileIndex)> {
        let mut indices = self.slots.keys();
        let first = *indices.next()?;
        Some(indices.fold((first, first), |(low, high), tile| {
            (
                TileIndex { x: low.x.min(tile.x), y: low.y.min(tile.y) },
                TileIndex { x: high.x.max(tile.x), y: high.y.max(tile.y) },
            )
        }))
    }

    /// The zones of interest not yet seen face on.
    #[must_use]
    pub fn zones(&self) -> &[Zone] {
        self.zones.as_slice()
    }

    /// Takes in what a scan says of the zones of interest: those it saw face on are removed, then its own are merged.
    /// Call it after [`InformationMap::insert`] of the same scan. `seen` and `scanner` are in the map frame.
    pub fn update_zones(&mut self, seen: &[Zone], scanner: &Point3<f64>, config: &ZoneConfig) -> ZoneUpdate {
        let mut zones = std::mem::take(&mut self.zones);
        let retired = zones.retire(|zone| zone.is_seen_face_on(self, scanner, config));
        let (merged, added) = zones.merge(seen, config);
        self.zones = zones;
        if retired + merged + added > 0 {
            self.revision += 1;
        }
        ZoneUpdate { retired, merged, added }
    }
}

/// Maps are equal when they say the same, whatever the order in which their tiles were made.
impl PartialEq for InformationMap {
    fn eq(&self, other: &Self) -> bool {
        self.config == other.config
            && self.revision == other.revision
            && self.zones == other.zones
            && self.slots.len() == other.slots.len()
            && self
                .tiles()
                .zip(other.tiles())
                .all(|(a, b)| a.index == b.index && a.revision == b.revision && a.cells == b.cells)
    }
}
