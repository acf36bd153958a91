//! From the ellipsoid to local east, north, up.

use nalgebra::{Matrix3, Vector3};

/// World Geodetic System 1984: half the equator's diameter [m] and the square of the eccentricity.
const EQUATOR_M: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_14e-3;

/// A place on the earth from which east, north and up are counted.
#[derive(Debug, Clone)]
pub(super) struct LocalFrame {
    origin: Vector3<f64>,
    /// Rows are the directions east, north and up in the earth's frame.
    enu_from_earth: Matrix3<f64>,
}

impl LocalFrame {
    /// Latitude and longitude [rad], height over the ellipsoid [m].
    pub fn new(latitude: f64, longitude: f64, height: f64) -> Self {
        let ((sin_lat, cos_lat), (sin_lon, cos_lon)) = (latitude.sin_cos(), longitude.sin_cos());
        #[rustfmt::skip]
        let enu_from_earth = Matrix3::new(
            -sin_lon, cos_lon, 0.0,
            -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,
            cos_lat * cos_lon, cos_lat * sin_lon, sin_lat,
        );
        Self { origin: earth_centred(latitude, longitude, height), enu_from_earth }
    }

    /// East, north, up [m] of a place.
    pub fn enu(&self, latitude: f64, longitude: f64, height: f64) -> Vector3<f64> {
        self.enu_from_earth * (earth_centred(latitude, longitude, height) - self.origin)
    }
}

/// Earth-centred, earth-fixed coordinates [m].
fn earth_centred(latitude: f64, longitude: f64, height: f64) -> Vector3<f64> {
    let ((sin_lat, cos_lat), (sin_lon, cos_lon)) = (latitude.sin_cos(), longitude.sin_cos());
    let normal = EQUATOR_M / (1.0 - ECCENTRICITY2 * sin_lat * sin_lat).sqrt();
    let level = (normal + height) * cos_lat;
    Vector3::new(level * cos_lon, level * sin_lon, (normal * (1.0 - ECCENTRICITY2) + height) * sin_lat)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_of_latitude_is_thirty_one_metres_and_height_is_up() {
        let (latitude, longitude) = (42.17_f64.to_radians(), (-8.68_f64).to_radians());
        let frame = LocalFrame::new(latitude, longitude, 460.0);
        let second = (1.0_f64 / 3600.0).to_radians();
        let north = frame.enu(latitude + second, longitude, 460.0);
        assert!((north.y - 30.856).abs() < 0.01 && north.x.abs() < 1e-6 && north.z.abs() < 1e-3, "{north}");
        let east = frame.enu(latitude, longitude + second, 462.0);
        assert!((east.x - 22.95).abs() < 0.02 && (east.z - 2.0).abs() < 1e-3, "{east}");
    }
}
