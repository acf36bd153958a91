//! Places where something held the robot that the map shows nothing of.

use serde::{Deserialize, Serialize};

/// A disc that the robot could not get into, whatever the scans say of it. It stands until the end of the run: whoever found
/// the way free later would have to try it again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Obstruction {
    /// Its centre [m, map frame].
    pub centre: [f64; 2],
    /// Its radius [m].
    pub radius_m: f64,
}

impl Obstruction {
    /// Whether it can be one: finite, and its radius is positive and at most 10 m.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.centre.iter().all(|x| x.is_finite()) && self.radius_m > 0.0 && self.radius_m <= 10.0
    }
}
