//! What one voxel of the local map keeps: the sums of its points, and the plane they lie on, if they do.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Fewer points than this make no plane.
const LEAST_POINTS: f32 = 5.0;
/// A plane's thickness is at most this share of its second-longest extent (variances).
const FLATNESS: f64 = 0.1;
/// Its second-longest extent is at least this share of the longest (variances): a single line of a scanner on the
/// ground is no plane, whatever its fit says.
const BREADTH: f64 = 0.03;
/// The thickness at which a plane counts half [m]: grass and rough walls guide less than smooth ones.
const HALF_WEIGHT_THICKNESS_M: f64 = 0.06;
/// So many points are remembered; then the older half fades, so that what has moved away is forgotten.
const MOST_POINTS: f32 = 400.0;

/// The plane of one voxel, as the registration wants it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surfel {
    /// Unit normal, map axes; zero where the points lie on no plane.
    pub normal: [f32; 3],
    /// Mean of the points from the voxel's lowest corner [m].
    pub mean: [f32; 3],
    /// How much a pair with it counts, 0 to 1; 0 where there is no plane.
    pub weight: f32,
}

impl Surfel {
    pub const NONE: Self = Self { normal: [0.0; 3], mean: [0.0; 3], weight: 0.0 };
}

/// First and second moments of a voxel's points about its lowest corner.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    count: f32,
    first: [f32; 3],
    second: [f32; 6],
    /// Points have come since the last fit.
    pub changed: bool,
}

impl Moments {
    /// The bytes of the sums.
    pub const BYTES: usize = 40;

    /// The sums as bytes, little-endian.
    pub fn write(&self, out: &mut Vec<u8>) {
        let values = [self.count].into_iter().chain(self.first).chain(self.second);
        values.for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }

    /// The sums that [`Self::write`] wrote.
    pub fn read(bytes: &[u8; Self::BYTES]) -> Self {
        let mut values = [0.0; Self::BYTES / 4];
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*bytes);
        }
        let [count, x, y, z, xx, xy, xz, yy, yz, zz] = values;
        Self { count, first: [x, y, z], second: [xx, xy, xz, yy, yz, zz], changed: false }
    }

    /// Adds a point, given from the voxel's lowest corner [m].
    #[inline]
    pub fn add(&mut self, p: [f32; 3]) {
        if self.count >= MOST_POINTS {
            self.count *= 0.5;
            self.first.iter_mut().chain(&mut self.second).for_each(|v| *v *= 0.5);
        }
        self.count += 1.0;
        for (sum, value) in self.first.iter_mut().zip(p) {
            *sum += value;
        }
        let products = [p[0] * p[0], p[0] * p[1], p[0] * p[2], p[1] * p[1], p[1] * p[2], p[2] * p[2]];
        for (sum, value) in self.second.iter_mut().zip(products) {
            *sum += value;
        }
    }

    /// The plane through the points: the eigenvector of the least eigenvalue of their covariance.
    pub fn fit(&self) -> Surfel {
        let share = 1.0 / f64::from(self.count.max(1.0));
        let mean = Vector3::from(self.first).cast::<f64>() * share;
        let flat = Surfel { mean: mean.cast::<f32>().into(), ..Surfel::NONE };
        if self.count < LEAST_POINTS {
            return flat;
        }
        let s = self.second.map(|v| f64::from(v) * share);
        let about_corner = Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]);
        let covariance = about_corner - mean * mean.transpose();
        let Some((values, normal)) = least_axis(&covariance) else { return flat };
        let thickness = values[0].max(0.0);
        if thickness > FLATNESS * values[1] || values[1] < BREADTH * values[2] {
            return flat;
        }
        let half = HALF_WEIGHT_THICKNESS_M * HALF_WEIGHT_THICKNESS_M;
        Surfel { normal: normal.cast::<f32>().into(), weight: (half / (half + thickness)) as f32, ..flat }
    }
}

/// The eigenvalues of a covariance, ascending, and the unit eigenvector of the least; `None` when it is no covariance.
fn least_axis(covariance: &Matrix3<f64>) -> Option<([f64; 3], Vector3<f64>)> {
    let scale = covariance.trace();
    if !(scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let c = covariance / scale;
    // The trigonometric solution of the characteristic cubic (Smith 1961), of a matrix of trace 1.
    let off = c.m12 * c.m12 + c.m13 * c.m13 + c.m23 * c.m23;
    let third = 1.0 / 3.0;
    let spread = (c.m11 - third).powi(2) + (c.m22 - third).powi(2) + (c.m33 - third).powi(2) + 2.0 * off;
    let p = (spread / 6.0).sqrt();
    if p < 1e-9 {
        return None;
    }
    let shifted = (c - Matrix3::from_diagonal_element(third)) / p;
    let angle = (0.5 * shifted.determinant()).clamp(-1.0, 1.0).acos() / 3.0;
    let greatest = third + 2.0 * p * angle.cos();
    let least = third + 2.0 * p * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    let middle = 1.0 - greatest - least;
    // Every column of (C - middle I)(C - greatest I) lies along the eigenvector of the least; the longest is the surest.
    let rest = c - Matrix3::from_diagonal_element(least);
    let rows = [rest.row(0).transpose(), rest.row(1).transpose(), rest.row(2).transpose()];
    let crosses = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
    let [mut best, second, last] = crosses;
    for other in [second, last] {
        if other.norm_squared() > best.norm_squared() {
            best = other;
        }
    }
    let axis = match best.try_normalize(1e-9) {
        Some(axis) => axis,
        // Two equal least eigenvalues: the iterative solution picks one of the axes.
        None => {
            let eigen = SymmetricEigen::new(c);
            eigen.eigenvectors.column(eigen.eigenvalues.imin()).into()
        }
    };
    Some(([least * scale, middle * scale, greatest * scale], axis))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn too_few_points_and_lines_make_no_plane() {
        let mut moments = Moments::default();
        assert_eq!(moments.fit().weight, 0.0);
        for k in 0..40 {
            moments.add([0.02 * k as f32, 0.3, 0.4]);
            assert_eq!(moments.fit().weight, 0.0, "{k}");
        }
        let mut same = Moments::default();
        (0..40).for_each(|_| same.add([0.1, 0.2, 0.3]));
        assert_eq!(same.fit().weight, 0.0);
    }

    #[test]
    fn what_has_moved_away_is_forgotten() {
        let mut moments = Moments::default();
        let mut add = |z: f32, n: usize| {
            (0..n).for_each(|k| moments.add([(k % 17) as f32 / 17.0, (k % 13) as f32 / 13.0, z]));
            moments.fit()
        };
        add(0.1, 2000);
        let after = add(0.6, 4000);
        assert!((after.mean[2] - 0.6).abs() < 1e-3 && after.weight > 0.9, "{after:?}");
    }

    proptest! {
        #[test]
        fn the_normal_of_a_tilted_patch_is_found(
            normal in prop::array::uniform3(-1.0..1.0f64),
            uv in prop::collection::vec(prop::array::uniform2(-0.4..0.4f64), 20..60),
        ) {
            let normal = Vector3::from(normal);
            prop_assume!(normal.norm() > 0.1);
            let normal = normal.normalize();
            let u = normal.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
            let v = normal.cross(&u);
            let mut moments = Moments::default();
            for [a, b] in &uv {
                moments.add((Vector3::repeat(0.5) + u * *a + v * *b).cast::<f32>().into());
            }
            let surfel = moments.fit();
            prop_assert!(surfel.weight > 0.99, "{surfel:?}");
            let found = Vector3::from(surfel.normal).cast::<f64>();
            prop_assert!(found.dot(&normal).abs() > 0.9999, "{found} {normal}");
        }

        #[test]
        fn the_closed_form_agrees_with_the_iterative_one(a in prop::array::uniform9(-1.0..1.0f64)) {
            let a = Matrix3::from_row_slice(&a);
            let covariance = a * a.transpose();
            let eigen = SymmetricEigen::new(covariance);
            let mut expected: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
            expected.sort_by(f64::total_cmp);
            let (values, axis) = least_axis(&covariance).unwrap();
            for (value, expected) in values.iter().zip(&expected) {
                prop_assert!((value - expected).abs() < 1e-7 * covariance.trace());
            }
            prop_assume!(expected[1] - expected[0] > 1e-3);
            prop_assert!((covariance * axis - axis * values[0]).norm() < 1e-5 * covariance.trace());
        }
    }
}
