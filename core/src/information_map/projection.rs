//! A scan's evidence on its way into the tiles, and out of them again.

use super::evidence::{Change, RETURN_WEIGHT};
use super::index::{CellIndex, TileIndex, floor};
use super::item::{CELL_SHIFT, CELL_UNITS, HEIGHT_UNITS_PER_METRE, INTERPOLATED, Item, Place};
use super::normal_statistics::{StoredNormal, store};
use super::scan_evidence::ScanEvidence;
use super::tile::{TILE_SIDE, Tile};
use crate::geometry::Pose;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Shift from units to slabs of half a metre.
const SLAB_SHIFT: u32 = 8;
/// Tiles along each side of the square in which tiles are found without a search.
const NEAR: i32 = 16;

/// What one scan did to the tiles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Touched {
    pub tiles: usize,
}

/// The tiles, being changed.
pub(super) struct Projection<'a> {
    pub tiles: &'a mut Vec<Tile>,
    pub slots: &'a mut BTreeMap<TileIndex, usize>,
    pub revision: u64,
    /// Tiles found already, by their place modulo `NEAR`.
    near: Vec<Option<(TileIndex, usize)>>,
    touched: Touched,
}

impl<'a> Projection<'a> {
    pub fn new(tiles: &'a mut Vec<Tile>, slots: &'a mut BTreeMap<TileIndex, usize>, revision: u64) -> Self {
        let near = vec![None; (NEAR * NEAR) as usize];
        Self { tiles, slots, revision, near, touched: Touched::default() }
    }

    /// Adds or takes away everything a scan says when it stands at `map_from_scanner`.
    pub fn change(&mut self, change: Change, evidence: &ScanEvidence, map_from_scanner: &Pose) -> Touched {
        let corner = (evidence.anchor.x << CELL_SHIFT, evidence.anchor.y << CELL_SHIFT);
        let origin = Origin { x: corner.0, y: corner.1, z: evidence.anchor_height };
        match Motion::of(evidence, map_from_scanner) {
            None => {
                for item in &evidence.items {
                    let place = item.place();
                    self.put(change, item, &origin.place(place), RETURN_WEIGHT, item.normal, item.count());
                }
            }
            Some(motion) => {
                for item in &evidence.items {
                    let (place, normal) = motion.apply(item);
                    if item.kind() & INTERPOLATED == 0 {
                        self.put(change, item, &origin.place(place), RETURN_WEIGHT, normal, item.count());
                    } else {
                        self.put_patch(change, item, origin.place(place), &motion, normal);
                    }
                }
            }
        }
        self.touched
    }

    /// A triangle over a whole cell, turned and moved: each of its quarters counts where its middle is. Middles are
    /// half a cell apart, less than the cell's side over the root of two, so however the cells are turned none is left
    /// without.
    fn put_patch(&mut self, change: Change, item: &Item, middle: Place, motion: &Motion, normal: StoredNormal) {
        let [(ux, uy), (vx, vy)] = motion.quarters;
        let at = |dx: i32, dy: i32| Place { x: middle.x + dx, y: middle.y + dy, z: middle.z };
        let quarters = [at(ux, uy), at(vx, vy), at(-ux, -uy), at(-vx, -vy)];
        let cell = |p: &Place| (p.x >> CELL_SHIFT, p.y >> CELL_SHIFT);
        if quarters.iter().all(|quarter| cell(quarter) == cell(&quarters[0])) {
            self.put(change, item, &quarters[0], RETURN_WEIGHT, normal, 1);
        } else {
            quarters.iter().for_each(|quarter| self.put(change, item, quarter, 1, normal, 1));
        }
    }

    #[inline]
    fn put(&mut self, change: Change, item: &Item, at: &Place, weight: u32, normal: StoredNormal, count: u32) {
        let cell = CellIndex { x: at.x >> CELL_SHIFT, y: at.y >> CELL_SHIFT };
        let slot = self.slot(cell.tile());
        let tile = &mut self.tiles[slot];
        if tile.revision != self.revision {
            tile.revision = self.revision;
            self.touched.tiles += 1;
        }
        tile.evidence_mut(cell.within_tile(), at.z >> SLAB_SHIFT).change(change, item, weight * count, at.z, normal);
    }

    #[inline]
    fn slot(&mut self, index: TileIndex) -> usize {
        let near = (index.y.rem_euclid(NEAR) * NEAR + index.x.rem_euclid(NEAR)) as usize;
        if let Some((found, slot)) = self.near[near]
            && found == index
        {
            return slot;
        }
        let slot = *self.slots.entry(index).or_insert_with(|| {
            self.tiles.push(Tile::new(index));
            self.tiles.len() - 1
        });
        self.near[near] = Some((index, slot));
        slot
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
