//! Zones of interest: where the mesh breaks over a large area, something behind the edge is hidden (3.28, 3.29).

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::config::{ScoreConfigError, check};
use crate::scan::ScanView;
use crate::surface::{DiscardedTriangle, Surface};

/// A group of edge-adjacent discarded triangles, in the scanner's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// The mean of its triangles' points [m] (3.28).
    pub centre: Point3<f32>,
    /// The sum of its triangles' normals times their areas [m^2] (3.29): the larger and flatter the zone, the longer.
    /// Every triangle's normal is turned towards the scanner: the dot product with a ray that sees the zone from the
    /// scanner's side is negative.
    pub normal: Vector3<f32>,
    /// The sum of its triangles' areas [m^2].
    pub area_m2: f32,
    /// The number of its triangles.
    pub triangles: u32,
}

/// What counts as a zone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZoneConfig {
    /// Groups below this area are no zones [m^2].
    pub zone_area_min_m2: f64,
}

impl Default for ZoneConfig {
    fn default() -> Self {
        Self { zone_area_min_m2: 1.0 }
    }
}

impl ZoneConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ScoreConfigError::OutOfRange`] names the first field outside its range.
    pub fn validate(&self) -> Result<(), ScoreConfigError> {
        check("zone_area_min_m2", self.zone_area_min_m2, self.zone_area_min_m2 >= 0.0, ">= 0")
    }
}

/// Finds the zones of one scan after the other. Its buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct ZoneFinder {
    is_grouped: Vec<bool>,
    pending: Vec<u32>,
}

impl ZoneFinder {
    /// A finder without buffers yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Replaces `out` by the zones of a scan, in the order of their first triangles; `surface` is the scan's own.
    ///
    /// # Errors
    /// [`ScoreConfigError`] when the threshold is negative or not a number.
    pub fn find(
        &mut self,
        surface: &Surface,
        scan: ScanView<'_>,
        config: &ZoneConfig,
        out: &mut Vec<Zone>,
    ) -> Result<(), ScoreConfigError> {
        config.validate()?;
        out.clear();
        let triangles = surface.discarded();
        self.is_grouped.clear();
        self.is_grouped.resize(triangles.len(), false);
        for first in 0..triangles.len() {
            if !self.is_grouped[first] {
                let zone = self.grow(first, triangles, scan);
                if f64::from(zone.area_m2) > config.zone_area_min_m2 {
                    out.push(zone);
                }
            }
        }
        Ok(())
    }

    /// The group of all triangles that can be reached from the first one across edges.
    fn grow(&mut self, first: usize, triangles: &[DiscardedTriangle], scan: ScanView<'_>) -> Zone {
        let (mut centre, mut normal, mut area, mut count) = (Vector3::<f64>::zeros(), Vector3::zeros(), 0.0, 0u32);
        self.is_grouped[first] = true;
        self.pending.clear();
        self.pending.push(first as u32);
        while let Some(index) = self.pending.pop() {
            let triangle = &triangles[index as usize];
            for point in triangle.corners.iter().filter_map(|c| scan.points.get(*c as usize)) {
                centre += point.vector().cast::<f64>();
            }
            normal += Vector3::from(triangle.area_vector).cast::<f64>();
            area += f64::from(triangle.area);
            count += 1;
            for neighbour in triangle.neighbours {
                if let Some(is_grouped) = self.is_grouped.get_mut(neighbour as usize).filter(|g| !**g) {
                    *is_grouped = true;
                    self.pending.push(neighbour);
                }
            }
        }
        let centre = (centre / (3.0 * f64::from(count))).cast::<f32>();
        Zone { centre: centre.into(), normal: normal.cast(), area_m2: area as f32, triangles: count }
    }
}

/// As [`ZoneFinder::find`], for a single scan.
///
/// # Errors
/// As [`ZoneFinder::find`].
pub fn zones(
    surface: &Surface,
    scan: ScanView<'_>,
    config: &ZoneConfig,
    out: &mut Vec<Zone>,
) -> Result<(), ScoreConfigError> {
    ZoneFinder::new().find(surface, scan, config, out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::test_scans::{Shape, TestScan, turning};
    use crate::surface::{SurfaceBuilder, SurfaceConfig};

    /// A panel 4 m ahead, in front of a wall at 10 m.
    fn panel() -> [Shape; 2] {
        [
            Shape::Plane { normal: Vector3::x(), offset: 10.0 },
            Shape::Block { from: Vector3::new(4.0, -1.0, -0.8), to: Vector3::new(4.1, 1.0, 1.2) },
        ]
    }

    fn zones_of(threshold: f64) -> (Vec<Zone>, usize) {
        let scan = turning(&panel(), 1.0, 45.0, 0.0, 16);
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
        let mut found = Vec::new();
        zones(surface, scan.view(), &ZoneConfig { zone_area_min_m2: threshold }, &mut found).unwrap();
        (found, surface.discarded().len())
    }

    #[test]
    fn the_gap_behind_a_panel_is_one_zone_around_its_edge() {
        let (found, _) = zones_of(20.0);
        assert_eq!(found.len(), 1, "{found:?}");
        let zone = found[0];
        // Four sides of 2 m over a depth of 6 m, widening to the wall.
        // They are parts of the planes through the scanner and the panel's edges: 2 of 21.65 m^2, one of 21.9, one of 21.4.
        assert!((zone.area_m2 / 86.7 - 1.0).abs() < 0.1, "{zone:?}");
        assert!(zone.centre.x > 5.0 && zone.centre.x < 9.0 && zone.centre.y.abs() < 0.5, "{zone:?}");
        assert!(zone.normal.dot(&zone.centre.coords) < 0.0);
        assert!(zone.normal.norm() <= zone.area_m2);
    }

    /// A car 4 m ahead on the ground, in front of a wall at 10 m.
    fn car() -> [Shape; 3] {
        [
            crate::surface::test_scans::ground(1.0),
            Shape::Plane { normal: Vector3::x(), offset: 10.0 },
            Shape::Block { from: Vector3::new(4.0, -2.1, -1.0), to: Vector3::new(5.8, 2.1, 0.4) },
        ]
    }

    fn zones_of_scan(scan: ScanView<'_>) -> Vec<Zone> {
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
        let mut found = Vec::new();
        zones(surface, scan, &ZoneConfig::default(), &mut found).unwrap();
        found
    }

    #[test]
    fn what_a_car_hides_of_a_wall_is_one_zone_on_the_planes_between_them() {
        let scan = turning(&car(), 0.5, 45.0, 0.01, 17);
        let found = zones_of_scan(scan.view());
        assert_eq!(found.len(), 1, "{found:?}");
        let zone = found[0];
        // Over the roof: half of 4.2 m times 4.02 m, scaled to the wall, less itself: 44.3 m^2. Beside each flank, where rays
        // end on the wall or on the ground before it: 11.5 m^2.
        assert!((zone.area_m2 / 67.3 - 1.0).abs() < 0.1, "{zone:?}");
        assert!(zone.centre.x > 5.8 && zone.centre.x < 10.0 && zone.centre.y.abs() < 0.3, "{zone:?}");
        // The flanks cancel; what is left is the plane over the roof, which hides from 1 m over the ground upwards.
        assert!(
            zone.normal.y.abs() < 0.1 * zone.normal.norm() && zone.normal.dot(&zone.centre.coords) < 0.0,
            "{zone:?}"
        );
    }

    #[test]
    fn a_zone_turns_with_the_scene() {
        let turned = |scan: &mut TestScan, sign: f32| {
            let rotation = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), sign * 0.7);
            for point in scan.points.iter_mut().filter(|p| p.is_return()) {
                let p = rotation * point.vector();
                (point.x, point.y, point.z) = (p.x, p.y, p.z);
            }
        };
        let mut scan = turning(&car(), 0.5, 45.0, 0.0, 18);
        let straight = zones_of_scan(scan.view());
        turned(&mut scan, 1.0);
        let found = zones_of_scan(scan.view());
        assert_eq!((straight.len(), found.len()), (1, 1));
        let rotation = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7f32);
        assert!((rotation * straight[0].centre - found[0].centre).norm() < 0.05, "{straight:?} {found:?}");
        assert!((rotation * straight[0].normal - found[0].normal).norm() < 0.05 * found[0].normal.norm());
    }

    #[test]
    fn a_cloud_without_order_has_the_zones_of_the_scan_it_was() {
        let scan = turning(&car(), 0.5, 45.0, 0.0, 19);
        let cloud: Vec<_> = scan.points.iter().rev().filter(|p| p.is_return()).copied().collect();
        let found = zones_of_scan(ScanView::unordered(&cloud));
        let area: f32 = found.iter().map(|zone| zone.area_m2).sum();
        // Points that share a cell leave gaps along the edge, which may break a zone into several.
        assert!((area / 67.3 - 1.0).abs() < 0.25, "{found:?}");
        assert!(found.iter().all(|z| z.centre.x > 4.0 && z.centre.x < 10.5 && z.centre.y.abs() < 6.0), "{found:?}");
    }

    #[test]
    fn every_discarded_triangle_belongs_to_exactly_one_group() {
        let (found, triangles) = zones_of(0.0);
        assert_eq!(found.iter().map(|z| z.triangles as usize).sum::<usize>(), triangles);
    }

    #[test]
    fn a_scan_without_jumps_has_no_zones_and_a_negative_threshold_is_refused() {
        let mut found = Vec::new();
        let scan = ScanView::unordered(&[]);
        assert_eq!(zones(&Surface::default(), scan, &ZoneConfig::default(), &mut found), Ok(()));
        assert!(found.is_empty());
        assert!(zones(&Surface::default(), scan, &ZoneConfig { zone_area_min_m2: -1.0 }, &mut found).is_err());
    }
}
