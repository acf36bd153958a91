//! Covariances in messages: 36 numbers, row-major.

use mirador_core::geometry::Covariance;

pub(crate) fn covariance_from_rows(rows: &[f64; 36]) -> Covariance {
    Covariance::from_row_slice(rows)
}

pub(crate) fn rows_from_covariance(covariance: &Covariance) -> [f64; 36] {
    std::array::from_fn(|k| covariance[(k / 6, k % 6)])
}
