//! Where scans were taken. What a scanner does not see from a place, such as the ground under the robot, it will not see
//! from there the next time either: a strategy that only looks at the map would go back and forth between such places.

use super::strategy::Situation;

/// The places of a run at which plans were made, one a scan. Who restarts tells a strategy where it has been
/// ([`Strategy::remember`](super::Strategy::remember)).
#[derive(Debug, Clone, Default)]
pub(super) struct Visited {
    places: Vec<[f64; 2]>,
    last_scan: Option<u64>,
}

impl Visited {
    /// Remembers where the robot is; asked again after the same scan, nothing new. Scans that are numbered anew begin another
    /// run.
    pub fn remember(&mut self, situation: &Situation) {
        let last = self.last_scan.replace(situation.scan_number);
        if last == Some(situation.scan_number) {
            return;
        }
        if last > Some(situation.scan_number) {
            self.places.clear();
        }
        let robot = situation.map_from_robot.translation.vector;
        if !self.places.contains(&[robot.x, robot.y]) {
            self.places.push([robot.x, robot.y]);
        }
    }

    /// Whether a place lies no farther than `distance_m` from one of them.
    pub fn is_near(&self, place: [f64; 2], distance_m: f64) -> bool {
        self.places.iter().any(|&[x, y]| (place[0] - x).hypot(place[1] - y) <= distance_m)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_worlds::at;
    use super::*;

    #[test]
    fn places_of_a_run_are_remembered_and_those_of_another_forgotten() {
        let mut visited = Visited::default();
        visited.remember(&Situation { scan_number: 4, ..at(1.0, 1.0) });
        visited.remember(&Situation { scan_number: 5, ..at(9.0, 1.0) });
        assert!(
            visited.is_near([1.0, 3.9], 3.0) && visited.is_near([9.0, 1.0], 0.0) && !visited.is_near([5.0, 5.0], 3.0)
        );
        visited.remember(&Situation { scan_number: 0, ..at(20.0, 1.0) });
        assert!(!visited.is_near([1.0, 1.0], 3.0) && visited.is_near([20.0, 1.0], 3.0));
    }
}
