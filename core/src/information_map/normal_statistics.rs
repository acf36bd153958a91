//! A cell's normals, kept so that the incidence seen from any side can be predicted.

use nalgebra::Vector3;

/// One unit of a stored normal component is 1/127.
const COMPONENT_SCALE: f32 = 127.0;

/// A unit normal in three bytes, within half a degree.
pub(super) type StoredNormal = [i8; 3];

/// A unit normal as stored.
#[inline(always)]
pub(super) fn store(normal: &Vector3<f32>) -> StoredNormal {
    // A float to integer cast saturates and sends NaN to 0.
    let stored = |c: f32| (c.clamp(-1.0, 1.0) * COMPONENT_SCALE + 0.5f32.copysign(c)) as i8;
    [stored(normal.x), stored(normal.y), stored(normal.z)]
}

/// The second moments of the normals in a cell: five sums of n n^T in fixed point, 40 bytes. The sixth follows, since
/// normals have length one.
///
/// They answer the root mean square of v . n for any direction v, which stands in for the mean |v . n| of (4.9). The
/// two agree exactly when the normals are parallel (the common case: ground, one wall); otherwise the rms is the
/// larger, by at most 0.5 -> 0.577 for normals of every direction. The sign of a normal is lost, so the two faces of
/// a thin wall are not told apart.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NormalStatistics {
    /// Sums of xx, xy, xz, yy, yz in units of 127^-2.
    sums: [i64; 5],
}

impl NormalStatistics {
    /// Adds a normal `weight` times; a negative weight takes it away again.
    #[inline]
    pub(super) fn add(&mut self, normal: StoredNormal, weight: i64) {
        let (x, y, z) = (i64::from(normal[0]), i64::from(normal[1]), i64::from(normal[2]));
        let [xx, xy, xz, yy, yz] = &mut self.sums;
        *xx += weight * (x * x);
        *xy += weight * (x * y);
        *xz += weight * (x * z);
        *yy += weight * (y * y);
        *yz += weight * (y * z);
    }

    /// Adds what other statistics say.
    pub(super) fn merge(&mut self, other: &Self) {
        for (sum, other) in self.sums.iter_mut().zip(&other.sums) {
            *sum += other;
        }
    }

    /// The mean of n n^T over `weight` normals as xx, xy, xz, yy, yz, zz; zero when there are none.
    #[must_use]
    pub fn mean_moments(&self, weight: u64) -> [f32; 6] {
        if weight == 0 {
            return [0.0; 6];
        }
        let scale = 1.0 / (f64::from(COMPONENT_SCALE) * f64::from(COMPONENT_SCALE) * weight as f64);
        let [xx, xy, xz, yy, yz] = self.sums;
        let mean = |sum: i64| (sum as f64 * scale) as f32;
        let (xx, yy) = (mean(xx), mean(yy));
        [xx, mean(xy), mean(xz), yy, mean(yz), (1.0 - xx - yy).max(0.0)]
    }

    /// The expected incidence |v . n| over `weight` normals for the unit direction `v`, in [0, 1] (4.9).
    #[must_use]
    pub fn expected_incidence(&self, weight: u64, v: &Vector3<f32>) -> f32 {
        incidence(&self.mean_moments(weight), v)
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
        statistics.add(store(&Vector3::z()), 100);
        let v = Vector3::new(0.8, 0.0, -0.6);
        assert!((statistics.expected_incidence(100, &v) - 0.6).abs() < 1e-4);
        assert!(statistics.expected_incidence(100, &Vector3::x()) < 1e-4);
    }

    #[test]
    fn a_cell_without_normals_has_no_incidence() {
        assert_eq!(NormalStatistics::default().expected_incidence(0, &Vector3::z()), 0.0);
    }

    #[test]
    fn what_is_taken_away_leaves_nothing_behind() {
        let mut statistics = NormalStatistics::default();
        let normals = [Vector3::new(0.6, -0.8, 0.0), Vector3::new(0.36, 0.48, 0.8)].map(|n| store(&n));
        normals.iter().for_each(|n| statistics.add(*n, 7));
        normals.iter().for_each(|n| statistics.add(*n, -7));
        assert_eq!(statistics, NormalStatistics::default());
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
            normals.iter().for_each(|n| statistics.add(store(n), 1));
            let count = normals.len() as f32;
            let mean = normals.iter().map(|n| n.dot(&v).abs()).sum::<f32>() / count;
            let square = normals.iter().map(|n| n.dot(&v).powi(2)).sum::<f32>() / count;
            let predicted = statistics.expected_incidence(normals.len() as u64, &v);
            // Three bytes a normal: the moments are right to about 1 %.
            prop_assert!((predicted.powi(2) - square).abs() < 0.02, "{predicted} {square}");
            prop_assert!(predicted.powi(2) > mean * mean - 0.02);
        }
    }
}
