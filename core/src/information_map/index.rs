//! Where a cell is: integer coordinates of cells and tiles in the map frame.

use super::tile::TILE_SIDE;
use serde::{Deserialize, Serialize};

/// The largest cell coordinate in either direction. At 0.3 m a cell this is some 2,500 km from the origin, far beyond
/// any aligned scan, and small enough that sums of two coordinates never overflow.
pub(super) const LARGEST_COORDINATE: i32 = 1 << 23;

/// A cell of the map: it covers `[x, x + 1) * cell_m` by `[y, y + 1) * cell_m` of the map frame. Ordered by x, then y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct CellIndex {
    /// Along the map's x axis.
    pub x: i32,
    /// Along the map's y axis.
    pub y: i32,
}

/// A tile of 16 x 16 cells: it holds the cells `16 x .. 16 x + 15` by `16 y .. 16 y + 15`. Ordered by x, then y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TileIndex {
    /// Along the map's x axis.
    pub x: i32,
    /// Along the map's y axis.
    pub y: i32,
}

impl CellIndex {
    /// The cell that contains a position given in cell units (metres / `cell_m`), or `None` when it is not finite or
    /// too far away to be a cell.
    #[must_use]
    #[inline]
    pub fn containing(x: f64, y: f64) -> Option<Self> {
        let limit = f64::from(LARGEST_COORDINATE);
        (x.abs() < limit && y.abs() < limit).then(|| Self { x: floor(x), y: floor(y) })
    }

    /// The tile this cell belongs to.
    #[must_use]
    #[inline]
    pub fn tile(self) -> TileIndex {
        TileIndex { x: self.x.div_euclid(TILE_SIDE), y: self.y.div_euclid(TILE_SIDE) }
    }

    /// This cell's place among the 256 of its tile: rows of constant y, x running fastest.
    #[must_use]
    #[inline]
    pub fn within_tile(self) -> usize {
        (self.y.rem_euclid(TILE_SIDE) * TILE_SIDE + self.x.rem_euclid(TILE_SIDE)) as usize
    }
}

/// The largest integer not above `value`, for values that fit; several times faster than `f64::floor`, which is a
/// function call on machines without SSE 4.1.
#[inline(always)]
pub(super) fn floor(value: f64) -> i32 {
    let towards_zero = value as i32;
    towards_zero - i32::from(f64::from(towards_zero) > value)
}

impl TileIndex {
    /// The cell at a place (0..256) of this tile.
    #[must_use]
    pub fn cell(self, within: usize) -> CellIndex {
        let within = within as i32;
        CellIndex {
            x: self.x * TILE_SIDE + within.rem_euclid(TILE_SIDE),
            y: self.y * TILE_SIDE + within.div_euclid(TILE_SIDE),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_cell_is_found_again_in_its_tile(x in -100_000..100_000i32, y in -100_000..100_000i32) {
            let cell = CellIndex { x, y };
            prop_assert!(cell.within_tile() < 256);
            prop_assert_eq!(cell.tile().cell(cell.within_tile()), cell);
        }
    }

    proptest! {
        #[test]
        fn the_fast_floor_is_the_floor(value in -1e9..1e9f64, whole in any::<i16>()) {
            prop_assert_eq!(f64::from(floor(value)), value.floor());
            prop_assert_eq!(floor(f64::from(whole)), i32::from(whole));
        }
    }

    #[test]
    fn positions_that_are_not_on_earth_have_no_cell() {
        assert_eq!(CellIndex::containing(-0.1, 0.1), Some(CellIndex { x: -1, y: 0 }));
        assert_eq!(CellIndex::containing(f64::NAN, 0.0), None);
        assert_eq!(CellIndex::containing(0.0, f64::INFINITY), None);
        assert_eq!(CellIndex::containing(1e9, 0.0), None);
    }
}
