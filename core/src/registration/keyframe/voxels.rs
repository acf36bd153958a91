//! Thinning: the returns in one voxel become their centroid. Voxels lie in bricks of 4 x 4 x 4, found by a hash.
//!
//! A brick is one 64-bit mask of its occupied voxels and the number of the first of them, so that a voxel's
//! neighbours are mask operations, and walls and floors, which fill few voxels, take little memory.

use super::moments::Moments;
use crate::registration::PreparationConfig;
use crate::scan::ScanView;

/// Voxels of a brick along each axis.
pub(super) const EDGE: i32 = 4;
/// Bits of one brick coordinate in a key.
const AXIS_BITS: u32 = 21;
/// Added to a brick coordinate to make it positive.
const AXIS_OFFSET: i32 = 1 << (AXIS_BITS - 1);
/// Returns beyond so many in one voxel are left out: its centroid is known to a hundredth of the noise, and sums of
/// single precision stay exact enough.
const MOST_RETURNS: f32 = 4096.0;
/// No brick has this key.
const VACANT: u64 = u64::MAX;

/// Up to 64 voxels side by side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::registration) struct Brick {
    /// Its place, in bricks from the scanner.
    pub place: [i32; 3],
    /// The first of its voxels; they follow in the order of the mask's bits.
    pub first: u32,
    /// Bit x + 4 y + 16 z is set when that voxel holds a return.
    pub mask: u64,
}

impl Brick {
    /// The index of the voxel of a bit that is set.
    #[inline(always)]
    pub fn voxel(&self, bit: u64) -> u32 {
        self.first + (self.mask & (bit - 1)).count_ones()
    }
}

/// The voxels of one scan, bricks in the order of a Z curve: neighbours in space are mostly neighbours in memory.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::registration) struct Voxels {
    pub(super) voxel_m: f32,
    pub(super) per_metre: f32,
    pub(super) bricks: Vec<Brick>,
    /// Open addressing: key and number of a brick.
    table: Vec<(u64, u32)>,
}

/// Voxels with what their returns sum up to.
pub(super) struct Thinned {
    pub voxels: Voxels,
    /// The returns of each voxel about the centre of its brick.
    pub moments: Vec<Moments>,
}

impl Voxels {
    /// The number of no brick.
    pub(super) const NOWHERE: u32 = u32::MAX;

    /// The brick at `place`, if it holds a return.
    #[inline(always)]
    pub fn brick_at(&self, place: [i32; 3]) -> Option<&Brick> {
        self.bricks.get(self.number_at(place) as usize)
    }

    /// The number of the brick at `place`, or `NOWHERE`.
    #[inline(always)]
    pub(super) fn number_at(&self, place: [i32; 3]) -> u32 {
        let key = key_of(place);
        let mut slot = hash(key) & (self.table.len() - 1);
        loop {
            let (found, number) = self.table[slot];
            if found == key {
                return number;
            }
            if found == VACANT {
                return Self::NOWHERE;
            }
            slot = (slot + 1) & (self.table.len() - 1);
        }
    }

    /// The edge of a brick [m].
    #[inline(always)]
    pub fn brick_m(&self) -> f32 {
        self.voxel_m * EDGE as f32
    }

    /// The centre of a brick [m].
    #[inline(always)]
    pub fn centre(&self, brick: &Brick) -> [f32; 3] {
        brick.place.map(|c| (c as f32 + 0.5) * self.brick_m())
    }

    /// The memory it holds [bytes].
    pub fn bytes(&self) -> usize {
        self.bricks.capacity() * size_of::<Brick>() + self.table.capacity() * size_of::<(u64, u32)>()
    }
}

/// A brick while it is filled.
struct Filling {
    key: u64,
    place: [i32; 3],
    mask: u64,
    /// Per voxel its number in the order of first returns.
    numbers: [u32; 64],
}

/// Sorts the returns between the range limits into voxels.
///
/// Returns are added in the scan's order, so the result depends on nothing else.
pub(super) fn thin(scan: ScanView<'_>, config: &PreparationConfig) -> Thinned {
    let mut builder = Builder::new(config, scan.points.len());
    let (least_sq, most_sq) =
        ((config.min_range_m * config.min_range_m) as f32, (config.max_range_m * config.max_range_m) as f32);
    for point in scan.points {
        // A comparison with NaN is false, so empty cells fall out here.
        let range_sq = point.x * point.x + point.y * point.y + point.z * point.z;
        if range_sq >= least_sq && range_sq <= most_sq {
            builder.add([point.x, point.y, point.z]);
        }
    }
    builder.finish()
}

struct Builder {
    voxel_m: f32,
    per_metre: f32,
    table: Vec<(u64, u32)>,
    bricks: Vec<Filling>,
    moments: Vec<Moments>,
    /// The brick of the last return: most often also that of the next.
    last: (u64, u32),
}

impl Builder {
    fn new(config: &PreparationConfig, points: usize) -> Self {
        let slots = (points / 8).next_power_of_two().max(64);
        Self {
            voxel_m: config.voxel_m as f32,
            per_metre: (1.0 / config.voxel_m) as f32,
            table: vec![(VACANT, 0); slots],
            bricks: Vec::with_capacity(slots / 2),
            moments: Vec::with_capacity(points / 3),
            last: (VACANT, 0),
        }
    }

    #[inline(always)]
    fn add(&mut self, point: [f32; 3]) {
        let scale = self.per_metre;
        let cell = [floor(point[0] * scale), floor(point[1] * scale), floor(point[2] * scale)];
        let place = [cell[0] >> 2, cell[1] >> 2, cell[2] >> 2];
        let key = key_of(place);
        if key != self.last.0 {
            self.last = (key, self.brick(key, place));
        }
        let brick = &mut self.bricks[self.last.1 as usize];
        let index = (cell[0] & 3) | (cell[1] & 3) << 2 | (cell[2] & 3) << 4;
        let bit = 1_u64 << index;
        if brick.mask & bit == 0 {
            brick.mask |= bit;
            brick.numbers[index as usize] = self.moments.len() as u32;
            self.moments.push(Moments::default());
        }
        let moments = &mut self.moments[brick.numbers[index as usize] as usize];
        if moments.count < MOST_RETURNS {
            // About the centre of the voxel, where the sums are smallest and so most exact.
            let offset = |k: usize| point[k] - (cell[k] as f32 + 0.5) * self.voxel_m;
            moments.add([offset(0), offset(1), offset(2)]);
        }
    }

    /// The number of the brick with this key, a new one if there is none.
    fn brick(&mut self, key: u64, place: [i32; 3]) -> u32 {
        if 2 * self.bricks.len() >= self.table.len() {
            self.grow();
        }
        let mut slot = hash(key) & (self.table.len() - 1);
        loop {
            match self.table[slot] {
                (found, number) if found == key => return number,
                (VACANT, _) => {
                    let number = self.bricks.len() as u32;
                    self.table[slot] = (key, number);
                    self.bricks.push(Filling { key, place, mask: 0, numbers: [0; 64] });
                    return number;
                }
                _ => slot = (slot + 1) & (self.table.len() - 1),
            }
        }
    }

    fn grow(&mut self) {
        let keys = self.bricks.iter().map(|b| b.key);
        self.table = table_of(keys, 2 * self.table.len());
    }

    /// Puts the bricks in order and the voxels after them.
    fn finish(self) -> Thinned {
        let mut order: Vec<(u64, u32)> =
            self.bricks.iter().zip(0..).map(|(brick, number)| (z_curve(brick.place), number)).collect();
        order.sort_unstable();
        let table = table_of(order.iter().map(|(_, number)| self.bricks[*number as usize].key), self.table.len());
        let mut bricks = Vec::with_capacity(order.len());
        let mut moments = Vec::with_capacity(self.moments.len());
        for (_, number) in order {
            let filling = &self.bricks[number as usize];
            bricks.push(Brick { place: filling.place, first: moments.len() as u32, mask: filling.mask });
            for index in bits(filling.mask) {
                let own = &self.moments[filling.numbers[index as usize] as usize];
                moments.push(own.shifted(from_brick_centre(index, self.voxel_m)));
            }
        }
        let voxels = Voxels { voxel_m: self.voxel_m, per_metre: self.per_metre, bricks, table };
        Thinned { voxels, moments }
    }
}

/// A voxel's centre from the centre of its brick [m].
fn from_brick_centre(index: u32, voxel_m: f32) -> [f32; 3] {
    [index & 3, index >> 2 & 3, index >> 4].map(|c| (c as f32 - 1.5) * voxel_m)
}

/// The bits that are set, lowest first, by number.
#[inline(always)]
pub(super) fn bits(mut mask: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let index = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (index < 64).then_some(index)
    })
}

/// The greatest whole number not above a value. The portable instruction set has no rounding to floor, and its library
/// call would cost more than the rest of a look-up.
#[inline(always)]
pub(crate) fn floor(value: f32) -> i32 {
    let truncated = value as i32;
    truncated.wrapping_sub(i32::from((truncated as f32) > value))
}

fn table_of(keys: impl Iterator<Item = u64>, slots: usize) -> Vec<(u64, u32)> {
    let mut table = vec![(VACANT, 0); slots];
    for (key, number) in keys.zip(0..) {
        let mut slot = hash(key) & (slots - 1);
        while table[slot].0 != VACANT {
            slot = (slot + 1) & (slots - 1);
        }
        table[slot] = (key, number);
    }
    table
}

#[inline(always)]
fn key_of(place: [i32; 3]) -> u64 {
    let axis = |k: usize| place[k].wrapping_add(AXIS_OFFSET) as u32 as u64;
    axis(0) << (2 * AXIS_BITS) | axis(1) << AXIS_BITS | axis(2)
}

/// The high bits of a product with a large odd number (Knuth, Fibonacci hashing), folded to the low ones.
#[inline(always)]
fn hash(key: u64) -> usize {
    let product = key.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (product >> 32) as usize
}

/// The place along a Z curve: the bits of the coordinates interleaved.
fn z_curve(place: [i32; 3]) -> u64 {
    let spread = |c: i32| {
        let mut v = (c + AXIS_OFFSET) as u64;
        v = (v | v << 32) & 0x1f_0000_0000_ffff;
        v = (v | v << 16) & 0x1f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    };
    let [x, y, z] = place.map(spread);
    x | y << 1 | z << 2
}

impl Thinned {
    /// The mean of the returns of each voxel [m].
    pub fn centroids(&self) -> Vec<[f32; 3]> {
        let mut centroids = Vec::with_capacity(self.moments.len());
        let mut moments = self.moments.iter();
        for brick in &self.voxels.bricks {
            let centre = self.voxels.centre(brick);
            for own in moments.by_ref().take(brick.mask.count_ones() as usize) {
                let per_return = 1.0 / own.count;
                centroids.push(std::array::from_fn(|k| centre[k] + own.sum[k] * per_return));
            }
        }
        centroids
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Point;

    #[test]
    fn returns_in_one_voxel_become_their_centroid() {
        let points = [
            Point::new(1.01, 1.01, 0.01),
            Point::EMPTY,
            Point::new(-3.0, 2.1, 0.1),
            Point::new(1.03, 1.05, 0.03),
            Point::new(0.01, 0.0, 0.0),
            Point::new(500.0, 0.0, 0.0),
        ];
        let centroids = thin(ScanView::unordered(&points), &PreparationConfig::default()).centroids();
        assert_eq!(centroids.len(), 2);
        for expected in [[-3.0, 2.1, 0.1], [1.02, 1.03, 0.02]] {
            let near = |c: &&[f32; 3]| (0..3).all(|k| (c[k] - expected[k]).abs() < 1e-6);
            assert!(centroids.iter().any(|c| near(&c)), "{expected:?} in {centroids:?}");
        }
    }

    proptest::proptest! {
        #[test]
        fn floor_is_floor(value in -1e6f32..1e6) {
            proptest::prop_assert_eq!(floor(value), f64::from(value).floor() as i32);
        }
    }

    #[test]
    fn every_brick_is_found_at_its_place_and_nowhere_else() {
        let points: Vec<Point> = (0..5000)
            .map(|k| k as f32)
            .map(|k| Point::new(40.0 * (k * 0.7).sin(), 40.0 * (k * 1.3).cos(), 5.0 * (k * 0.1).sin()))
            .collect();
        let thinned = thin(ScanView::unordered(&points), &PreparationConfig::default());
        let bricks = &thinned.voxels.bricks;
        for (number, brick) in bricks.iter().enumerate() {
            assert_eq!(thinned.voxels.number_at(brick.place), number as u32);
        }
        assert_eq!(thinned.voxels.number_at([1000, 0, 0]), Voxels::NOWHERE);
        let voxels: u32 = bricks.iter().map(|b| b.mask.count_ones()).sum();
        assert_eq!(voxels as usize, thinned.moments.len());
        let returns: f32 = thinned.moments.iter().map(|m| m.count).sum();
        assert_eq!(returns, 5000.0);
    }
}
