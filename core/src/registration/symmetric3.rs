//! Symmetric 3x3 matrices in single precision: covariances of surface points and their inverses.

/// A symmetric 3x3 matrix: xx, xy, xz, yy, yz, zz.
pub(super) type Symmetric3 = [f32; 6];

/// The variance along a surface's normal, of one along the surface: 1e-3 as in Segal, Haehnel, Thrun (2009).
pub(super) const FLATNESS: f32 = 1e-3;

/// The covariance of a surface point as generalised ICP has it: `1 - (1 - e) n n^T`, e the flatness; the identity where
/// there is no normal.
#[inline(always)]
pub(super) fn surface_covariance(n: [f32; 3]) -> Symmetric3 {
    let s = 1.0 - FLATNESS;
    [
        1.0 - s * n[0] * n[0],
        -s * n[0] * n[1],
        -s * n[0] * n[2],
        1.0 - s * n[1] * n[1],
        -s * n[1] * n[2],
        1.0 - s * n[2] * n[2],
    ]
}

/// The inverse of a symmetric positive definite matrix, times `scale`.
#[inline(always)]
pub(super) fn inverse([a, b, c, d, e, f]: Symmetric3, scale: f32) -> Symmetric3 {
    let (co_a, co_b, co_c) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let per_determinant = scale / (a * co_a + b * co_b + c * co_c);
    [
        co_a * per_determinant,
        co_b * per_determinant,
        co_c * per_determinant,
        (a * f - c * c) * per_determinant,
        (b * c - a * e) * per_determinant,
        (a * d - b * b) * per_determinant,
    ]
}

/// `v^T M v`.
#[inline(always)]
pub(super) fn quadratic(m: &Symmetric3, v: [f32; 3]) -> f32 {
    let [x, y, z] = v;
    m[0] * x * x + m[3] * y * y + m[5] * z * z + 2.0 * (m[1] * x * y + m[2] * x * z + m[4] * y * z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    fn full([a, b, c, d, e, f]: Symmetric3) -> Matrix3<f32> {
        Matrix3::new(a, b, c, b, d, e, c, e, f)
    }

    proptest! {
        #[test]
        fn the_inverse_of_two_surfaces_covariances_undoes_them(
            a in prop::array::uniform3(-1.0..1.0f32), b in prop::array::uniform3(-1.0..1.0f32),
        ) {
            let unit = |v| Vector3::from(v).try_normalize(1e-3).unwrap_or(Vector3::x());
            let (first, second) = (surface_covariance(unit(a).into()), surface_covariance(unit(b).into()));
            let sum: Symmetric3 = std::array::from_fn(|k| first[k] + second[k]);
            let product = full(sum) * full(inverse(sum, 2.0));
            prop_assert!((product - Matrix3::identity() * 2.0).norm() < 0.02, "{}", product);
            let v = [0.3, -0.2, 0.9];
            let expected = Vector3::from(v).dot(&(full(sum) * Vector3::from(v)));
            prop_assert!((quadratic(&sum, v) - expected).abs() < 1e-5);
        }
    }
}
