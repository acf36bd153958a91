//! A square of 16 x 16 cells: the unit in which the map grows, is iterated and reports change.

use super::cell::Cell;
use super::evidence::Evidence;
use super::index::{CellIndex, TileIndex};

/// Cells along one side of a tile.
pub const TILE_SIDE: i32 = 16;

/// Cells of a tile.
pub const TILE_CELLS: usize = (TILE_SIDE * TILE_SIDE) as usize;

/// Marks the end of a cell's records.
const END: u32 = u32::MAX;

/// Evidence of one cell between two heights half a metre apart. 112 bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Record {
    /// The record of the same cell above this.
    next: u32,
    /// Height of the slab [m/2]: it holds heights from `slab / 2` to below `(slab + 1) / 2`.
    pub slab: i32,
    pub evidence: Evidence,
}

/// 16 x 16 cells: 1 kB, and 112 bytes for every half metre of height in which a cell has evidence.
#[derive(Debug, Clone)]
pub struct Tile {
    pub(super) index: TileIndex,
    pub(super) revision: u64,
    /// Known cells, as counted after the last change.
    known: u16,
    /// The lowest record of every cell.
    first: [u32; TILE_CELLS],
    records: Vec<Record>,
}

impl Tile {
    pub(super) fn new(index: TileIndex) -> Self {
        Self { index, revision: 0, known: 0, first: [END; TILE_CELLS], records: Vec::new() }
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

    /// Where the evidence lies in memory: two tiles of one revision at one address are the same.
    pub(crate) fn address(&self) -> usize {
        self.records.as_ptr().addr()
    }

    /// Memory the tile takes [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.records.capacity() * size_of::<Record>()
    }

    /// The number of known cells.
    #[must_use]
    pub fn known_count(&self) -> usize {
        usize::from(self.known)
    }

    /// Counts the known cells, after a change.
    pub(super) fn count_known(&mut self) {
        self.known = (0..TILE_CELLS).filter(|within| !self.cell(*within).is_unknown()).count() as u16;
    }

    /// The known cells with their places, in a fixed order (rows of constant y, x running fastest).
    pub fn known_cells(&self) -> impl Iterator<Item = (CellIndex, Cell<'_>)> + '_ {
        (0..TILE_CELLS).filter_map(|within| {
            let cell = self.cell(within);
            (!cell.is_unknown()).then(|| (self.index.cell(within), cell))
        })
    }

    /// The cell at a place (0..256) of this tile.
    #[must_use]
    pub(super) fn cell(&self, within: usize) -> Cell<'_> {
        Cell { tile: self, within }
    }

    /// The records of a cell that hold evidence, upwards.
    pub(super) fn records_of(&self, within: usize) -> impl Iterator<Item = &Record> + '_ {
        let mut next = self.first[within];
        std::iter::from_fn(move || {
            let record = self.records.get(next as usize)?;
            next = record.next;
            Some(record)
        })
        .filter(|record| !record.evidence.is_empty())
    }

    /// The evidence of a cell in a slab, made if need be.
    #[inline]
    pub(super) fn evidence_mut(&mut self, within: usize, slab: i32) -> &mut Evidence {
        let mut before = END;
        let mut at = self.first[within];
        while at != END && self.records[at as usize].slab < slab {
            before = at;
            at = self.records[at as usize].next;
        }
        if at == END || self.records[at as usize].slab != slab {
            let new = self.records.len() as u32;
            self.records.push(Record { next: at, slab, evidence: Evidence::default() });
            if before == END {
                self.first[within] = new;
            } else {
                self.records[before as usize].next = new;
            }
            at = new;
        }
        &mut self.records[at as usize].evidence
    }

    /// Drops the records from which all evidence was taken away, once they are more than an eighth, and puts the rest in
    /// order.
    pub(super) fn tidy(&mut self) {
        let empty = self.records.iter().filter(|record| record.evidence.is_empty()).count();
        if 8 * empty <= self.records.len() {
            return;
        }
        let mut records = Vec::with_capacity(self.records.len());
        let mut first = [END; TILE_CELLS];
        for (within, first) in first.iter_mut().enumerate() {
            let begin = records.len();
            records.extend(self.records_of(within).copied());
            let own = &mut records[begin..];
            if own.is_empty() {
                continue;
            }
            *first = begin as u32;
            let last = own.len() - 1;
            for (k, record) in own.iter_mut().enumerate() {
                record.next = if k == last { END } else { (begin + k + 1) as u32 };
            }
        }
        self.records = records;
        self.first = first;
    }

    /// Whether the tiles say the same.
    pub(super) fn says_the_same(&self, other: &Self) -> bool {
        self.index == other.index
            && (0..TILE_CELLS).all(|within| {
                let key = |record: &Record| (record.slab, record.evidence);
                self.records_of(within).map(key).eq(other.records_of(within).map(key))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::super::evidence::Change;
    use super::super::item::{Item, Place};
    use super::*;

    #[test]
    fn a_record_takes_the_stated_bytes() {
        assert_eq!(size_of::<Record>(), 112);
    }

    #[test]
    fn records_stand_in_order_of_height_and_empty_ones_are_dropped() {
        let mut tile = Tile::new(TileIndex { x: 0, y: 0 });
        let item = Item::new(Place { x: 0, y: 0, z: 0 }, 0, 1);
        let put = |tile: &mut Tile, within, slab, change| {
            tile.evidence_mut(within, slab).change(change, &item, 4, slab * 256, [0, 0, 127]);
        };
        for slab in [4, -2, 0, 9, 0] {
            put(&mut tile, 17, slab, Change::Add);
            put(&mut tile, 18, -slab, Change::Add);
        }
        let slabs = |tile: &Tile, within| tile.records_of(within).map(|r| r.slab).collect::<Vec<_>>();
        assert_eq!((slabs(&tile, 17), slabs(&tile, 18)), (vec![-2, 0, 4, 9], vec![-9, -4, 0, 2]));
        for slab in [-2, 4] {
            put(&mut tile, 17, slab, Change::Remove);
        }
        let before = tile.clone();
        tile.tidy();
        assert!(tile.says_the_same(&before));
        assert_eq!((slabs(&tile, 17), slabs(&tile, 18)), (vec![0, 9], vec![-9, -4, 0, 2]));
        assert_eq!(tile.records.len(), 6);
        put(&mut tile, 17, 3, Change::Add);
        assert_eq!(slabs(&tile, 17), vec![0, 3, 9]);
    }
}
