//! What analysis says of one point: 16 bytes beside the point, under the same index.

use bytemuck::{Pod, Zeroable};
use nalgebra::Vector3;

/// The scores of one point of a scan, under the point's own index. Scores in [0, 1] are stored as `value * 65535`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct PointScore {
    /// F, the navigable-surface score (3.18).
    pub navigable: u16,
    /// B, the obstacle score (3.21).
    pub obstacle: u16,
    /// D, the quality (3.27).
    pub quality: u16,
    /// See the associated constants.
    pub flags: u16,
    /// The unit normal in the scanner's frame, turned towards the scanner, as components * 32767. Its z follows from
    /// x, y and [`PointScore::NORMAL_Z_NEGATIVE`].
    pub normal_xy: [i16; 2],
    /// A(p), the point's share of the surface [m^2] (3.12).
    pub area: f32,
}

impl PointScore {
    /// The point has a return and a normal; without this bit nothing else holds.
    pub const VALID: u16 = 1;
    /// The point lies in the wedge the robot can reach; only then are F and B scored.
    pub const REACHABLE: u16 = 1 << 1;
    /// The normal's z component is negative.
    pub const NORMAL_Z_NEGATIVE: u16 = 1 << 2;
    /// Of the quad with corners a = (r, c) = this cell, b = (r, c+1), c = (r+1, c), d = (r+1, c+1), the triangle that
    /// leaves out corner k (a = 0 .. d = 3) is kept in the mesh when bit `KEPT_WITHOUT << k` is set. At most two of the
    /// four are set. In a grid that closes on itself the last row is followed by the first and the last column by the
    /// first: r+1 and c+1 are taken modulo rows and columns. Cells of a last row or column that is not followed by the
    /// first carry none of these bits.
    pub const KEPT_WITHOUT: u16 = 1 << 4;

    /// No information: the cell has no return.
    pub const NONE: Self = Self { navigable: 0, obstacle: 0, quality: 0, flags: 0, normal_xy: [0, 0], area: 0.0 };

    /// Whether the point has a return and a normal.
    #[must_use]
    #[inline]
    pub fn is_valid(&self) -> bool {
        self.flags & Self::VALID != 0
    }

    /// Whether the robot could reach the point.
    #[must_use]
    #[inline]
    pub fn is_reachable(&self) -> bool {
        self.flags & Self::REACHABLE != 0
    }

    /// Whether the triangle of this cell's quad that leaves out corner `corner` (0..4) is kept in the mesh.
    #[must_use]
    pub fn keeps_triangle_without(&self, corner: u16) -> bool {
        self.flags & (Self::KEPT_WITHOUT << corner) != 0
    }

    /// A score in [0, 1] as stored.
    #[must_use]
    #[inline]
    pub fn quantise(score: f32) -> u16 {
        quantise_bits(score) as u16
    }

    /// A stored score in [0, 1].
    #[must_use]
    pub fn dequantise(stored: u16) -> f32 {
        f32::from(stored) / 65535.0
    }

    /// Stores a unit normal of the scanner's frame.
    #[inline]
    pub fn set_normal(&mut self, normal: &Vector3<f32>) {
        self.normal_xy = [normal.x, normal.y].map(|v| normal_bits(v) as u16 as i16);
        self.flags &= !Self::NORMAL_Z_NEGATIVE;
        if normal.z < 0.0 {
            self.flags |= Self::NORMAL_Z_NEGATIVE;
        }
    }

    /// The unit normal in the scanner's frame, within 0.01 (the error is largest where z is near zero).
    #[must_use]
    #[inline]
    pub fn normal(&self) -> Vector3<f32> {
        let x = f32::from(self.normal_xy[0]) / 32767.0;
        let y = f32::from(self.normal_xy[1]) / 32767.0;
        let z = (1.0 - x * x - y * y).max(0.0).sqrt();
        Vector3::new(x, y, if self.flags & Self::NORMAL_Z_NEGATIVE != 0 { -z } else { z })
    }
}

/// A score in [0, 1] as stored. Adding 2^23 rounds to the nearest whole number, which is then in the low bits: eight at
/// a time, where a conversion would have to look for numbers that do not fit.
#[inline(always)]
pub(super) fn quantise_bits(score: f32) -> u32 {
    (score.clamp(0.0, 1.0) * 65535.0 + 8_388_608.0).to_bits() & 0xffff
}

/// A component of a unit normal as stored, in two's complement; 1.5 * 2^23 rounds as above, below zero, too.
#[inline(always)]
pub(super) fn normal_bits(component: f32) -> u32 {
    (component * 32767.0 + 12_582_912.0).to_bits() & 0xffff
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_stored_normal_comes_back(x in -1.0..1.0f32, y in -1.0..1.0f32, z in -1.0..1.0f32) {
            let v = Vector3::new(x, y, z);
            prop_assume!(v.norm() > 0.1);
            let n = v.normalize();
            let mut score = PointScore::NONE;
            score.set_normal(&n);
            prop_assert!((score.normal() - n).norm() < 0.01);
        }

        #[test]
        fn a_stored_score_comes_back(score in 0.0..=1.0f32) {
            prop_assert!((PointScore::dequantise(PointScore::quantise(score)) - score).abs() < 1e-5);
        }
    }
}
