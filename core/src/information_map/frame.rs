//! From the scanner's frame into the map's units.

use super::cell::{HEIGHT_UNITS_PER_METRE, Item};
use super::config::MapConfig;
use super::index::{CellIndex, floor};
use crate::geometry::Pose;
use crate::scan::Point;
use nalgebra::{Matrix3, Vector3};

/// From the scanner's frame to cell units (x, y) and height units (z), and the thresholds as stored scores.
pub(super) struct Frame {
    linear: Matrix3<f64>,
    offset: Vector3<f64>,
    rotation: Matrix3<f32>,
    navigable_threshold: u16,
    obstacle_threshold: u16,
    pub(super) max_cells: usize,
}

impl Frame {
    pub(super) fn new(map_from_scanner: &Pose, config: &MapConfig) -> Self {
        let scale = Vector3::new(1.0 / config.cell_m, 1.0 / config.cell_m, HEIGHT_UNITS_PER_METRE);
        let rotation = map_from_scanner.rotation.to_rotation_matrix().into_inner();
        Self {
            linear: Matrix3::from_diagonal(&scale) * rotation,
            offset: map_from_scanner.translation.vector.component_mul(&scale),
            rotation: rotation.cast(),
            navigable_threshold: (config.navigable_threshold * 65535.0) as u16,
            obstacle_threshold: (config.obstacle_threshold * 65535.0) as u16,
            max_cells: config.max_cells_per_triangle,
        }
    }

    #[inline]
    pub(super) fn position(&self, point: &Point) -> Vector3<f64> {
        // Written out, as nalgebra's product is not inlined here and this is done for every point.
        let (m, t) = (&self.linear, &self.offset);
        let (x, y, z) = (f64::from(point.x), f64::from(point.y), f64::from(point.z));
        Vector3::new(
            m.m11 * x + m.m12 * y + m.m13 * z + t.x,
            m.m21 * x + m.m22 * y + m.m23 * z + t.y,
            m.m31 * x + m.m32 * y + m.m33 * z + t.z,
        )
    }

    /// Whether a stored B counts as an obstacle.
    #[inline]
    pub(super) fn is_obstacle(&self, obstacle: u16) -> bool {
        obstacle > self.obstacle_threshold
    }

    /// A height [1/1024 m] as stored; beyond a thousand kilometres it is clamped so that sums stay in range.
    #[inline]
    pub(super) fn height(&self, height: f64) -> i32 {
        let limit = f64::from(1 << 30);
        floor(height.clamp(-limit, limit) + 0.5)
    }

    #[inline]
    pub(super) fn item(&self, navigable: u16, obstacle: u16, quality: u16, height: f64, normal: &Vector3<f32>) -> Item {
        let m = &self.rotation;
        Item {
            navigable,
            obstacle,
            quality,
            is_navigable: navigable > self.navigable_threshold,
            is_obstacle: self.is_obstacle(obstacle),
            height: self.height(height),
            normal: Vector3::new(
                m.m11 * normal.x + m.m12 * normal.y + m.m13 * normal.z,
                m.m21 * normal.x + m.m22 * normal.y + m.m23 * normal.z,
                m.m31 * normal.x + m.m32 * normal.y + m.m33 * normal.z,
            ),
        }
    }
}

/// The plane through a triangle's corners, to give a height to the cells between them.
pub(super) struct Plane {
    corner: Vector3<f64>,
    slope: [f64; 2],
    lowest: f64,
    highest: f64,
}

impl Plane {
    pub(super) fn through(corners: &[Vector3<f64>; 3]) -> Self {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        // Seen edge on there is no slope: the clamp below keeps whatever comes out within the corners.
        let finite = |s: f64| if s.is_finite() { s } else { 0.0 };
        let slope = [finite(-normal.x / normal.z), finite(-normal.y / normal.z)];
        let zs = [corners[0].z, corners[1].z, corners[2].z];
        let (lowest, highest) = (zs[0].min(zs[1]).min(zs[2]), zs[0].max(zs[1]).max(zs[2]));
        Self { corner: corners[0], slope, lowest, highest }
    }

    /// The height over the cell's centre, never beyond the corners' heights.
    pub(super) fn height_at(&self, cell: CellIndex) -> f64 {
        let (dx, dy) = (f64::from(cell.x) + 0.5 - self.corner.x, f64::from(cell.y) + 0.5 - self.corner.y);
        (self.corner.z + self.slope[0] * dx + self.slope[1] * dy).clamp(self.lowest, self.highest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_between_the_corners_follow_the_slope() {
        let plane = Plane::through(&[[0.0, 0.0, 0.0], [10.0, 0.0, 20.0], [0.0, 10.0, 0.0]].map(Vector3::from));
        assert!((plane.height_at(CellIndex { x: 4, y: 2 }) - 9.0).abs() < 1e-9);
        assert_eq!(plane.height_at(CellIndex { x: 40, y: 2 }), 20.0);
    }

    #[test]
    fn an_upright_triangle_keeps_within_its_corners() {
        let plane = Plane::through(&[[0.0, 0.0, 1.0], [10.0, 0.0, 2.0], [5.0, 0.0, 9.0]].map(Vector3::from));
        assert!((1.0..=9.0).contains(&plane.height_at(CellIndex { x: 4, y: 0 })));
    }
}
