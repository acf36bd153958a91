//! What quality will a scan find? D (3.27) with the D_A and D_I that it will measure (4.8, 4.9), for eight cells at once.

use super::config::ScannerModel;
use super::tile_digest::{SIDE, TileBounds, TileCells};

/// Cells computed together.
const LANES: usize = 8;

/// Predicts quality. D_A = min(1, A_max |v.n| / (r^2 dp dt cos el)), the calibrated form of (4.8); D_I = |v.n|, the root
/// mean square over the cell's normals.
#[derive(Debug, Clone, Copy)]
pub(super) struct QualityModel {
    /// The square of A_max / (res_p res_t) [1/m^4].
    resolution: f32,
    /// The squares of the normalised weights.
    area_weight: f32,
    incidence_weight: f32,
    /// The square of the tangent of the lowest beam's elevation.
    lowest_slope: f32,
}

/// Where a scanner stands over a tile: from the scanner to the middle of the tile's first cell [m].
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub x: f32,
    pub y: f32,
    /// Height of the scanner [m, map frame].
    pub eye: f32,
}

impl QualityModel {
    pub fn new(scanner: &ScannerModel) -> Self {
        let steps = scanner.azimuth_step_deg.to_radians() * scanner.elevation_step_deg.to_radians();
        let norm = scanner.area_weight.powi(2) + scanner.incidence_weight.powi(2);
        Self {
            resolution: (scanner.max_area_m2 / steps).powi(2) as f32,
            area_weight: (scanner.area_weight.powi(2) / norm) as f32,
            incidence_weight: (scanner.incidence_weight.powi(2) / norm) as f32,
            lowest_slope: scanner.lowest_elevation_deg.to_radians().tan().powi(2).min(1e30) as f32,
        }
    }

    /// The quality expected of a surface with the given mean normal moments, seen along (x, y, z) (scanner to surface
    /// [m]); 0 where no beam points.
    #[inline(always)]
    pub fn expected(&self, [x, y, z]: [f32; 3], moments: &[f32; 6]) -> f32 {
        let [xx, xy, xz, yy, yz, zz] = *moments;
        let (x2, y2, z2) = (x * x, y * y, z * z);
        let horizontal = x2 + y2;
        let range = horizontal + z2;
        // Squares throughout, so that one division and one root are enough.
        let inverse = 1.0 / (range * horizontal);
        let facing = xx * x2 + yy * y2 + zz * z2 + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
        let incidence = (facing * horizontal * inverse).clamp(0.0, 1.0);
        // r^2 cos el = r times the horizontal distance.
        let area = (self.resolution * incidence * inverse).min(1.0);
        let quality = (self.area_weight * area + self.incidence_weight * incidence).sqrt();
        let is_lit = horizontal > 0.0 && !(z < 0.0 && z2 > self.lowest_slope * horizontal);
        if is_lit { quality } else { 0.0 }
    }

    /// A quality that no cell of a tile can exceed when seen from at least `least_m` away (horizontally).
    pub fn bound(&self, bounds: &TileBounds, least_m: f32, eye: f32) -> f32 {
        if least_m <= 0.0 {
            return 1.0;
        }
        let z = (bounds.lowest - eye).abs().max((bounds.highest - eye).abs());
        // The root mean square of v.n is a norm of v: that of a sum is at most the sum of those of the parts.
        let incidence = (bounds.horizontal.sqrt() + bounds.vertical.sqrt() * z / least_m).min(1.0).powi(2);
        let area = (self.resolution * incidence / (least_m * least_m * least_m * least_m)).min(1.0);
        // A little more, for the rounding of both.
        1.0001 * (self.area_weight * area + self.incidence_weight * incidence).sqrt()
    }

    /// Sum of the quality expected less the quality so far over the cells of a tile under `mask`, improvements only
    /// (4.10).
    #[inline(always)]
    pub fn improvement(&self, cells: &TileCells, mask: &[u16; SIDE], offset: Offset, cell_m: f32) -> f32 {
        let mut sums = [0.0f32; LANES];
        for (row, &bits) in mask.iter().enumerate() {
            let y = offset.y + row as f32 * cell_m;
            for half in 0..SIDE / LANES {
                let lit = bits >> (LANES * half) & 0xff;
                if lit == 0 {
                    continue;
                }
                let first = row * SIDE + half * LANES;
                let gains =
                    self.gains(cells, first, [offset.x + (half * LANES) as f32 * cell_m, y, offset.eye], cell_m);
                for lane in 0..LANES {
                    let is_lit = lit >> lane & 1 == 1;
                    sums[lane] += if is_lit { gains[lane] } else { 0.0 };
                }
            }
        }
        let [a, b, c, d, e, f, g, h] = sums;
        ((a + e) + (b + f)) + ((c + g) + (d + h))
    }

    /// What eight cells of a row would gain, the first seen along (x, y) from a scanner at height `eye`.
    #[inline(always)]
    pub fn gains(&self, cells: &TileCells, first: usize, [x, y, eye]: [f32; 3], cell_m: f32) -> [f32; LANES] {
        let mut gains = [0.0; LANES];
        let lanes = first..first + LANES;
        let [xx, xy, xz, yy, yz, zz] = &cells.moments;
        let (xx, xy, xz) = (&xx[lanes.clone()], &xy[lanes.clone()], &xz[lanes.clone()]);
        let (yy, yz, zz) = (&yy[lanes.clone()], &yz[lanes.clone()], &zz[lanes.clone()]);
        let (height, quality) = (&cells.height[lanes.clone()], &cells.quality[lanes]);
        for k in 0..LANES {
            let ray = [x + k as f32 * cell_m, y, height[k] - eye];
            let moments = [xx[k], xy[k], xz[k], yy[k], yz[k], zz[k]];
            gains[k] = (self.expected(ray, &moments) - quality[k]).max(0.0);
        }
        gains
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn expected(ray: [f32; 3], moments: [f32; 6]) -> f32 {
        QualityModel::new(&ScannerModel::default()).expected(ray, &moments)
    }

    const LEVEL: [f32; 6] = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    const WALL: [f32; 6] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];

    #[test]
    fn the_prediction_on_ground_follows_the_calibration_table() {
        for (distance, d_a) in [(2.0, 1.0), (4.0, 0.50), (5.0, 0.25), (6.0, 0.15), (10.0, 0.03)] {
            let predicted = expected([distance, 0.0, -1.0], LEVEL);
            assert!((predicted - d_a).abs() < 0.03, "{distance} m: {predicted}");
        }
    }

    #[test]
    fn the_prediction_on_a_facing_wall_falls_under_one_half_near_eight_metres() {
        assert!(expected([4.0, 0.0, 0.0], WALL) > 0.99);
        assert!(expected([7.9, 0.0, 0.0], WALL) > 0.5 && expected([8.3, 0.0, 0.0], WALL) < 0.5);
    }

    #[test]
    fn nothing_is_promised_under_the_lowest_beam_or_edge_on() {
        assert_eq!(expected([0.3, 0.0, -1.0], LEVEL), 0.0);
        assert_eq!(expected([0.0, 0.0, -1.0], LEVEL), 0.0);
        assert_eq!(expected([5.0, 0.0, 0.0], LEVEL), 0.0);
        assert!(expected([0.6, 0.0, -1.0], LEVEL) > 0.9, "60 deg down is in the fan");
    }

    proptest! {
        #[test]
        fn squares_give_what_the_formula_says(
            x in -50.0..50.0f32, y in -50.0..50.0f32, z in -1.0..3.0f32, n in (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32),
        ) {
            let norm = (n.0 * n.0 + n.1 * n.1 + n.2 * n.2).sqrt();
            prop_assume!(norm > 0.1 && x.hypot(y) > 1.0);
            let (a, b, c) = (n.0 / norm, n.1 / norm, n.2 / norm);
            let range = x.hypot(y).hypot(z);
            let incidence = ((a * x + b * y + c * z) / range).abs();
            let step = 0.5f32.to_radians();
            let area = (0.0025 * incidence / (range * range * step * step * (x.hypot(y) / range))).min(1.0);
            let quality = ((0.93 * area).powi(2) + (0.07 * incidence).powi(2)).sqrt() / 0.93f32.hypot(0.07);
            let found = expected([x, y, z], [a * a, a * b, a * c, b * b, b * c, c * c]);
            prop_assert!((found - quality).abs() < 2e-3, "{} {}", found, quality);
        }

        #[test]
        fn no_cell_of_a_tile_exceeds_its_bound(
            cells in prop::collection::vec(((-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32), -3.0..3.0f32), 1..20),
            x in -60.0..60.0f32, y in -60.0..60.0f32, eye in -1.0..4.0f32,
        ) {
            let model = QualityModel::new(&ScannerModel::default());
            let mut bounds = TileBounds { least_quality: 0.0, horizontal: 0.0, vertical: 0.0, lowest: 99.0, highest: -99.0 };
            for ((a, b, c), height) in &cells {
                let norm = (a * a + b * b + c * c).max(1.0);
                bounds.horizontal = bounds.horizontal.max((a * a + b * b) / norm);
                bounds.vertical = bounds.vertical.max(c * c / norm);
                bounds.lowest = bounds.lowest.min(*height);
                bounds.highest = bounds.highest.max(*height);
            }
            let bound = model.bound(&bounds, x.hypot(y), eye);
            for ((a, b, c), height) in &cells {
                let norm = (a * a + b * b + c * c).max(1.0);
                let moments = [a * a, a * b, a * c, b * b, b * c, c * c].map(|m| m / norm);
                prop_assert!(model.expected([x, y, height - eye], &moments) <= bound);
            }
        }
    }
}
