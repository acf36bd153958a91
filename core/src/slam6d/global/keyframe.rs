//! What is kept of every accepted scan: its reduced points, packed.
//!
//! A keyframe is the points of [`PreparedScan::points`] in 8 bytes each, nothing else: the index and the normals, five
//! times as large, are made again when a pair needs them. Preparing is a pure function of the packed points, so a
//! restarted process that reads them from a file gets the same alignments to the last bit.

use thiserror::Error;

use super::footprint::Footprint;
use crate::registration::{PrepareError, PreparedScan, Registration};
use crate::scan::{Point, ScanView};

/// Bits of a packed coordinate.
const BITS: u32 = 21;
/// The finest step of a packed coordinate [m]: an eighth of a millimetre reaches to 131 m.
const FINEST_STEP_M: f32 = 1.25e-4;
/// The share of the points that lie within the keyframe's range.
const RANGE_SHARE: f64 = 0.8;
/// Marks the bytes of a keyframe, with the version of their layout.
const MAGIC: [u8; 8] = *b"MIRKEY\0\x01";

/// The reduced points of a scan, packed, with what tells where it may overlap others.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Keyframe {
    /// The step of the packed coordinates [m].
    step_m: f32,
    /// Three coordinates of 21 bits each, in the order of the reduced points.
    packed: Box<[u64]>,
    footprint: Footprint,
    range_m: f64,
}

/// Why bytes are not a keyframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum KeyframeError {
    /// They do not begin as a keyframe of this version does, or their length is another than they say.
    #[error("these are not the bytes of a keyframe of this version")]
    Layout,
    /// They were changed.
    #[error("the bytes of the keyframe are damaged: their checksum is another")]
    Checksum,
}

impl Keyframe {
    /// Packs the reduced points of a scan.
    pub fn new(points: &[[f32; 3]]) -> Self {
        let largest = points.iter().flatten().fold(0.0_f32, |largest, value| largest.max(value.abs()));
        // One step less than half the range of the bits, so that rounding stays inside.
        let step_m = FINEST_STEP_M.max(largest / ((1 << (BITS - 1)) - 2) as f32);
        let packed = points.iter().map(|point| pack(point, step_m)).collect();
        Self::from_packed(step_m, packed)
    }

    /// Everything else follows from the packed points, so that it is the same before and after a restart.
    fn from_packed(step_m: f32, packed: Box<[u64]>) -> Self {
        let points: Vec<[f32; 3]> = packed.iter().map(|point| unpack(*point, step_m)).collect();
        let mut ranges: Vec<f64> =
            points.iter().map(|p| f64::from(p[0]).hypot(p[1].into()).hypot(p[2].into())).collect();
        let index = ((ranges.len() as f64 * RANGE_SHARE) as usize).min(ranges.len().saturating_sub(1));
        let range_m = if ranges.is_empty() { 0.0 } else { *ranges.select_nth_unstable_by(index, f64::total_cmp).1 };
        Self { step_m, packed, footprint: Footprint::new(&points), range_m }
    }

    /// The points, unpacked.
    pub fn points(&self) -> Vec<[f32; 3]> {
        self.packed.iter().map(|point| unpack(*point, self.step_m)).collect()
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.packed.len()
    }

    /// Where the points lie, coarsely.
    pub fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// The range within which four fifths of the points lie [m].
    pub fn range_m(&self) -> f64 {
        self.range_m
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.packed) + self.footprint.heap_bytes()
    }

    /// What registration works with, made anew from the packed points.
    pub fn prepare(&self, registration: &dyn Registration) -> Result<Box<dyn PreparedScan>, PrepareError> {
        let points: Vec<Point> = self.points().into_iter().map(|[x, y, z]| Point::new(x, y, z)).collect();
        registration.prepare(ScanView::unordered(&points))
    }

    /// The keyframe as bytes: mark, step, number of points, points, checksum; little-endian.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(24 + 8 * self.packed.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&self.step_m.to_le_bytes());
        bytes.extend_from_slice(&(self.packed.len() as u32).to_le_bytes());
        for point in &self.packed {
            bytes.extend_from_slice(&point.to_le_bytes());
        }
        let sum = checksum(&bytes);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// The keyframe of [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`KeyframeError`] for any other bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, KeyframeError> {
        let (content, sum) = bytes.split_last_chunk::<8>().ok_or(KeyframeError::Layout)?;
        let rest = content.strip_prefix(&MAGIC).ok_or(KeyframeError::Layout)?;
        let (step, rest) = rest.split_first_chunk::<4>().ok_or(KeyframeError::Layout)?;
        let (count, rest) = rest.split_first_chunk::<4>().ok_or(KeyframeError::Layout)?;
        let (points, tail) = rest.as_chunks::<8>();
        if !tail.is_empty() || points.len() as u64 != u64::from(u32::from_le_bytes(*count)) {
            return Err(KeyframeError::Layout);
        }
        if checksum(content) != u64::from_le_bytes(*sum) {
            return Err(KeyframeError::Checksum);
        }
        let packed = points.iter().map(|point| u64::from_le_bytes(*point)).collect();
        Ok(Self::from_packed(f32::from_le_bytes(*step), packed))
    }
}

/// Three coordinates in steps, each moved to be positive.
fn pack(point: &[f32; 3], step_m: f32) -> u64 {
    let half = 1_i64 << (BITS - 1);
    point.iter().fold(0, |packed, value| {
        let steps = (f64::from(*value) / f64::from(step_m)).round() as i64;
        packed << BITS | (steps + half).clamp(0, (1 << BITS) - 1) as u64
    })
}

fn unpack(packed: u64, step_m: f32) -> [f32; 3] {
    let half = 1_i64 << (BITS - 1);
    [2, 1, 0].map(|axis| {
        let steps = (packed >> (axis * BITS) & ((1 << BITS) - 1)) as i64 - half;
        (steps as f64 * f64::from(step_m)) as f32
    })
}

/// FNV-1a over words of 8 bytes: tells a torn or overwritten file, nothing more is asked of it.
fn checksum(bytes: &[u8]) -> u64 {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |word: u64| sum = (sum ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(23);
    let (words, rest) = bytes.as_chunks::<8>();
    words.iter().for_each(|word| add(u64::from_le_bytes(*word)));
    rest.iter().for_each(|byte| add(u64::from(*byte)));
    sum
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_packed_point_is_off_by_no_more_than_half_a_step(
            p in prop::array::uniform3(-120.0..120.0_f32), far in 1.0..80.0_f32,
        ) {
            let points = [p, p.map(|v| v * far)];
            let keyframe = Keyframe::new(&points);
            for (packed, point) in keyframe.packed.iter().zip(&points) {
                let back = unpack(*packed, keyframe.step_m);
                for (a, b) in back.iter().zip(point) {
                    prop_assert!((a - b).abs() <= 0.51 * keyframe.step_m + b.abs() * 1e-6, "{a} {b}");
                }
            }
        }

        #[test]
        fn a_keyframe_comes_back_from_its_bytes_and_from_no_changed_ones(
            points in prop::collection::vec(prop::array::uniform3(-50.0..50.0_f32), 0..40), at in 0..1000_usize,
        ) {
            let keyframe = Keyframe::new(&points);
            let mut bytes = keyframe.to_bytes();
            prop_assert_eq!(Keyframe::from_bytes(&bytes), Ok(keyframe));
            let at = at % bytes.len();
            bytes[at] ^= 0x10;
            prop_assert!(Keyframe::from_bytes(&bytes).is_err());
            prop_assert!(Keyframe::from_bytes(&bytes[..at]).is_err());
        }
    }

    #[test]
    fn packing_twice_changes_nothing() {
        let points: Vec<[f32; 3]> = (0..50).map(|k| [0.37 * k as f32, -1.13 * k as f32, 0.01]).collect();
        let once = Keyframe::new(&points);
        assert_eq!(Keyframe::new(&once.points()), once);
    }

    #[test]
    fn the_range_is_that_of_most_points() {
        let mut points = vec![[3.0, 4.0, 0.0]; 9];
        points.push([90.0, 0.0, 0.0]);
        assert!((Keyframe::new(&points).range_m() - 5.0).abs() < 1e-3);
    }
}
