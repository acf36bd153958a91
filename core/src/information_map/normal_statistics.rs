//! A cell's normals, kept so that the incidence seen from any side can be predicted.

use super::bytes::{Reader, TruncatedMap};
use nalgebra::Vector3;

/// One unit of a stored normal component is 1/4096, so a stored product is in units of 2^-24.
const COMPONENT_SCALE: f32 = 4096.0;

/// The second moments of the normals in a cell: the six sums of n n^T in fixed point, 48 bytes.
///
/// They answer the root mean square of v . n for any direction v, which stands in for the mean |v . n| of (4.9). The
/// two agree exactly when the normals are parallel (the common case: ground, one wall); otherwise the rms is the
/// larger, by at most 0.5 -> 0.577 for normals of every direction. The sign of a normal is lost, so the two faces of
/// a thin wall are not told apart.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NormalStatistics {
    /// Sums of xx, xy, xz, yy, yz, zz in units of 2^-24.
    sums: [i64; 6],
}

impl NormalStatistics {
    /// Adds a unit normal.
    #[inline]
    pub(super) fn add(&mut self, normal: &Vector3<f32>) {
        // A float to integer cast saturates and sends NaN to 0; a component of a unit vector fits 13 bits.
        let stored = |c: f32| i64::from((c.clamp(-1.0, 1.0) * COMPONENT_SCALE) as i32);
        let (x, y, z) = (stored(normal.x), stored(normal.y), stored(normal.z));
        let [xx, xy, xz, yy, yz, zz] = &mut self.sums;
        *xx += x * x;
        *xy += x * y;
        *xz += x * z;
        *yy += y * y;
        *yz += y * z;
        *zz += z * z;
    }

    /// The mean of n n^T over `count` normals as xx, xy, xz, yy, yz, zz; zero when there are none.
    #[must_use]
    pub fn mean_moments(&self, count: u64) -> [f32; 6] {
        let scale = 1.0 / (f64::from(COMPONENT_SCALE) * f64::from(COMPONENT_SCALE) * (count.max(1) as f64));
        self.sums.map(|sum| (sum as f64 * scale) as f32)
    }

    /// The expected incidence |v . n| over `count` normals for the unit direction `v`, in [0, 1] (4.9).
    #[must_use]
    pub fn expected_incidence(&self, count: u64, v: &Vector3<f32>) -> f32 {
        incidence(&self.mean_moments(count), v)
    }

    pub(super) fn write(&self, out: &mut Vec<u8>) {
        for sum in self.sums {
            out.extend_from_slice(&sum.to_le_bytes());
        }
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, TruncatedMap> {
        let mut statistics = Self::default();
        for sum in &mut statistics.sums {
            *sum = i64::from_le_bytes(reader.array()?);
        }
        Ok(statistics)
    }

    /// Whether the sums can come from `count` normals: no sum exceeds one unit each, and squares are not negative.
    pub(super) fn is_possible(&self, count: u64) -> bool {
        let limit = i128::from(count) << 24;
        let [xx, _, _, yy, _, zz] = self.sums;
        self.sums.iter().all(|&sum| i128::from(sum).abs() <= limit) && xx >= 0 && yy >= 0 && zz >= 0
    }
}

/// The root mean square of v . n, given the mean moments as xx, xy, xz, yy, yz, zz.
#[must_use]
pub fn incidence(moments: &[f32; 6], v: &Vector3<f32>) -> f32 {
    let [xx, xy, xz, yy, yz, zz] = *moments;
    let square =
        xx * v.x * v.x + yy * v.y * v.y + zz * v.z * v.z + 2.0 * (xy * v.x * v.y + xz * v.x * v.z + yz * v.y * v.z);
    square.clamp(0.0, 1.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn parallel_normals_give_the_exact_incidence() {
        let mut statistics = NormalStatistics::default();
        for _ in 0..100 {
            statistics.add(&Vector3::z());
        }
        let v = Vector3::new(0.8, 0.0, -0.6);
        assert!((statistics.expected_incidence(100, &v) - 0.6).abs() < 1e-4);
        assert!(statistics.expected_incidence(100, &Vector3::x()) < 1e-4);
    }

    #[test]
    fn a_cell_without_normals_has_no_incidence() {
        assert_eq!(NormalStatistics::default().expected_incidence(0, &Vector3::z()), 0.0);
    }

    proptest! {
        #[test]
        fn the_incidence_is_an_upper_bound_of_the_mean_and_close_to_it(
            normals in prop::collection::vec((-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32), 1..40),
            view in (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32),
        ) {
            let unit = |(x, y, z): (f32, f32, f32)| Vector3::new(x, y, z).try_normalize(0.05);
            let Some(v) = unit(view) else { return Ok(()) };
            let normals: Vec<_> = normals.into_iter().filter_map(unit).collect();
            prop_assume!(!normals.is_empty());
            let mut statistics = NormalStatistics::default();
            normals.iter().for_each(|n| statistics.add(n));
            let count = normals.len() as f32;
            let mean = normals.iter().map(|n| n.dot(&v).abs()).sum::<f32>() / count;
            let rms = (normals.iter().map(|n| n.dot(&v).powi(2)).sum::<f32>() / count).sqrt();
            let predicted = statistics.expected_incidence(normals.len() as u64, &v);
            prop_assert!((predicted - rms).abs() < 0.03, "{predicted} {rms}");
            prop_assert!(predicted > mean - 0.03);
            prop_assert!(statistics.is_possible(normals.len() as u64));
        }
    }
}
