//! What a scan from a candidate would bring: A (4.7), Q (4.8 to 4.10), O (4.11), as raw sums.

use super::config::{PlanningConfig, ScannerModel};
use super::grid::PlanningGrid;
use super::plan::RawGain;
use super::visibility::RayTable;
use crate::information_map::{CellIndex, InformationMap, Zone, cells_of_line, incidence};
use crate::threads;
use nalgebra::Vector3;

/// Predicts quality: D (3.27) with the D_A and D_I that a scan will measure.
#[derive(Debug, Clone, Copy)]
pub(super) struct QualityModel {
    /// A_max / (res_p res_t) [1/m^2].
    resolution: f32,
    area_weight: f32,
    incidence_weight: f32,
    /// Tangent of the lowest beam's elevation.
    lowest_slope: f32,
}

impl QualityModel {
    pub fn new(scanner: &ScannerModel) -> Self {
        let steps = scanner.azimuth_step_deg.to_radians() * scanner.elevation_step_deg.to_radians();
        let norm = scanner.area_weight.hypot(scanner.incidence_weight);
        Self {
            resolution: (scanner.max_area_m2 / steps) as f32,
            area_weight: (scanner.area_weight / norm) as f32,
            incidence_weight: (scanner.incidence_weight / norm) as f32,
            lowest_slope: scanner.lowest_elevation_deg.to_radians().tan() as f32,
        }
    }

    /// The quality expected of a surface with the given mean normal moments, seen along `ray` (scanner to surface,
    /// [m]); 0 where no beam points. D_A = min(1, A_max |v.n| / (r^2 dp dt cos el)), the calibrated form of (4.8).
    pub fn expected(&self, ray: &Vector3<f32>, moments: &[f32; 6]) -> f32 {
        let horizontal = ray.x.hypot(ray.y);
        let range = horizontal.hypot(ray.z);
        if horizontal <= 0.0 || ray.z < self.lowest_slope * horizontal {
            return 0.0;
        }
        let incidence = incidence(moments, &(ray / range));
        // r^2 cos el = r times the horizontal distance.
        let area = (self.resolution * incidence / (range * horizontal)).min(1.0);
        (self.area_weight * area).hypot(self.incidence_weight * incidence)
    }
}

/// Evaluates candidates on one grid.
pub(super) struct GainModel<'a> {
    grid: &'a PlanningGrid,
    zones: &'a [Zone],
    rays: RayTable,
    quality: QualityModel,
    scanner_height: f64,
    range_m: f64,
    /// What Q's raw sum would be over flat, never seen ground.
    pub flat_quality: f64,
    /// The area of all zones [m^2].
    pub zone_area: f64,
    /// A_ce: cells in the scanner's whole footprint.
    pub footprint_cells: f64,
}

impl<'a> GainModel<'a> {
    pub fn new(map: &'a InformationMap, grid: &'a PlanningGrid, config: &PlanningConfig) -> Self {
        let scanner = &config.scanner;
        let rays = RayTable::new((scanner.range_m / grid.cell_m).floor().max(1.0) as i32, grid.width);
        let quality = QualityModel::new(scanner);
        let level = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let (mut flat_quality, mut footprint_cells) = (0.0, 0.0);
        for step in rays.rays().flatten().filter(|step| step.is_own) {
            let ray = ray(step.dx, step.dy, grid.cell_m as f32, -scanner.height_m as f32);
            flat_quality += f64::from(quality.expected(&ray, &level));
            footprint_cells += 1.0;
        }
        Self {
            grid,
            zones: map.zones(),
            rays,
            quality,
            scanner_height: scanner.height_m,
            range_m: scanner.range_m,
            flat_quality,
            zone_area: map.zones().iter().map(|zone| zone.normal.norm()).sum(),
            footprint_cells,
        }
    }

    /// What a scan from the cell `at`, with the ground at `ground` [m, map frame], would bring.
    pub fn evaluate(&self, at: usize, ground: f64) -> RawGain {
        let eye = ground + self.scanner_height;
        let cell_m = self.grid.cell_m as f32;
        let (mut unexplored, mut known_cells, mut quality_sum) = (0u32, 0u32, 0.0f64);
        for steps in self.rays.rays() {
            for step in steps {
                // Candidates keep the scanner's range from the edge of the grid.
                let seen = at.wrapping_add_signed(step.offset);
                let flags = self.grid.flags[seen];
                if step.is_own {
                    unexplored += u32::from(flags & PlanningGrid::UNEXPLORED);
                    if flags & PlanningGrid::KNOWN != 0
                        && let Some(known) = self.grid.known(seen)
                    {
                        known_cells += 1;
                        let ray = ray(step.dx, step.dy, cell_m, known.height - eye as f32);
                        quality_sum +=
                            f64::from((self.quality.expected(&ray, &known.moments) - known.quality).max(0.0));
                    }
                }
                if flags & PlanningGrid::BLOCKS != 0 {
                    break;
                }
            }
        }
        RawGain { unexplored_cells: unexplored, known_cells, quality_sum, zone_sum: self.zones_from(at, eye) }
    }

    /// Sum over the zones in range and in view of |v . n_zone| (4.11).
    fn zones_from(&self, at: usize, eye: f64) -> f64 {
        let [x, y] = self.grid.centre(at);
        let here = self.grid.index(at);
        let seen = |zone: &&Zone| {
            let Some(there) = self.grid_cell(zone) else { return false };
            cells_of_line(here, there)
                .filter(|&cell| cell != here && cell != there)
                .all(|cell| self.grid.at(cell).is_none_or(|at| !self.grid.has(at, PlanningGrid::BLOCKS)))
        };
        let face = |zone: &Zone| {
            let ray = zone.centre.coords - Vector3::new(x, y, eye);
            let range = ray.norm();
            if range > 0.0 { zone.normal.dot(&ray).abs() / range } else { 0.0 }
        };
        let in_range = |zone: &&Zone| (zone.centre.x - x).hypot(zone.centre.y - y) <= self.range_m;
        // Not `sum`, which makes -0 of nothing.
        self.zones.iter().filter(in_range).filter(seen).map(face).fold(0.0, |sum, area| sum + area)
    }

    fn grid_cell(&self, zone: &Zone) -> Option<CellIndex> {
        let cell_m = self.grid.cell_m;
        CellIndex::containing(zone.centre.x / cell_m, zone.centre.y / cell_m)
    }
}

fn ray(dx: i16, dy: i16, cell_m: f32, dz: f32) -> Vector3<f32> {
    Vector3::new(f32::from(dx) * cell_m, f32::from(dy) * cell_m, dz)
}

/// Evaluates every place, on up to `threads` threads. Each place is computed by one thread from the same input, so
/// the result does not depend on how many there are.
pub(super) fn evaluate_all(model: &GainModel<'_>, places: &[(usize, f64)], threads: usize) -> Vec<RawGain> {
    let mut gains = vec![RawGain::default(); places.len()];
    let pairs = places.iter().zip(&mut gains);
    threads::for_each(pairs, threads.min(places.len()), |(&(at, ground), gain)| *gain = model.evaluate(at, ground));
    gains
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expected(ray: [f32; 3], moments: [f32; 6]) -> f32 {
        QualityModel::new(&ScannerModel::default()).expected(&Vector3::from(ray), &moments)
    }

    #[test]
    fn the_prediction_on_ground_follows_the_calibration_table() {
        let level = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        for (distance, d_a) in [(2.0, 1.0), (4.0, 0.50), (5.0, 0.25), (6.0, 0.15), (10.0, 0.03)] {
            let predicted = expected([distance, 0.0, -1.0], level);
            assert!((predicted - d_a).abs() < 0.03, "{distance} m: {predicted}");
        }
    }

    #[test]
    fn the_prediction_on_a_facing_wall_falls_under_one_half_near_eight_metres() {
        let wall = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!(expected([4.0, 0.0, 0.0], wall) > 0.99);
        assert!(expected([7.9, 0.0, 0.0], wall) > 0.5 && expected([8.3, 0.0, 0.0], wall) < 0.5);
    }

    #[test]
    fn nothing_is_promised_under_the_lowest_beam_or_edge_on() {
        assert_eq!(expected([0.3, 0.0, -1.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.0);
        assert_eq!(expected([0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.0);
        assert_eq!(expected([5.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.0);
    }
}
