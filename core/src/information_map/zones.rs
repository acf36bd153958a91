//! Zones of interest (3.28, 3.29): places where a scan broke off, and which want to be looked at face on.

use super::grid_line::cells_of_line;
use super::map::InformationMap;
use super::navigability::CellState;
use super::scan_poses::take;
use crate::geometry::Pose;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// An occluded plane: the mean of its points, and its normal with the area as length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Zone {
    /// Mean of the points [m, map frame] (3.28).
    pub centre: Point3<f64>,
    /// Normal; its length is the area [m^2] (3.29).
    pub normal: Vector3<f64>,
}

/// When two zones are the same, and when a zone is done.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZoneConfig {
    /// Zones whose centres are nearer than this are the same place [m].
    pub merge_distance_m: f64,
    /// ... if the angle between their normals is also below this [deg].
    pub merge_angle_deg: f64,
    /// A zone is done when it was seen from nearer than this [m] ...
    pub retire_range_m: f64,
    /// ... with |v . n| of at least this, 0 to 1, ...
    pub retire_incidence: f64,
    /// ... along a line without a known cell of C_nc under this, 0 to 1.
    pub sight_threshold: f64,
}

impl Default for ZoneConfig {
    fn default() -> Self {
        Self {
            merge_distance_m: 1.0,
            merge_angle_deg: 30.0,
            retire_range_m: 50.0,
            retire_incidence: 0.5,
            sight_threshold: 0.5,
        }
    }
}

/// What one scan did to the list of zones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct ZoneUpdate {
    /// Seen face on and removed.
    pub retired: usize,
    /// Found again in the same place.
    pub merged: usize,
    /// New.
    pub added: usize,
}

/// A zone and the scan it was seen from, which it moves with.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Origin {
    scan: u64,
    /// The zone in the scanner's frame.
    zone: Zone,
}

/// The zones of all scans, each place once, in the order in which they were found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ZoneList {
    zones: Vec<Zone>,
    /// Where those of the same index come from.
    origins: Vec<Origin>,
}

impl Zone {
    fn is_same_place(&self, other: &Self, config: &ZoneConfig) -> bool {
        let cos = self.normal.dot(&other.normal).abs() / (self.normal.norm() * other.normal.norm());
        (self.centre - other.centre).norm() < config.merge_distance_m && cos > config.merge_angle_deg.to_radians().cos()
    }

    /// The zone in another frame.
    fn moved(&self, to_from_here: &Pose) -> Self {
        Self { centre: to_from_here * self.centre, normal: to_from_here.rotation * self.normal }
    }

    fn numbers(&self) -> [f64; 6] {
        let (c, n) = (&self.centre, &self.normal);
        [c.x, c.y, c.z, n.x, n.y, n.z]
    }

    fn is_usable(&self) -> bool {
        self.centre.coords.iter().chain(self.normal.iter()).all(|v| v.is_finite()) && self.normal.norm() > 0.0
    }

    /// Whether a scanner at `scanner` [m, map frame] looked at the zone face on with nothing known in between.
    pub(super) fn is_seen_face_on(&self, map: &InformationMap, scanner: &Point3<f64>, config: &ZoneConfig) -> bool {
        let ray = self.centre - scanner;
        let range = ray.norm();
        if range > config.retire_range_m
            || self.normal.dot(&ray).abs() < config.retire_incidence * range * self.normal.norm()
        {
            return false;
        }
        let cell = |p: &Point3<f64>| map.cell_containing(p.x, p.y);
        let (Some(from), Some(to)) = (cell(scanner), cell(&self.centre)) else { return false };
        cells_of_line(from, to)
            .filter(|&cell| cell != from && cell != to)
            .all(|cell| !matches!(map.state(cell), CellState::Known(c) if c < config.sight_threshold))
    }
}

impl ZoneList {
    /// The zones, in the order in which they were found.
    #[must_use]
    pub fn as_slice(&self) -> &[Zone] {
        &self.zones
    }

    /// Takes in the zones of a scan (map frame). Of two in the same place the larger is kept. Zones that are not
    /// finite or have no area are passed over. Returns how many were merged and added.
    pub fn merge(&mut self, scan: u64, seen: &[Zone], map_from_scanner: &Pose, config: &ZoneConfig) -> (usize, usize) {
        let (mut merged, mut added) = (0, 0);
        let scanner_from_map = map_from_scanner.inverse();
        for zone in seen.iter().filter(|zone| zone.is_usable()) {
            let origin = Origin { scan, zone: zone.moved(&scanner_from_map) };
            match self.zones.iter().position(|known| known.is_same_place(zone, config)) {
                Some(k) => {
                    merged += 1;
                    if zone.normal.norm_squared() > self.zones[k].normal.norm_squared() {
                        (self.zones[k], self.origins[k]) = (*zone, origin);
                    }
                }
                None => {
                    added += 1;
                    self.zones.push(*zone);
                    self.origins.push(origin);
                }
            }
        }
        (merged, added)
    }

    /// Removes the zones that are done and returns how many.
    pub fn retire(&mut self, is_done: impl Fn(&Zone) -> bool) -> usize {
        let before = self.zones.len();
        let done: Vec<bool> = self.zones.iter().map(is_done).collect();
        let mut keep = done.iter().map(|done| !done);
        self.zones.retain(|_| keep.next().unwrap_or(true));
        let mut keep = done.iter().map(|done| !done);
        self.origins.retain(|_| keep.next().unwrap_or(true));
        before - self.zones.len()
    }

    /// Moves the zones of a scan with it, always from where that scan saw them, so that errors do not add up. Returns
    /// how many there are.
    pub fn move_with(&mut self, scan: u64, map_from_scanner: &Pose) -> usize {
        let mut count = 0;
        for (zone, origin) in self.zones.iter_mut().zip(&self.origins).filter(|(_, origin)| origin.scan == scan) {
            *zone = origin.zone.moved(map_from_scanner);
            count += 1;
        }
        count
    }

    /// Appends the zones as bytes, 104 each.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&(self.zones.len() as u64).to_le_bytes());
        for (zone, origin) in self.zones.iter().zip(&self.origins) {
            out.extend_from_slice(&origin.scan.to_le_bytes());
            for value in [zone, &origin.zone].into_iter().flat_map(Zone::numbers) {
                out.extend_from_slice(&value.to_le_bytes());
            }
        }
    }

    /// Takes what [`ZoneList::write`] wrote off the front of `bytes`; `None` when it is not there or a zone is not
    /// usable.
    #[must_use]
    pub fn read(bytes: &mut &[u8]) -> Option<Self> {
        let mut list = Self::default();
        for _ in 0..u64::from_le_bytes(take(bytes)?) {
            let scan = u64::from_le_bytes(take(bytes)?);
            let mut zone = || {
                let mut values = [0.0; 6];
                for value in &mut values {
                    *value = f64::from_le_bytes(take(bytes)?);
                }
                let [cx, cy, cz, nx, ny, nz] = values;
                let zone = Zone { centre: Point3::new(cx, cy, cz), normal: Vector3::new(nx, ny, nz) };
                zone.is_usable().then_some(zone)
            };
            list.zones.push(zone()?);
            list.origins.push(Origin { scan, zone: zone()? });
        }
        Some(list)
    }
}

#[cfg(test)]
mod tests {
    use super::super::MapConfig;
    use super::*;

    fn zone(x: f64, y: f64, normal: [f64; 3]) -> Zone {
        Zone { centre: Point3::new(x, y, 1.0), normal: Vector3::from(normal) }
    }

    #[test]
    fn the_same_place_seen_twice_is_one_zone_of_the_larger_area() {
        let mut list = ZoneList::default();
        let config = ZoneConfig::default();
        assert_eq!(list.merge(0, &[zone(5.0, 0.0, [1.0, 0.0, 0.0])], &Pose::identity(), &config), (0, 1));
        assert_eq!(list.merge(1, &[zone(5.3, 0.0, [-2.0, 0.1, 0.0])], &Pose::identity(), &config), (1, 0));
        assert_eq!(list.as_slice(), &[zone(5.3, 0.0, [-2.0, 0.1, 0.0])]);
    }

    #[test]
    fn another_place_or_another_side_is_another_zone() {
        let mut list = ZoneList::default();
        let zones = [zone(5.0, 0.0, [1.0, 0.0, 0.0]), zone(5.0, 0.0, [0.0, 1.0, 0.0]), zone(8.0, 0.0, [1.0, 0.0, 0.0])];
        assert_eq!(list.merge(0, &zones, &Pose::identity(), &ZoneConfig::default()), (0, 3));
    }

    #[test]
    fn a_zone_without_area_or_place_is_passed_over() {
        let mut list = ZoneList::default();
        let zones = [zone(5.0, 0.0, [0.0; 3]), zone(f64::NAN, 0.0, [1.0, 0.0, 0.0])];
        assert_eq!(list.merge(0, &zones, &Pose::identity(), &ZoneConfig::default()), (0, 0));
    }

    #[test]
    fn a_zone_is_done_once_seen_face_on_but_not_edge_on_or_from_too_far() {
        let mut map = InformationMap::new(MapConfig::default()).unwrap();
        let config = ZoneConfig::default();
        let at = |x: f64, y: f64| Pose::translation(x, y, 1.0);
        let wall = zone(10.0, 0.0, [2.0, 0.0, 0.0]);
        map.update_zones(0, &[wall], &at(10.0, -8.0), &config);
        assert_eq!(map.zones().len(), 1);
        assert_eq!(map.update_zones(1, &[], &at(10.0, -8.0), &config).retired, 0);
        assert_eq!(map.update_zones(1, &[], &at(-60.0, 0.0), &config).retired, 0);
        assert_eq!(map.update_zones(1, &[], &at(0.0, 0.0), &config).retired, 1);
        assert!(map.zones().is_empty());
    }

    #[test]
    fn zones_move_with_the_scan_they_were_seen_from_and_survive_their_bytes() {
        let mut list = ZoneList::default();
        let config = ZoneConfig::default();
        list.merge(3, &[zone(5.0, 0.0, [1.0, 0.0, 0.0])], &Pose::translation(1.0, 0.0, 0.0), &config);
        list.merge(4, &[zone(9.0, 0.0, [1.0, 0.0, 0.0])], &Pose::translation(2.0, 0.0, 0.0), &config);
        let turned = Pose::new(Vector3::new(1.0, 0.5, 0.0), Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        assert_eq!(list.move_with(3, &turned), 1);
        let moved = list.as_slice()[0];
        assert!((moved.centre - Point3::new(1.0, 4.5, 1.0)).norm() < 1e-12);
        assert!((moved.normal - Vector3::y()).norm() < 1e-12);
        assert_eq!(list.as_slice()[1], zone(9.0, 0.0, [1.0, 0.0, 0.0]));
        let mut bytes = Vec::new();
        list.write(&mut bytes);
        assert_eq!(ZoneList::read(&mut &bytes[..]), Some(list));
        for length in 0..bytes.len() {
            assert_eq!(ZoneList::read(&mut &bytes[..length]), None);
        }
    }
}
