//! Masks of the voxels of a brick between two corners.

/// Voxels with `low <= coordinate <= high` along one axis whose step in the mask is `stride` bits.
const fn slab(axis: u32, low: i32, high: i32) -> u64 {
    let mut mask = 0;
    let mut index = 0;
    while index < 64 {
        let coordinate = (index >> (2 * axis)) & 3;
        if coordinate >= low && coordinate <= high {
            mask |= 1 << index;
        }
        index += 1;
    }
    mask
}

/// Per axis, lowest and highest coordinate.
const SLABS: [[[u64; 4]; 4]; 3] = {
    let mut slabs = [[[0; 4]; 4]; 3];
    let mut axis = 0;
    while axis < 3 {
        let mut low = 0;
        while low < 4 {
            let mut high = 0;
            while high < 4 {
                slabs[axis][low][high] = slab(axis as u32, low as i32, high as i32);
                high += 1;
            }
            low += 1;
        }
        axis += 1;
    }
    slabs
};

/// The voxels of a brick between the corners `low` and `high`, which may lie outside it.
#[inline(always)]
pub(super) fn window(low: [i32; 3], high: [i32; 3]) -> u64 {
    let mut mask = u64::MAX;
    for axis in 0..3 {
        mask &= SLABS[axis][low[axis].max(0) as usize & 3][high[axis].min(3) as usize & 3];
    }
    mask
}
