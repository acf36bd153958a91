//! One return of the laser.

use bytemuck::{Pod, Zeroable};
use nalgebra::{Point3, Vector3};

/// One point of a scan, 16 bytes: position in the scanner's frame [m], intensity (sensor's own scale, 0 when unknown)
/// and the time within the scan as a fraction of its duration (0 = first beam, 65535 = last).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Point {
    /// Ahead [m].
    pub x: f32,
    /// To the left [m].
    pub y: f32,
    /// Up [m].
    pub z: f32,
    /// Sensor's own scale, 0 when unknown.
    pub intensity: u16,
    /// Fraction of the scan's duration, 0 to 65535.
    pub time: u16,
}

impl Point {
    /// A cell without a return. It is marked, never invented: all coordinates are NaN.
    pub const EMPTY: Self = Self { x: f32::NAN, y: f32::NAN, z: f32::NAN, intensity: 0, time: 0 };

    /// A point with neither intensity nor time.
    #[must_use]
    pub const fn new(x: f32, y: f32, z: f32) -> Self {
        Self { x, y, z, intensity: 0, time: 0 }
    }

    /// Whether the laser got a return here, at a finite position.
    #[must_use]
    #[inline]
    pub fn is_return(&self) -> bool {
        (self.x + self.y + self.z).is_finite()
    }

    /// The position as a vector from the scanner [m].
    #[must_use]
    pub fn vector(&self) -> Vector3<f32> {
        Vector3::new(self.x, self.y, self.z)
    }

    /// The position [m], in double precision.
    #[must_use]
    pub fn position(&self) -> Point3<f64> {
        Point3::new(f64::from(self.x), f64::from(self.y), f64::from(self.z))
    }

    /// The distance from the scanner [m].
    #[must_use]
    pub fn range(&self) -> f32 {
        self.vector().norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_cell_is_not_a_return() {
        assert!(!Point::EMPTY.is_return());
        assert!(Point::new(0.0, 1.0, 2.0).is_return());
        assert!(!Point::new(f32::INFINITY, 0.0, 0.0).is_return());
    }

    #[test]
    fn a_point_takes_sixteen_bytes() {
        assert_eq!(size_of::<Point>(), 16);
    }
}
