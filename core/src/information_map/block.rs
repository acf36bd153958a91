//! Returns of one block of the scan, taken together by place and kind.

use super::condense::Frame;
use super::config::MapConfig;
use super::item::{CELL_SHIFT, Item, LARGEST_COUNT, NAVIGABLE, OBSTACLE, Place};
use super::normal_statistics::store;
use super::places::SomePlaces;
use crate::analysis::PointScore;
use nalgebra::Vector3;

/// Slots of the table; twice the points of a block, so that a free one is always near.
const SLOTS: usize = 512;
/// Points, and so groups, of a block at most.
const LARGEST_BLOCK: usize = 256;
/// Free slots lead to group 0, which is never used and whose key no point has.
const FREE: u16 = 0;
const FREE_KEY: u64 = u64::MAX;

/// Shifts from units to the extent within which returns are taken together: across, and up.
const FINE: (u32, u32) = (CELL_SHIFT - 1, 7);
const COARSE: (u32, u32) = (CELL_SHIFT, 8);

/// The thresholds u_F and u_B as stored scores.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thresholds {
    navigable: u16,
    obstacle: u16,
}

impl Thresholds {
    pub fn of(config: &MapConfig) -> Self {
        Self {
            navigable: (config.navigable_threshold * 65535.0) as u16,
            obstacle: (config.obstacle_threshold * 65535.0) as u16,
        }
    }

    /// What stored scores say.
    #[inline(always)]
    pub fn kind(&self, navigable: u16, obstacle: u16) -> u8 {
        let is = |holds: bool, kind: u8| if holds { kind } else { 0 };
        is(navigable > self.navigable, NAVIGABLE) | is(obstacle > self.obstacle, OBSTACLE)
    }
}

/// F and B of a point as stored; a point out of the robot's reach has none.
#[inline(always)]
pub(super) fn reachable_scores(score: &PointScore) -> (u16, u16) {
    let reach = u16::from(score.is_reachable());
    (score.navigable * reach, score.obstacle * reach)
}

/// Mean of scores as stored in a byte.
#[inline(always)]
pub(super) fn byte(sum: u32, count: u32) -> u8 {
    ((sum + count * 128) / (count * 257)) as u8
}

/// Returns of the same place and kind: one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Group {
    key: u64,
    kind: u8,
    corner: Place,
    count: u32,
    place: [u32; 3],
    navigable: u32,
    obstacle: u32,
    quality: u32,
    /// Sum of the normals, in the scanner's frame.
    normal: Vector3<f32>,
}

const _: () = assert!(size_of::<Group>() == 64);

impl Group {
    /// Of nothing.
    const EMPTY: Self = Self {
        key: FREE_KEY,
        kind: 0,
        corner: Place { x: 0, y: 0, z: 0 },
        count: 0,
        place: [0; 3],
        navigable: 0,
        obstacle: 0,
        quality: 0,
        normal: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// One block after the other.
#[derive(Debug)]
pub(super) struct Block {
    slots: [u16; SLOTS],
    /// From 1 to `used`; those above are empty.
    groups: [Group; LARGEST_BLOCK + 1],
    used: u16,
}

impl Default for Block {
    fn default() -> Self {
        Self { slots: [FREE; SLOTS], groups: [Group::EMPTY; LARGEST_BLOCK + 1], used: 0 }
    }
}

impl Block {
    /// Takes some points of the block that have these places. A block has at most 256 points.
    #[inline(always)]
    pub fn take(&mut self, scores: &[PointScore], places: SomePlaces<'_>, frame: &Frame) {
        for (k, score) in scores.iter().enumerate() {
            let Some(place) = places.get(k) else { continue };
            let (navigable, obstacle) = reachable_scores(score);
            let kind = frame.thresholds.kind(navigable, obstacle);
            let (across, up) = if kind == 0 { COARSE } else { FINE };
            let corner = Place { x: place.x >> across, y: place.y >> across, z: place.z >> up };
            let key = key(corner, kind);
            let group = self.group(key);
            // The same for all of a group: writing it again is cheaper than a branch that cannot be predicted.
            (group.key, group.kind) = (key, kind);
            group.corner = Place { x: corner.x << across, y: corner.y << across, z: corner.z << up };
            // A block has too few points for any of the sums to overflow.
            let add = |sum: &mut u32, value: u32| *sum = sum.wrapping_add(value);
            add(&mut group.count, 1);
            add(&mut group.place[0], place.x.wrapping_sub(group.corner.x) as u32);
            add(&mut group.place[1], place.y.wrapping_sub(group.corner.y) as u32);
            add(&mut group.place[2], place.z.wrapping_sub(group.corner.z) as u32);
            add(&mut group.navigable, u32::from(navigable));
            add(&mut group.obstacle, u32::from(obstacle));
            add(&mut group.quality, u32::from(score.quality));
            let normal = score.normal();
            group.normal.x += normal.x;
            group.normal.y += normal.y;
            group.normal.z += normal.z;
        }
    }

    /// The group of a key; an empty one for a key that is new.
    ///
    /// About every other return begins a group, so whether one does is not a branch.
    #[inline(always)]
    fn group(&mut self, key: u64) -> &mut Group {
        let mut slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 55) as usize;
        let mut found = self.slots[slot];
        loop {
            let held = self.groups[usize::from(found)].key;
            if (held == key) | (held == FREE_KEY) {
                break;
            }
            slot = (slot + 1) % SLOTS;
            found = self.slots[slot];
        }
        self.used += u16::from(found == FREE);
        let group = if found == FREE { self.used } else { found };
        self.slots[slot] = group;
        &mut self.groups[usize::from(group)]
    }

    /// Ends the block: its groups become items, in the order in which they were met.
    #[inline(always)]
    pub fn finish(&mut self, frame: &Frame, items: &mut Vec<Item>) {
        if self.used == 0 {
            return;
        }
        for group in &mut self.groups[1..=usize::from(self.used)] {
            let n = group.count;
            debug_assert!(n <= LARGEST_COUNT);
            let [x, y, z] = group.place;
            let place = Place {
                x: group.corner.x + (x / n) as i32,
                y: group.corner.y + (y / n) as i32,
                z: group.corner.z + ((2 * z + n) / (2 * n)) as i32,
            };
            let normal = group.normal.try_normalize(1e-3).map_or_else(Vector3::z, |normal| frame.turn(&normal));
            let mut item = Item::new(place, group.kind, n);
            item.quality = ((group.quality + n / 2) / n) as u16;
            item.navigable = byte(group.navigable, n);
            item.obstacle = byte(group.obstacle, n);
            item.normal = store(&normal);
            items.push(item);
            *group = Group::EMPTY;
        }
        self.used = 0;
        self.slots = [FREE; SLOTS];
    }
}

/// One number for place and kind.
#[inline(always)]
fn key(corner: Place, kind: u8) -> u64 {
    let bits = |v: i32| u64::from(v as u32) & 0xf_ffff;
    bits(corner.x) << 44 | bits(corner.y) << 24 | bits(corner.z) << 4 | u64::from(kind)
}
