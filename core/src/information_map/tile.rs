//! A square of 16 x 16 cells: the unit in which the map grows, is iterated and reports change.

use super::cell::Cell;
use super::index::{CellIndex, TileIndex};

/// Cells along one side of a tile.
pub const TILE_SIDE: i32 = 16;

/// Cells of a tile.
pub const TILE_CELLS: usize = (TILE_SIDE * TILE_SIDE) as usize;

/// 16 x 16 cells, about 39 kB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    pub(super) index: TileIndex,
    pub(super) revision: u64,
    pub(super) cells: Box<[Cell; TILE_CELLS]>,
    /// One bit a cell: touched by the insert that made `revision`. Only valid during that insert.
    pub(super) touched: [u64; TILE_CELLS / 64],
}

impl Tile {
    pub(super) fn new(index: TileIndex) -> Self {
        Self { index, revision: 0, cells: Box::new([Cell::default(); TILE_CELLS]), touched: [0; TILE_CELLS / 64] }
    }

    /// Where the tile is.
    #[must_use]
    pub fn index(&self) -> TileIndex {
        self.index
    }

    /// The map's revision at which the tile last changed.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The known cells with their places, in a fixed order (rows of constant y, x running fastest).
    pub fn known_cells(&self) -> impl Iterator<Item = (CellIndex, &Cell)> + '_ {
        self.cells
            .iter()
            .enumerate()
            .filter(|(_, cell)| !cell.is_unknown())
            .map(|(within, cell)| (self.index.cell(within), cell))
    }
}
