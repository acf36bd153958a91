//! Voxel coordinates in one word, and where they go in a flat table.

use crate::registration::floor;

/// Bits of one voxel coordinate in a key.
const AXIS_BITS: u32 = 21;
const AXIS_MASK: u64 = (1 << AXIS_BITS) - 1;
/// A key no voxel has: keys take 63 bits.
pub(super) const NO_KEY: u64 = u64::MAX;

/// Three voxel coordinates as a key. They wrap around every 2^21 voxels, hundreds of kilometres, which is farther than
/// any local map reaches.
#[inline(always)]
pub(super) fn key_of(voxel: [i32; 3]) -> u64 {
    #[inline(always)]
    fn axis(v: i32) -> u64 {
        u64::from(v as u32) & AXIS_MASK
    }
    axis(voxel[0]) << (2 * AXIS_BITS) | axis(voxel[1]) << AXIS_BITS | axis(voxel[2])
}

/// The voxel coordinates of a key, the ones nearest to `near` of those that wrap to it.
pub(super) fn voxel_of(key: u64, near: [i32; 3]) -> [i32; 3] {
    let unwrap = |bits: u64, near: i32| {
        // The difference to `near` in 21 bits, sign extended.
        let apart = ((bits as u32).wrapping_sub(near as u32) << (32 - AXIS_BITS)) as i32 >> (32 - AXIS_BITS);
        near.wrapping_add(apart)
    };
    [
        unwrap(key >> (2 * AXIS_BITS) & AXIS_MASK, near[0]),
        unwrap(key >> AXIS_BITS & AXIS_MASK, near[1]),
        unwrap(key & AXIS_MASK, near[2]),
    ]
}

/// The voxel of edge `1 / per_metre` that holds a point.
#[inline(always)]
pub(super) fn voxel_at(point: [f32; 3], per_metre: f32) -> [i32; 3] {
    [floor(point[0] * per_metre), floor(point[1] * per_metre), floor(point[2] * per_metre)]
}

/// Where the search for a key starts in a table of `mask + 1` entries: the eight voxels of a 2 x 2 x 2 block stand side
/// by side, so that neighbours share cache lines; blocks are scattered by a multiplicative hash (Knuth 6.4).
#[inline(always)]
pub(super) fn home(key: u64, mask: usize) -> usize {
    const LOW: u64 = 1 << (2 * AXIS_BITS) | 1 << AXIS_BITS | 1;
    let block = (key & !LOW).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let within = key >> (2 * AXIS_BITS - 2) & 4 | key >> (AXIS_BITS - 1) & 2 | key & 1;
    ((block >> 32 << 3 | within) as usize) & mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_key_gives_back_its_voxel_near_where_it_is_looked_for(
            voxel in prop::array::uniform3(-2_000_000_000..2_000_000_000_i32),
            apart in prop::array::uniform3(-1_000_000..1_000_000_i32),
        ) {
            let near = [0, 1, 2].map(|k: usize| voxel[k] + apart[k]);
            prop_assert_eq!(voxel_of(key_of(voxel), near), voxel);
        }
    }
}
