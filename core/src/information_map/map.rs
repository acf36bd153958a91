//! The map itself: tiles by their place, a revision counted up with every change, and the zones of interest.

use super::cell::{Cell, Level};
use super::condense::{CondenseSummary, Condenser, InsertError, check_pose};
use super::config::{MapConfig, MapConfigError};
use super::evidence::Change;
use super::index::{CellIndex, TileIndex};
use super::navigability::CellState;
use super::obstructions::Obstruction;
use super::projection::{Projection, Sorter};
use super::scan_evidence::ScanEvidence;
use super::tile::Tile;
use super::zones::{Zone, ZoneConfig, ZoneList, ZoneUpdate};
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::scan::ScanView;
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
    known: usize,
    pub(super) zones: ZoneList,
    obstructions: Vec<Obstruction>,
    driven: Vec<[[f64; 2]; 2]>,
    pub(super) sorter: Sorter,
    pub(super) threads: usize,
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
            known: 0,
            zones: ZoneList::default(),
            obstructions: Vec::new(),
            driven: Vec::new(),
            sorter: Sorter::default(),
            threads: 1,
        })
    }

    /// Sets how many threads [`InformationMap::add`] and [`InformationMap::move_scan`] work on, 1 in a new map. What
    /// the map says does not depend on it.
    pub fn set_threads(&mut self, threads: usize) {
        self.threads = threads.max(1);
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

    /// Counted up by one for every scan added, moved or taken away, every update of the zones, every obstruction and every way
    /// driven; 0 for an empty map.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Goes on counting from a revision that an earlier map had reached; tiles made so far count as of that revision.
    pub fn resume_revision(&mut self, revision: u64) {
        self.revision = self.revision.max(revision);
        let now = self.revision;
        self.tiles.iter_mut().for_each(|tile| tile.revision = now);
    }

    /// Condenses one aligned, scored scan and adds it: [`Condenser::condense`] and [`InformationMap::add`] in one, for
    /// maps that no correction will move.
    ///
    /// # Errors
    /// See [`InsertError`]; the map is then unchanged.
    pub fn insert(
        &mut self,
        scan: ScanView<'_>,
        scores: &[PointScore],
        map_from_scanner: &Pose,
    ) -> Result<CondenseSummary, InsertError> {
        let mut condenser = Condenser::new();
        let (evidence, summary) = condenser.condense(scan, scores, map_from_scanner, &self.config, 1)?;
        self.add(evidence, map_from_scanner)?;
        Ok(summary)
    }

    /// Adds what a scan says when it stands at `map_from_scanner`. Returns how many tiles changed.
    ///
    /// The sums are integers: the same scans in another order give the same cells, bit for bit.
    ///
    /// # Errors
    /// See [`InsertError`]; the map is then unchanged.
    pub fn add(&mut self, evidence: &ScanEvidence, map_from_scanner: &Pose) -> Result<usize, InsertError> {
        self.check(evidence, map_from_scanner)?;
        self.revision += 1;
        let mut projection = self.projection();
        projection.change(Change::Add, evidence, map_from_scanner);
        Ok(projection.touched)
    }

    /// Moves a scan that was added at `from` to `to`: what it said is taken away exactly, then what it says now is
    /// added. The map afterwards is, bit for bit, the one made from scratch with the scan at `to`. Returns how many
    /// tiles changed. Moving what was never added at `from` makes the counts wrong; [`ScanPoses`](super::ScanPoses)
    /// knows where scans are.
    ///
    /// # Errors
    /// See [`InsertError`]; the map is then unchanged.
    pub fn move_scan(&mut self, evidence: &ScanEvidence, from: &Pose, to: &Pose) -> Result<usize, InsertError> {
        self.check(evidence, from)?;
        self.check(evidence, to)?;
        self.revision += 1;
        let mut projection = self.projection();
        projection.change(Change::Remove, evidence, from);
        projection.change(Change::Add, evidence, to);
        let touched = projection.touched;
        let now = self.revision;
        self.tiles.iter_mut().filter(|tile| tile.revision == now).for_each(Tile::tidy);
        Ok(touched)
    }

    fn projection(&mut self) -> Projection<'_> {
        Projection {
            tiles: &mut self.tiles,
            slots: &mut self.slots,
            known: &mut self.known,
            sorter: &mut self.sorter,
            revision: self.revision,
            threads: self.threads,
            touched: 0,
        }
    }

    fn check(&self, evidence: &ScanEvidence, map_from_scanner: &Pose) -> Result<(), InsertError> {
        let (found, expected) = (evidence.cell_m, self.config.cell_m);
        if found != expected {
            return Err(InsertError::CellMismatch { found, expected });
        }
        check_pose(map_from_scanner, &self.config)
    }

    /// The cell at `index`, or `None` where no tile is; a cell of an existing tile may still be unknown.
    #[must_use]
    pub fn cell(&self, index: CellIndex) -> Option<Cell<'_>> {
        let slot = *self.slots.get(&index.tile())?;
        Some(self.tiles.get(slot)?.cell(index.within_tile()))
    }

    /// The lowest level of the cell at `index`; `None` when it is unknown.
    #[must_use]
    pub fn lowest_level(&self, index: CellIndex) -> Option<Level> {
        self.cell(index)?.lowest_level(self.config.clearance_m)
    }

    /// The state of the lowest level of the cell at `index`.
    #[must_use]
    pub fn state(&self, index: CellIndex) -> CellState {
        self.lowest_level(index).map_or(CellState::Unknown, |level| level.state(self.config.obstacle_weight))
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

    /// The number of tiles.
    #[must_use]
    pub fn tile_count(&self) -> usize {
        self.slots.len()
    }

    /// The tile at `index`, if there is one.
    pub(crate) fn tile(&self, index: TileIndex) -> Option<&Tile> {
        self.tiles.get(*self.slots.get(&index)?)
    }

    /// The tiles of a rectangle, both ends included, ordered by their place: as quick on a large map as on a small one.
    pub(crate) fn tiles_between(&self, low: TileIndex, high: TileIndex) -> impl Iterator<Item = &Tile> + '_ {
        let columns = (low.x..=high.x).filter(move |_| low.y <= high.y);
        let column = move |x| self.slots.range(TileIndex { x, y: low.y }..=TileIndex { x, y: high.y });
        columns.flat_map(column).filter_map(|(_, &slot)| self.tiles.get(slot))
    }

    /// The tiles that changed after `revision`, ordered by their place.
    pub fn tiles_changed_since(&self, revision: u64) -> impl Iterator<Item = &Tile> + '_ {
        self.tiles().filter(move |tile| tile.revision > revision)
    }

    /// The known cells with their places, in a fixed order.
    pub fn known_cells(&self) -> impl Iterator<Item = (CellIndex, Cell<'_>)> + '_ {
        self.tiles().flat_map(Tile::known_cells)
    }

    /// How many cells are known; counted while scans are added and moved.
    #[must_use]
    pub fn known_count(&self) -> usize {
        self.known
    }

    /// Memory the map takes [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.tiles.iter().map(Tile::bytes).sum()
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

    /// Notes where something held the robot. Returns whether that is new; what cannot be an obstruction is not noted.
    pub fn obstruct(&mut self, obstruction: Obstruction) -> bool {
        let is_new = obstruction.is_usable() && !self.obstructions.contains(&obstruction);
        if is_new {
            self.obstructions.push(obstruction);
            self.revision += 1;
        }
        is_new
    }

    /// Where something held the robot, the oldest first.
    #[must_use]
    pub fn obstructions(&self) -> &[Obstruction] {
        &self.obstructions
    }

    /// Forgets what held the robot, so that it may try again. Returns whether there was anything.
    pub fn forget_obstructions(&mut self) -> bool {
        let is_any = !self.obstructions.is_empty();
        self.obstructions.clear();
        self.revision += u64::from(is_any);
        is_any
    }

    /// Notes a way that the robot has driven, by its bends [m, map frame]; of what is not finite nothing.
    pub fn drove(&mut self, way: &[[f64; 2]]) {
        let is_finite = |piece: &&[[f64; 2]]| piece.iter().flatten().all(|x| x.is_finite());
        let before = self.driven.len();
        self.driven.extend(way.windows(2).filter(is_finite).map(|piece| [piece[0], piece[1]]));
        self.revision += u64::from(self.driven.len() > before);
    }

    /// The pieces of the ways that the robot has driven, the oldest first: proof that these carry it, whatever the scans say.
    #[must_use]
    pub fn driven(&self) -> &[[[f64; 2]; 2]] {
        &self.driven
    }

    /// The zones of interest not yet seen face on.
    #[must_use]
    pub fn zones(&self) -> &[Zone] {
        self.zones.as_slice()
    }

    /// The zones with the scans they belong to, to be kept and given to [`InformationMap::restore_zones`].
    #[must_use]
    pub fn zone_list(&self) -> &ZoneList {
        &self.zones
    }

    /// Puts back zones that were kept.
    pub fn restore_zones(&mut self, zones: ZoneList) {
        self.zones = zones;
    }

    /// Takes in what scan `scan` says of the zones of interest: those it saw face on are removed, then its own are
    /// merged. Call it after the scan was added. `seen` and `map_from_scanner` are in the map frame.
    pub fn update_zones(
        &mut self,
        scan: u64,
        seen: &[Zone],
        map_from_scanner: &Pose,
        config: &ZoneConfig,
    ) -> ZoneUpdate {
        let scanner = Point3::from(map_from_scanner.translation.vector);
        let mut zones = std::mem::take(&mut self.zones);
        let retired = zones.retire(|zone| zone.is_seen_face_on(self, &scanner, config));
        let (merged, added) = zones.merge(scan, seen, map_from_scanner, config);
        self.zones = zones;
        if retired + merged + added > 0 {
            self.revision += 1;
        }
        ZoneUpdate { retired, merged, added }
    }

    /// Moves the zones of a scan along with it. Returns how many there are.
    pub fn move_zones(&mut self, scan: u64, map_from_scanner: &Pose) -> usize {
        self.zones.move_with(scan, map_from_scanner)
    }
}

/// Maps are equal when they say the same, however they came to it: whatever the order of scans, and whether these were
/// added where they are or moved there.
impl PartialEq for InformationMap {
    fn eq(&self, other: &Self) -> bool {
        let known = |map: &Self| map.tiles().filter(|tile| tile.known_cells().next().is_some()).count();
        self.config == other.config
            && self.zones == other.zones
            && self.obstructions == other.obstructions
            && self.driven == other.driven
            && known(self) == known(other)
            && self
                .tiles()
                .filter(|tile| tile.known_cells().next().is_some())
                .all(|tile| other.slots.get(&tile.index).is_some_and(|&slot| tile.says_the_same(&other.tiles[slot])))
    }
}

#[cfg(test)]
#[path = "map_tests.rs"]
mod tests;
