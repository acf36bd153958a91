//! Places where something held the robot that the map shows nothing of.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::geometry::Pose;

/// A disc that the robot could not get into, whatever the scans say of it. It stands until the end of the run, or until
/// no way is left: whoever found it free would have to try it again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Obstruction {
    /// Its centre [m, map frame].
    pub centre: [f64; 2],
    /// Its radius [m].
    pub radius_m: f64,
}

impl Obstruction {
    /// The same after the map has moved where the robot stood at a height [m] when it was told.
    #[must_use]
    pub fn moved_by(self, new_from_old: &Pose, height_m: f64) -> Self {
        let [x, y] = self.centre;
        Self { centre: (new_from_old * Point3::new(x, y, height_m)).xy().coords.into(), ..self }
    }

    /// Whether it can be one: finite, and its radius is positive and at most 10 m.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.centre.iter().all(|x| x.is_finite()) && self.radius_m > 0.0 && self.radius_m <= 10.0
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn an_obstruction_goes_where_the_map_goes() {
        let told = Obstruction { centre: [3.0, 0.0], radius_m: 0.3 };
        let quarter = Pose::new(Vector3::new(0.0, -1.0, 5.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let moved = told.moved_by(&quarter, 1.0);
        assert!(moved.centre[0].abs() < 1e-12 && (moved.centre[1] - 2.0).abs() < 1e-12, "{moved:?}");
        assert_eq!((moved.radius_m, told.moved_by(&Pose::identity(), 1.0)), (0.3, told));
    }
}
