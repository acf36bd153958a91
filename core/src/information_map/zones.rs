//! Zones of interest (3.28, 3.29): places where a scan broke off, and which want to be looked at face on.

use super::bytes::{Reader, TruncatedMap};
use super::grid_line::cells_of_line;
use super::map::InformationMap;
use super::navigability::CellState;
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

/// The zones of all scans, each place once, in the order in which they were found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ZoneList {
    zones: Vec<Zone>,
}

impl Zone {
    fn is_same_place(&self, other: &Self, config: &ZoneConfig) -> bool {
        let cos = self.normal.dot(&other.normal).abs() / (self.normal.norm() * other.normal.norm());
        (self.centre - other.centre).norm() < config.merge_distance_m && cos > config.merge_angle_deg.to_radians().cos()
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
    pub fn merge(&mut self, seen: &[Zone], config: &ZoneConfig) -> (usize, usize) {
        let (mut merged, mut added) = (0, 0);
        for zone in seen.iter().filter(|zone| zone.is_usable()) {
            match self.zones.iter_mut().find(|known| known.is_same_place(zone, config)) {
                Some(known) => {
                    merged += 1;
                    if zone.normal.norm_squared() > known.normal.norm_squared() {
                        *known = *zone;
                    }
                }
                None => {
                    added += 1;
                    self.zones.push(*zone);
                }
            }
        }
        (merged, added)
    }

    /// Removes the zones that are done and returns how many.
    pub fn retire(&mut self, is_done: impl Fn(&Zone) -> bool) -> usize {
        let before = self.zones.len();
        self.zones.retain(|zone| !is_done(zone));
        before - self.zones.len()
    }

    pub(super) fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&(self.zones.len() as u64).to_le_bytes());
        for value in self.zones.iter().flat_map(|zone| zone.centre.coords.iter().chain(zone.normal.iter())) {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }

    /// `None` inside when a zone is not usable.
    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Option<Self>, TruncatedMap> {
        let count = u64::from_le_bytes(reader.array()?);
        let mut list = Self::default();
        for _ in 0..count {
            let mut values = [0.0; 6];
            for value in &mut values {
                *value = f64::from_le_bytes(reader.array()?);
            }
            let [cx, cy, cz, nx, ny, nz] = values;
            let zone = Zone { centre: Point3::new(cx, cy, cz), normal: Vector3::new(nx, ny, nz) };
            if !zone.is_usable() {
                return Ok(None);
            }
            list.zones.push(zone);
        }
        Ok(Some(list))
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
        assert_eq!(list.merge(&[zone(5.0, 0.0, [1.0, 0.0, 0.0])], &config), (0, 1));
        assert_eq!(list.merge(&[zone(5.3, 0.0, [-2.0, 0.1, 0.0])], &config), (1, 0));
        assert_eq!(list.as_slice(), &[zone(5.3, 0.0, [-2.0, 0.1, 0.0])]);
    }

    #[test]
    fn another_place_or_another_side_is_another_zone() {
        let mut list = ZoneList::default();
        let zones = [zone(5.0, 0.0, [1.0, 0.0, 0.0]), zone(5.0, 0.0, [0.0, 1.0, 0.0]), zone(8.0, 0.0, [1.0, 0.0, 0.0])];
        assert_eq!(list.merge(&zones, &ZoneConfig::default()), (0, 3));
    }

    #[test]
    fn a_zone_without_area_or_place_is_passed_over() {
        let mut list = ZoneList::default();
        let zones = [zone(5.0, 0.0, [0.0; 3]), zone(f64::NAN, 0.0, [1.0, 0.0, 0.0])];
        assert_eq!(list.merge(&zones, &ZoneConfig::default()), (0, 0));
    }

    #[test]
    fn a_zone_is_done_once_seen_face_on_but_not_edge_on_or_from_too_far() {
        let mut map = InformationMap::new(MapConfig::default()).unwrap();
        let config = ZoneConfig::default();
        let at = |x: f64, y: f64| Point3::new(x, y, 1.0);
        let wall = zone(10.0, 0.0, [2.0, 0.0, 0.0]);
        map.update_zones(&[wall], &at(10.0, -8.0), &config);
        assert_eq!(map.zones().len(), 1);
        assert_eq!(map.update_zones(&[], &at(10.0, -8.0), &config).retired, 0);
        assert_eq!(map.update_zones(&[], &at(-60.0, 0.0), &config).retired, 0);
        assert_eq!(map.update_zones(&[], &at(0.0, 0.0), &config).retired, 1);
        assert!(map.zones().is_empty());
    }
}
