//! One piece of a scan's evidence, in 16 bytes: what many returns of a small place, or one gap between returns, say.

use super::normal_statistics::StoredNormal;
use bytemuck::{Pod, Zeroable};

/// Positions along x and y are stored in units of 1/64 cell.
pub(super) const CELL_SHIFT: u32 = 6;
/// Units of position along one side of a cell.
pub(super) const CELL_UNITS: i32 = 1 << CELL_SHIFT;
/// Heights are stored in units of 1/512 m.
pub(super) const HEIGHT_UNITS_PER_METRE: f64 = 512.0;
/// Positions lie within plus or minus so many units of the summary's anchor: 4,096 cells.
pub(super) const PLACE_LIMIT: i32 = 1 << 18;
/// Heights lie within plus or minus so many units of the summary's anchor: 8,192 m.
pub(super) const HEIGHT_LIMIT: i32 = 1 << 22;
/// Returns that one item stands for at most.
pub(super) const LARGEST_COUNT: u32 = 256;

/// The returns say: can be driven on (F > u_F).
pub(super) const NAVIGABLE: u8 = 1;
/// The returns say: is an obstacle (B > u_B).
pub(super) const OBSTACLE: u8 = 2;
/// No return, but a kept triangle over a whole cell.
pub(super) const INTERPOLATED: u8 = 4;

/// One item of a scan's evidence.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct Item {
    /// x (19 bits) and y (19 bits) [cell / 64], z (23 bits) [m / 512], each relative to the anchor and shifted to be
    /// positive; then the three bits of the kind.
    place: u64,
    /// Mean D of the returns, times 65535.
    pub quality: u16,
    /// Mean F and B of the returns, times 255.
    pub navigable: u8,
    pub obstacle: u8,
    /// Mean normal.
    pub normal: StoredNormal,
    /// Number of returns less one.
    count_less_one: u8,
}

/// Where an item is, relative to the anchor of its summary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub x: i32,
    pub y: i32,
    pub z: i32,
}

impl Item {
    /// `place` must lie within the limits, `count` must be 1 to 256.
    #[inline(always)]
    pub fn new(place: Place, kind: u8, count: u32) -> Self {
        let up = |v: i32, limit: i32| (i64::from(v) + i64::from(limit)) as u64;
        let place = up(place.x, PLACE_LIMIT)
            | up(place.y, PLACE_LIMIT) << 19
            | up(place.z, HEIGHT_LIMIT) << 38
            | u64::from(kind) << 61;
        Self { place, count_less_one: (count - 1) as u8, ..Self::zeroed() }
    }

    /// The same elsewhere.
    #[inline(always)]
    pub fn at(&self, place: Place) -> Self {
        Self { place: Self::new(place, self.kind(), 1).place, ..*self }
    }

    #[inline(always)]
    pub fn place(&self) -> Place {
        let down = |shift: u32, bits: u32| ((self.place >> shift) & ((1 << bits) - 1)) as i32;
        Place { x: down(0, 19) - PLACE_LIMIT, y: down(19, 19) - PLACE_LIMIT, z: down(38, 23) - HEIGHT_LIMIT }
    }

    #[inline(always)]
    pub fn kind(&self) -> u8 {
        (self.place >> 61) as u8
    }

    /// Number of returns.
    #[inline(always)]
    pub fn count(&self) -> u32 {
        u32::from(self.count_less_one) + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn an_item_takes_the_stated_bytes() {
        assert_eq!(size_of::<Item>(), 16);
    }

    proptest! {
        #[test]
        fn place_kind_and_count_come_back(
            x in -PLACE_LIMIT..PLACE_LIMIT, y in -PLACE_LIMIT..PLACE_LIMIT, z in -HEIGHT_LIMIT..HEIGHT_LIMIT,
            kind in 0..8u8, count in 1..=LARGEST_COUNT,
        ) {
            let place = Place { x, y, z };
            let item = Item::new(place, kind, count);
            prop_assert_eq!((item.place(), item.kind(), item.count()), (place, kind, count));
        }
    }
}
