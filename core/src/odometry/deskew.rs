//! Motion during a scan: every point is carried to where the scanner would have seen it at the end of the scan.

use nalgebra::Matrix3x4;

use crate::geometry::{self, Pose, Twist};

/// Poses along the scan; between two of them their matrices are interpolated. At 45 degrees a scan the chord between
/// neighbours is off by 4e-5 of the range, at the 5 degrees of a fast car by 5e-7.
const INTERVALS: usize = 64;

/// The scanner's poses during one scan that moves at a constant twist: `end_from_time` at evenly spaced times.
#[derive(Debug, Clone)]
pub struct MotionTable {
    end_from_time: [Matrix3x4<f32>; INTERVALS + 1],
}

impl MotionTable {
    /// The table of a scanner that stands.
    #[must_use]
    pub fn still() -> Self {
        Self { end_from_time: [Matrix3x4::identity(); INTERVALS + 1] }
    }

    /// `twist` is the motion over the whole scan: `start_from_end = exp(twist)`, in the moving scanner's frame.
    #[must_use]
    pub fn new(twist: &Twist) -> Self {
        let mut table = Self::still();
        for (k, matrix) in table.end_from_time.iter_mut().enumerate() {
            let left = 1.0 - k as f64 / INTERVALS as f64;
            let end_from_time = geometry::exp(&(-twist * left));
            *matrix = end_from_time.to_homogeneous().fixed_view::<3, 4>(0, 0).map(|v| v as f32);
        }
        table
    }

    /// A point seen at `time` (0 first beam, 1 last) in the scanner's frame at the end of the scan [m].
    #[must_use]
    #[inline]
    pub fn end_from(&self, time: f32, point: [f32; 3]) -> [f32; 3] {
        let place = (time * INTERVALS as f32).clamp(0.0, INTERVALS as f32);
        let before = (place as usize).min(INTERVALS - 1);
        let share = place - before as f32;
        let (a, b) = (&self.end_from_time[before], &self.end_from_time[before + 1]);
        let matrix = a + (b - a) * share;
        let [x, y, z] = point;
        let row = |k: usize| matrix[(k, 0)] * x + matrix[(k, 1)] * y + matrix[(k, 2)] * z + matrix[(k, 3)];
        [row(0), row(1), row(2)]
    }
}

/// How far the two motions over a scan carry a point at `range_m` apart, at most [m].
pub(super) fn difference_m(one: &Twist, other: &Twist, range_m: f64) -> f64 {
    let apart: Pose = geometry::exp(one).inverse() * geometry::exp(other);
    super::threshold::displacement_m(&apart, range_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_point_fixed_in_the_world_is_carried_to_where_the_end_sees_it(
            t in prop::array::uniform3(-3.0..3.0f64), r in prop::array::uniform3(-0.4..0.4f64),
            point in prop::array::uniform3(-60.0..60.0f64), time in 0.0..=1.0f64,
        ) {
            let twist = Twist::new(t[0], t[1], t[2], r[0], r[1], r[2]);
            // The world is the scanner's frame at the start of the scan.
            let world = Point3::from(point);
            let seen = geometry::exp(&(twist * time)).inverse() * world;
            let expected = geometry::exp(&twist).inverse() * world;
            let carried = MotionTable::new(&twist).end_from(time as f32, [seen.x as f32, seen.y as f32, seen.z as f32]);
            let apart = Point3::new(carried[0], carried[1], carried[2]).cast::<f64>() - expected;
            prop_assert!(apart.norm() < 2e-3, "{} m", apart.norm());
        }

        #[test]
        fn the_last_beam_stays_where_it_is(r in prop::array::uniform3(-0.4..0.4f64), point in prop::array::uniform3(-60.0..60.0f32)) {
            let table = MotionTable::new(&Twist::new(1.0, 0.5, 0.1, r[0], r[1], r[2]));
            prop_assert_eq!(table.end_from(1.0, point), point);
        }
    }
}
