//! Where every scan of the map stands, and where it ought to.

use super::scan_evidence::{pose_from_numbers, pose_to_numbers};
use crate::geometry::{Pose, rotation_angle};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// When a scan is moved in the map after its pose was corrected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MoveConfig {
    /// A scan is moved when it is off by more than this [m], 0 to 10 ...
    pub min_shift_m: f64,
    /// ... or by more than this [deg], 0 to 90.
    pub min_turn_deg: f64,
}

impl Default for MoveConfig {
    fn default() -> Self {
        // A thirtieth of a cell of 0.3 m, and what that is in 10 m distance.
        Self { min_shift_m: 0.01, min_turn_deg: 0.05 }
    }
}

impl MoveConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the field and what would be right.
    pub fn validate(&self) -> Result<(), String> {
        let within = |field: &str, value: f64, most: f64| {
            if (0.0..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!("{field} = {value} is not allowed; give 0 to {most}"))
            }
        };
        within("min_shift_m", self.min_shift_m, 10.0)?;
        within("min_turn_deg", self.min_turn_deg, 90.0)
    }
}

/// What a correction comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Correction {
    /// The map does not have this scan: it was never added, as when it could not be aligned.
    Unknown,
    /// The scan stands near enough to the new pose.
    Kept,
    /// The scan is to be moved.
    Due,
}

/// One scan.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stand {
    /// Where the map has it.
    is_at: Pose,
    /// Where it was said to be last.
    belongs_to: Pose,
}

/// The poses of all scans of a map, by their number. Kept as 130 bytes a scan.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScanPoses {
    stands: BTreeMap<u64, Stand>,
    due: BTreeSet<u64>,
}

/// A scan that is to be moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    /// The scan.
    pub scan: u64,
    /// Where the map has it.
    pub from: Pose,
    /// Where it belongs.
    pub to: Pose,
}

impl ScanPoses {
    /// Notes that a scan was added at a pose.
    pub fn added(&mut self, scan: u64, map_from_scanner: Pose) {
        self.stands.insert(scan, Stand { is_at: map_from_scanner, belongs_to: map_from_scanner });
        self.due.remove(&scan);
    }

    /// Notes where a scan ought to be. Small corrections add up: what counts is the distance to where the map has it.
    /// The pose must be finite; a correction that is not is one of an unknown scan.
    pub fn correct(&mut self, scan: u64, map_from_scanner: &Pose, config: &MoveConfig) -> Correction {
        let Some(stand) = self.stands.get_mut(&scan) else { return Correction::Unknown };
        stand.belongs_to = *map_from_scanner;
        let change = stand.is_at.inverse() * map_from_scanner;
        let is_off = change.translation.vector.norm() > config.min_shift_m
            || rotation_angle(&change) > config.min_turn_deg.to_radians();
        if is_off {
            self.due.insert(scan);
            Correction::Due
        } else {
            self.due.remove(&scan);
            Correction::Kept
        }
    }

    /// The scan to be moved next: the newest, since the robot is near it.
    #[must_use]
    pub fn next_move(&self) -> Option<Move> {
        let scan = *self.due.last()?;
        let stand = self.stands.get(&scan)?;
        Some(Move { scan, from: stand.is_at, to: stand.belongs_to })
    }

    /// Notes that a scan was moved.
    pub fn moved(&mut self, done: &Move) {
        if let Some(stand) = self.stands.get_mut(&done.scan) {
            stand.is_at = done.to;
            self.due.remove(&done.scan);
        }
    }

    /// Number of scans to be moved.
    #[must_use]
    pub fn due(&self) -> usize {
        self.due.len()
    }

    /// Where the map has a scan.
    #[must_use]
    pub fn pose(&self, scan: u64) -> Option<&Pose> {
        self.stands.get(&scan).map(|stand| &stand.is_at)
    }

    /// The scans of the map and where it has them.
    pub fn iter(&self) -> impl Iterator<Item = (u64, &Pose)> + '_ {
        self.stands.iter().map(|(scan, stand)| (*scan, &stand.is_at))
    }

    /// Number of scans in the map.
    #[must_use]
    pub fn len(&self) -> usize {
        self.stands.len()
    }

    /// Whether the map has no scans.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.stands.is_empty()
    }

    /// Appends all of it as bytes.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&(self.stands.len() as u64).to_le_bytes());
        for (scan, stand) in &self.stands {
            out.extend_from_slice(&scan.to_le_bytes());
            out.push(u8::from(self.due.contains(scan)));
            for value in [&stand.is_at, &stand.belongs_to].into_iter().flat_map(pose_to_numbers) {
                out.extend_from_slice(&value.to_le_bytes());
            }
        }
    }

    /// Takes what [`ScanPoses::write`] wrote off the front of `bytes`; `None` when it is not there.
    #[must_use]
    pub fn read(bytes: &mut &[u8]) -> Option<Self> {
        let mut poses = Self::default();
        for _ in 0..u64::from_le_bytes(take(bytes)?) {
            let scan = u64::from_le_bytes(take(bytes)?);
            let [is_due] = take(bytes)?;
            let mut pose = || {
                let mut numbers = [0.0; 7];
                for number in &mut numbers {
                    *number = f64::from_le_bytes(take(bytes)?);
                }
                pose_from_numbers(numbers)
            };
            let (is_at, belongs_to) = (pose()?, pose()?);
            poses.stands.insert(scan, Stand { is_at, belongs_to });
            if is_due == 1 {
                poses.due.insert(scan);
            }
        }
        Some(poses)
    }
}

/// Takes a number off the front of some bytes.
pub(super) fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn at(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn only_what_moved_far_enough_is_moved_and_small_corrections_add_up() {
        let (mut poses, config) = (ScanPoses::default(), MoveConfig::default());
        poses.added(4, at(1.0));
        poses.added(9, at(2.0));
        assert_eq!(poses.correct(4, &at(1.008), &config), Correction::Kept);
        assert_eq!(poses.next_move(), None);
        assert_eq!(poses.correct(4, &at(1.016), &config), Correction::Due);
        let turned = at(2.0) * Pose::rotation(Vector3::new(0.0, 0.0, 0.002));
        assert_eq!(poses.correct(9, &turned, &config), Correction::Due);
        let first = poses.next_move().unwrap();
        assert_eq!(first, Move { scan: 9, from: at(2.0), to: turned });
        poses.moved(&first);
        assert_eq!(poses.next_move(), Some(Move { scan: 4, from: at(1.0), to: at(1.016) }));
        assert_eq!(poses.correct(4, &at(1.0), &config), Correction::Kept);
        assert_eq!(poses.due(), 0);
    }

    #[test]
    fn a_correction_of_a_scan_that_is_not_in_the_map_is_unknown() {
        let mut poses = ScanPoses::default();
        assert_eq!(poses.correct(3, &at(1.0), &MoveConfig::default()), Correction::Unknown);
        assert!(poses.is_empty() && poses.next_move().is_none());
    }

    #[test]
    fn poses_survive_their_bytes_to_the_last_bit_and_torn_ones_are_refused() {
        let mut poses = ScanPoses::default();
        poses.added(0, Pose::identity());
        poses.added(7, Pose::new(Vector3::new(0.1, -0.2, 1.0 / 3.0), Vector3::new(0.3, 0.2, -0.7)));
        poses.correct(7, &at(5.0), &MoveConfig::default());
        let mut bytes = Vec::new();
        poses.write(&mut bytes);
        assert_eq!(ScanPoses::read(&mut &bytes[..]), Some(poses));
        for length in 0..bytes.len() {
            assert_eq!(ScanPoses::read(&mut &bytes[..length]), None, "{length}");
        }
    }

    #[test]
    fn limits_outside_their_range_are_named() {
        let wrong = MoveConfig { min_turn_deg: f64::NAN, ..MoveConfig::default() };
        assert!(wrong.validate().unwrap_err().contains("min_turn_deg"));
        assert!(MoveConfig { min_shift_m: -1.0, ..MoveConfig::default() }.validate().is_err());
        MoveConfig::default().validate().unwrap();
    }
}
