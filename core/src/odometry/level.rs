//! One resolution of the local map: voxels in flat arrays, found by open addressing.

use serde::{Deserialize, Serialize};

use super::surfel::{Moments, Surfel};
use super::voxel_key::{NO_KEY, home, key_of, voxel_at, voxel_of};

/// No voxel.
pub(super) const NOTHING: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
struct Entry {
    key: u64,
    at: u32,
}

const EMPTY: Entry = Entry { key: NO_KEY, at: NOTHING };

/// What stands beside the bytes of a level's voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct LevelHead {
    voxels: usize,
    sweep: usize,
}

/// Voxels of one edge length. Everything is allocated at the start; when it is full, new voxels are refused.
#[derive(Debug)]
pub(super) struct Level {
    edge_m: f32,
    per_metre: f32,
    most: usize,
    /// A power of two, at least twice as long as there can be voxels.
    table: Vec<Entry>,
    keys: Vec<u64>,
    surfels: Vec<Surfel>,
    moments: Vec<Moments>,
    /// Voxels that got points since the last `fit`.
    changed: Vec<u32>,
    /// Where the next sweep for far voxels goes on.
    sweep: usize,
}

impl Level {
    pub fn new(edge_m: f32, most: usize) -> Self {
        Self {
            edge_m,
            per_metre: 1.0 / edge_m,
            most,
            table: vec![EMPTY; (2 * most).next_power_of_two()],
            keys: Vec::with_capacity(most),
            surfels: Vec::with_capacity(most),
            moments: Vec::with_capacity(most),
            changed: Vec::with_capacity(most),
            sweep: 0,
        }
    }

    pub fn edge_m(&self) -> f32 {
        self.edge_m
    }

    pub fn len(&self) -> usize {
        self.keys.len()
    }

    pub fn is_crowded(&self) -> bool {
        10 * self.keys.len() > 9 * self.most
    }

    pub fn bytes(&self) -> usize {
        self.table.capacity() * size_of::<Entry>()
            + self.keys.capacity() * size_of::<u64>()
            + self.surfels.capacity() * size_of::<Surfel>()
            + self.moments.capacity() * size_of::<Moments>()
            + self.changed.capacity() * size_of::<u32>()
    }

    pub fn clear(&mut self) {
        self.table.fill(EMPTY);
        self.keys.clear();
        self.surfels.clear();
        self.moments.clear();
        self.changed.clear();
        self.sweep = 0;
    }

    /// The voxel that holds a point, relative to the one at the local origin.
    #[inline(always)]
    pub fn voxel(&self, local: [f32; 3]) -> [i32; 3] {
        voxel_at(local, self.per_metre)
    }

    /// One over the edge [1/m].
    pub fn per_metre(&self) -> f32 {
        self.per_metre
    }

    /// The lowest corner of a voxel, from the local origin [m].
    #[inline(always)]
    pub fn corner(&self, voxel: [i32; 3]) -> [f32; 3] {
        [voxel[0] as f32 * self.edge_m, voxel[1] as f32 * self.edge_m, voxel[2] as f32 * self.edge_m]
    }

    /// The plane of a voxel, in absolute coordinates; `None` where the map has nothing.
    #[inline]
    pub fn surfel(&self, voxel: [i32; 3]) -> Option<&Surfel> {
        let key = key_of(voxel);
        let mask = self.table.len() - 1;
        let mut place = home(key, mask);
        loop {
            let entry = self.table.get(place)?;
            if entry.key == key {
                return self.surfels.get(entry.at as usize);
            }
            if entry.key == NO_KEY {
                return None;
            }
            place = (place + 1) & mask;
        }
    }

    /// Adds a point to a voxel; it lies `offset` from the lowest corner [m].
    #[inline]
    pub fn add(&mut self, voxel: [i32; 3], offset: [f32; 3]) {
        let Some(at) = self.find_or_make(key_of(voxel)) else { return };
        // `find_or_make` gave a valid index.
        let moments = &mut self.moments[at];
        moments.add(offset);
        if !moments.changed {
            moments.changed = true;
            self.changed.push(at as u32);
        }
    }

    #[inline]
    fn find_or_make(&mut self, key: u64) -> Option<usize> {
        let mask = self.table.len() - 1;
        let mut place = home(key, mask);
        loop {
            let entry = &mut self.table[place];
            if entry.key == key {
                return Some(entry.at as usize);
            }
            if entry.key == NO_KEY {
                let at = self.keys.len();
                if at == self.most {
                    return None;
                }
                *entry = Entry { key, at: at as u32 };
                self.keys.push(key);
                self.surfels.push(Surfel::NONE);
                self.moments.push(Moments::default());
                return Some(at);
            }
            place = (place + 1) & mask;
        }
    }

    /// Fits the planes of the voxels that got points.
    pub fn fit(&mut self) {
        for at in self.changed.drain(..) {
            let at = at as usize;
            if let (Some(moments), Some(surfel)) = (self.moments.get_mut(at), self.surfels.get_mut(at)) {
                moments.changed = false;
                *surfel = moments.fit();
            }
        }
    }

    /// Looks at the next `share` of the voxels and removes those farther than `radius` voxels from `centre`. All voxels
    /// are fitted when this is called.
    pub fn sweep(&mut self, centre: [i32; 3], radius: f32, share: f32) {
        let visits = (self.len() as f32 * share).ceil() as usize;
        if visits >= self.len() {
            // From the middle, voxels that fill gaps would be looked at twice and others not at all.
            self.sweep = 0;
        }
        for _ in 0..visits.min(self.len()) {
            if self.sweep >= self.len() {
                self.sweep = 0;
            }
            let Some(key) = self.keys.get(self.sweep) else { return };
            let voxel = voxel_of(*key, centre);
            let apart = [0, 1, 2].map(|k: usize| voxel[k].wrapping_sub(centre[k]) as f32);
            if apart.iter().map(|v| v * v).sum::<f32>() > radius * radius {
                self.remove(self.sweep);
            } else {
                self.sweep += 1;
            }
        }
    }

    /// Removes a voxel; the last one takes its place in the arrays.
    fn remove(&mut self, at: usize) {
        self.forget(self.keys[at]);
        self.keys.swap_remove(at);
        self.surfels.swap_remove(at);
        self.moments.swap_remove(at);
        if let Some(moved) = self.keys.get(at) {
            let place = self.place(*moved);
            self.table[place].at = at as u32;
        }
    }

    /// Where a key that is in the table stands.
    fn place(&self, key: u64) -> usize {
        let mask = self.table.len() - 1;
        let mut place = home(key, mask);
        while self.table[place].key != key {
            place = (place + 1) & mask;
        }
        place
    }

    /// Takes a key out of the table and closes the gap (Knuth 6.4, algorithm R): no tombstones gather.
    fn forget(&mut self, key: u64) {
        let mask = self.table.len() - 1;
        let mut gap = self.place(key);
        let mut next = gap;
        loop {
            next = (next + 1) & mask;
            let entry = self.table[next];
            if entry.key == NO_KEY {
                break;
            }
            // An entry may move back to the gap unless its home lies between the two.
            let from_home = next.wrapping_sub(home(entry.key, mask)) & mask;
            if from_home >= (next.wrapping_sub(gap) & mask) {
                self.table[gap] = entry;
                gap = next;
            }
        }
        self.table[gap] = EMPTY;
    }

    /// Bytes of one voxel.
    const VOXEL_BYTES: usize = 8 + Moments::BYTES;

    /// Where the next sweep goes on, and the voxels as bytes in their order, by which sweeps go. All are fitted.
    pub fn write(&self, out: &mut Vec<u8>) -> LevelHead {
        for (key, moments) in self.keys.iter().zip(&self.moments) {
            out.extend_from_slice(&key.to_le_bytes());
            moments.write(out);
        }
        LevelHead { voxels: self.keys.len(), sweep: self.sweep }
    }

    /// Takes over what [`Self::write`] wrote, into an empty level; what is left of the bytes. `None` when they are not
    /// such bytes.
    pub fn read<'b>(&mut self, head: &LevelHead, bytes: &'b [u8]) -> Option<&'b [u8]> {
        let (own, rest) = bytes.split_at_checked(head.voxels.checked_mul(Self::VOXEL_BYTES)?)?;
        for (number, voxel) in own.as_chunks::<{ Self::VOXEL_BYTES }>().0.iter().enumerate() {
            let (key, moments) = voxel.split_first_chunk::<8>()?;
            let at = self.find_or_make(u64::from_le_bytes(*key)).filter(|at| *at == number)?;
            self.moments[at] = Moments::read(moments.first_chunk()?);
            self.surfels[at] = self.moments[at].fit();
        }
        self.sweep = head.sweep;
        Some(rest)
    }

    /// All voxels with their surfels, coordinates nearest to `near`.
    pub fn surfels(&self, near: [i32; 3]) -> impl Iterator<Item = ([i32; 3], &Surfel)> {
        self.keys.iter().map(move |key| voxel_of(*key, near)).zip(&self.surfels)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn voxels_come_and_go_like_in_a_set(
            steps in prop::collection::vec((prop::array::uniform3(-9..9_i32), 0..20_u8), 1..400),
        ) {
            let mut level = Level::new(1.0, 300);
            let mut set = BTreeSet::new();
            for (voxel, action) in steps {
                if action == 0 {
                    level.fit();
                    level.sweep(voxel, 8.0, 1.0);
                    let near = |v: &[i32; 3]| (0..3).map(|k| (v[k] - voxel[k]).pow(2)).sum::<i32>() <= 64;
                    set.retain(near);
                } else if set.len() < 300 || set.contains(&voxel) {
                    level.add(voxel, [0.5; 3]);
                    set.insert(voxel);
                }
                prop_assert_eq!(level.len(), set.len());
            }
            for x in -10..10 {
                for y in -10..10 {
                    for z in -10..10 {
                        prop_assert_eq!(level.surfel([x, y, z]).is_some(), set.contains(&[x, y, z]));
                    }
                }
            }
        }
    }

    #[test]
    fn a_full_level_refuses_new_voxels_and_keeps_its_memory() {
        let mut level = Level::new(0.5, 100);
        let bytes = level.bytes();
        for k in 0..1000 {
            level.add([k, 0, 0], [0.1; 3]);
        }
        level.fit();
        assert_eq!((level.len(), level.bytes()), (100, bytes));
        assert!(level.is_crowded() && level.surfel([99, 0, 0]).is_some() && level.surfel([100, 0, 0]).is_none());
        level.sweep([100, 0, 0], 10.5, 1.0);
        assert_eq!(level.len(), 10);
    }
}
