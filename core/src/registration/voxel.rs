//! Thinning: the returns in one voxel become their centroid.

use super::PreparationConfig;
use crate::scan::ScanView;

/// Bits of one voxel coordinate in a key.
const AXIS_BITS: u32 = 21;
/// Added to a voxel coordinate to make it positive.
const AXIS_OFFSET: i64 = 1 << (AXIS_BITS - 1);

/// The centroids [m] of the voxels that hold a return between the range limits, sorted by voxel.
/// Within a voxel returns are summed in the scan's order, so the result depends on nothing else.
pub(super) fn downsample(scan: ScanView<'_>, config: &PreparationConfig) -> Vec<[f32; 3]> {
    let (min_range, max_range) = (config.min_range_m as f32, config.max_range_m as f32);
    let per_metre = 1.0 / config.voxel_m;
    let mut keyed: Vec<(u64, u32)> = Vec::with_capacity(scan.points.len());
    for (index, point) in scan.points.iter().enumerate() {
        // A comparison with NaN is false, so empty cells fall out here.
        let range_sq = point.x * point.x + point.y * point.y + point.z * point.z;
        if range_sq >= min_range * min_range && range_sq <= max_range * max_range {
            let axis = |v: f32| ((f64::from(v) * per_metre).floor() as i64 + AXIS_OFFSET) as u64;
            let key = axis(point.x) << (2 * AXIS_BITS) | axis(point.y) << AXIS_BITS | axis(point.z);
            keyed.push((key, index as u32));
        }
    }
    keyed.sort_unstable();
    keyed.chunk_by(|a, b| a.0 == b.0).map(|voxel| centroid(scan, voxel)).collect()
}

/// The mean of the points of one voxel, in double precision.
fn centroid(scan: ScanView<'_>, voxel: &[(u64, u32)]) -> [f32; 3] {
    let mut sum = [0.0_f64; 3];
    for point in voxel.iter().filter_map(|(_, index)| scan.points.get(*index as usize)) {
        sum[0] += f64::from(point.x);
        sum[1] += f64::from(point.y);
        sum[2] += f64::from(point.z);
    }
    sum.map(|s| (s / voxel.len() as f64) as f32)
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
        let thinned = downsample(ScanView::unordered(&points), &PreparationConfig::default());
        assert_eq!(thinned.len(), 2);
        assert_eq!(thinned[0], [-3.0, 2.1, 0.1]);
        assert!((thinned[1][0] - 1.02).abs() < 1e-6 && (thinned[1][1] - 1.03).abs() < 1e-6);
    }
}
