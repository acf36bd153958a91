//! A scan's evidence on its way into the tiles, and out of them again.

use super::evidence::{Change, RETURN_WEIGHT};
use super::index::{CellIndex, TileIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS, HEIGHT_UNITS_PER_METRE, INTERPOLATED, Item, Place};
use super::normal_statistics::{StoredNormal, store};
use super::scan_evidence::ScanEvidence;
use super::tile::{TILE_SIDE, Tile};
use crate::geometry::Pose;
use crate::threads::for_each;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Shift from units to slabs of half a metre.
const SLAB_SHIFT: u32 = 8;
/// Tiles along each side of the square in which tiles are found without a search.
const NEAR: i32 = 16;

/// Fewer pieces than this are put in by the caller's thread alone: another one would cost more than it saves.
const WORTH_A_THREAD: usize = 4096;
/// No share.
const NONE: u32 = u32::MAX;

/// One piece of evidence on its way into a tile.
#[derive(Debug, Clone, Copy)]
struct Put {
    /// With its normal in the map's frame.
    item: Item,
    height: i32,
    quarters: u32,
    share: u32,
    within: u8,
}

const _: () = assert!(size_of::<Put>() == 32);

/// What one tile gets: the pieces `begin..end` of the order.
#[derive(Debug, Clone, Copy)]
struct Share {
    slot: usize,
    begin: u32,
    end: u32,
}

/// The pieces of one scan, sorted by tile. Buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub(super) struct Sorter {
    puts: Vec<Put>,
    /// Indices of `puts`, one tile's after the other's, each in the order of the scan.
    order: Vec<u32>,
    shares: Vec<Share>,
    /// The share of every tile, `NONE` between scans.
    share_of_slot: Vec<u32>,
    /// Tiles found already, by their place modulo `NEAR`.
    near: Vec<Option<(TileIndex, u32)>>,
}

/// A copy begins without buffers.
impl Clone for Sorter {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// The tiles, being changed.
pub(super) struct Projection<'a> {
    pub tiles: &'a mut Vec<Tile>,
    pub slots: &'a mut BTreeMap<TileIndex, usize>,
    /// Known cells of all tiles.
    pub known: &'a mut usize,
    pub sorter: &'a mut Sorter,
    pub revision: u64,
    pub threads: usize,
    /// Tiles that had another revision before.
    pub touched: usize,
}

impl Projection<'_> {
    /// Adds or takes away everything a scan says when it stands at `map_from_scanner`.
    ///
    /// The pieces are sorted by tile, and a tile is changed by one thread, in the order of the scan: its memory is at
    /// hand while it is worked on, and the number of threads does not change a bit.
    pub fn change(&mut self, change: Change, evidence: &ScanEvidence, map_from_scanner: &Pose) {
        self.sorter.begin(self.tiles.len());
        let corner = (evidence.anchor.x << CELL_SHIFT, evidence.anchor.y << CELL_SHIFT);
        let origin = Origin { x: corner.0, y: corner.1, z: evidence.anchor_height };
        match Motion::of(evidence, map_from_scanner) {
            None => {
                for item in &evidence.items {
                    self.put(*item, &origin.place(item.place()), RETURN_WEIGHT * item.count());
                }
            }
            Some(motion) => {
                for item in &evidence.items {
                    let (place, normal) = motion.apply(item);
                    let mut moved = *item;
                    moved.normal = normal;
                    if item.kind() & INTERPOLATED == 0 {
                        self.put(moved, &origin.place(place), RETURN_WEIGHT * item.count());
                    } else {
                        self.put_patch(moved, origin.place(place), &motion);
                    }
                }
            }
        }
        self.change_tiles(change);
    }

    /// A triangle over a whole cell, turned and moved: each of its quarters counts where its middle is. Middles are
    /// half a cell apart, less than the cell's side over the root of two, so however the cells are turned none is left
    /// without.
    fn put_patch(&mut self, item: Item, middle: Place, motion: &Motion) {
        let [(ux, uy), (vx, vy)] = motion.quarters;
        let at = |dx: i32, dy: i32| Place { x: middle.x + dx, y: middle.y + dy, z: middle.z };
        let quarters = [at(ux, uy), at(vx, vy), at(-ux, -uy), at(-vx, -vy)];
        let cell = |p: &Place| (p.x >> CELL_SHIFT, p.y >> CELL_SHIFT);
        if quarters.iter().all(|quarter| cell(quarter) == cell(&quarters[0])) {
            self.put(item, &quarters[0], RETURN_WEIGHT);
        } else {
            quarters.iter().for_each(|quarter| self.put(item, quarter, 1));
        }
    }

    #[inline]
    fn put(&mut self, item: Item, at: &Place, quarters: u32) {
        let cell = CellIndex { x: at.x >> CELL_SHIFT, y: at.y >> CELL_SHIFT };
        let share = self.share(cell.tile());
        self.sorter.shares[share as usize].end += 1;
        let within = cell.within_tile() as u8;
        self.sorter.puts.push(Put { item, height: at.z, quarters, share, within });
    }

    /// The share of a tile, which is made if need be.
    #[inline]
    fn share(&mut self, index: TileIndex) -> u32 {
        let near = (index.y.rem_euclid(NEAR) * NEAR + index.x.rem_euclid(NEAR)) as usize;
        if let Some((found, share)) = self.sorter.near[near]
            && found == index
        {
            return share;
        }
        let slot = *self.slots.entry(index).or_insert_with(|| {
            self.tiles.push(Tile::new(index));
            self.sorter.share_of_slot.push(NONE);
            self.tiles.len() - 1
        });
        let tile = &mut self.tiles[slot];
        if tile.revision != self.revision {
            tile.revision = self.revision;
            self.touched += 1;
        }
        let share = &mut self.sorter.share_of_slot[slot];
        if *share == NONE {
            *share = self.sorter.shares.len() as u32;
            self.sorter.shares.push(Share { slot, begin: 0, end: 0 });
        }
        self.sorter.near[near] = Some((index, *share));
        *share
    }

    /// Puts what was sorted into the tiles.
    fn change_tiles(&mut self, change: Change) {
        let Sorter { puts, order, shares, .. } = self.sorter.sorted();
        let (puts, order) = (puts.as_slice(), order.as_slice());
        let (mut tiles, mut passed) = (self.tiles.as_mut_slice(), 0);
        let parts = shares.iter().filter_map(move |share| {
            let (_, rest) = std::mem::take(&mut tiles).split_at_mut_checked(share.slot - passed)?;
            let (tile, after) = rest.split_first_mut()?;
            (tiles, passed) = (after, share.slot + 1);
            Some((tile, &order[share.begin as usize..share.end as usize]))
        });
        let threads = if puts.len() < WORTH_A_THREAD { 1 } else { self.threads };
        let (gained, lost) = (AtomicUsize::new(0), AtomicUsize::new(0));
        for_each(parts, threads, |(tile, order)| {
            lost.fetch_add(tile.known_count(), Relaxed);
            for &k in order {
                let put = &puts[k as usize];
                let evidence = tile.evidence_mut(usize::from(put.within), put.height >> SLAB_SHIFT);
                evidence.change(change, &put.item, put.quarters, put.height, put.item.normal);
            }
            // While the tile is at hand.
            tile.count_known();
            gained.fetch_add(tile.known_count(), Relaxed);
        });
        *self.known = *self.known + gained.into_inner() - lost.into_inner();
    }
}

impl Sorter {
    fn begin(&mut self, tiles: usize) {
        self.puts.clear();
        self.shares.clear();
        self.share_of_slot.resize(tiles, NONE);
        self.near.clear();
        self.near.resize((NEAR * NEAR) as usize, None);
    }

    /// Sorts by tile, what comes first staying first, and the shares by where their tiles are.
    fn sorted(&mut self) -> &Self {
        let mut begin = 0;
        for share in &mut self.shares {
            let count = share.end;
            (share.begin, share.end) = (begin, begin);
            begin += count;
            self.share_of_slot[share.slot] = NONE;
        }
        self.order.resize(self.puts.len(), 0);
        for (k, put) in (0..).zip(&self.puts) {
            let share = &mut self.shares[put.share as usize];
            self.order[share.end as usize] = k;
            share.end += 1;
        }
        self.shares.sort_unstable_by_key(|share| share.slot);
        self
    }
}

/// From units relative to the anchor to units of the map.
struct Origin {
    x: i32,
    y: i32,
    z: i32,
}

impl Origin {
    #[inline]
    fn place(&self, place: Place) -> Place {
        Place { x: self.x + place.x, y: self.y + place.y, z: self.z + place.z }
    }
}

/// How a scan has moved since it was condensed, in units relative to its anchor.
struct Motion {
    linear: Matrix3<f64>,
    offset: Vector3<f64>,
    rotation: Matrix3<f32>,
    /// From the middle of a triangle over a cell to the middles of two of its quarters; the others lie opposite.
    quarters: [(i32, i32); 2],
}

impl Motion {
    /// `None` when it stands where it stood.
    fn of(evidence: &ScanEvidence, map_from_scanner: &Pose) -> Option<Self> {
        if *map_from_scanner == evidence.map_from_scanner {
            return None;
        }
        let new_from_old = map_from_scanner * evidence.map_from_scanner.inverse();
        let per_metre = f64::from(CELL_UNITS) / evidence.cell_m;
        let scale = Vector3::new(per_metre, per_metre, HEIGHT_UNITS_PER_METRE);
        let metres = Vector3::new(1.0 / scale.x, 1.0 / scale.y, 1.0 / scale.z);
        let rotation = new_from_old.rotation.to_rotation_matrix().into_inner();
        let units = f64::from(CELL_UNITS);
        let anchor = Vector3::new(
            f64::from(evidence.anchor.x) * units,
            f64::from(evidence.anchor.y) * units,
            f64::from(evidence.anchor_height),
        );
        let anchor_m = anchor.component_mul(&metres);
        let moved = rotation * anchor_m + new_from_old.translation.vector - anchor_m;
        let linear = Matrix3::from_diagonal(&scale) * rotation * Matrix3::from_diagonal(&metres);
        let quarter = units / 4.0;
        let turned = |x: f64, y: f64| {
            let [x, y] = [linear.m11 * x + linear.m12 * y, linear.m21 * x + linear.m22 * y];
            (floor(x + 0.5), floor(y + 0.5))
        };
        let quarters = [turned(quarter, quarter), turned(quarter, -quarter)];
        Some(Self { linear, offset: moved.component_mul(&scale), rotation: rotation.cast(), quarters })
    }

    #[inline]
    fn apply(&self, item: &Item) -> (Place, StoredNormal) {
        let place = item.place();
        let (m, t) = (&self.linear, &self.offset);
        // A unit across stands for its middle, one of height for its own value.
        let (x, y, z) = (f64::from(place.x) + 0.5, f64::from(place.y) + 0.5, f64::from(place.z));
        let moved = Place {
            x: floor(m.m11 * x + m.m12 * y + m.m13 * z + t.x),
            y: floor(m.m21 * x + m.m22 * y + m.m23 * z + t.y),
            z: floor(m.m31 * x + m.m32 * y + m.m33 * z + t.z + 0.5),
        };
        let (r, n) = (&self.rotation, item.normal.map(f32::from));
        let row = |a: f32, b: f32, c: f32| (a * n[0] + b * n[1] + c * n[2]) / 127.0;
        let normal = Vector3::new(row(r.m11, r.m12, r.m13), row(r.m21, r.m22, r.m23), row(r.m31, r.m32, r.m33));
        (moved, store(&normal))
    }
}

// A tile's side in cells is a power of two; places of cells follow by shifts.
const _: () = assert!(TILE_SIDE == 16);
