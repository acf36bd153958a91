//! How the robot drove, for runs in which it did: where it was, how far it went, and what became of its targets.

use std::collections::BTreeMap;

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_ipc_schema::messages::NavigationStatus;
use mirador_ipc_schema::{text, topics};
use mirador_recorder::{ReadError, RunReader};

use super::run_data::ScanRecord;

/// The track gets a point whenever the robot has moved this far [m].
const TRACK_STEP_M: f64 = 0.1;
/// `NavigationStatus::state` of a target that was given up.
const GAVE_UP: u32 = 5;

/// A target that was not reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenUp {
    /// The scan whose plan led to it.
    pub scan: u32,
    /// Why, in words.
    pub reason: String,
}

/// What was recorded of the robot's driving; empty for runs without a robot.
#[derive(Debug, Clone, Default)]
pub struct Drive {
    /// Where localisation took the robot to be, about every 0.1 m [m, map frame].
    pub track: Vec<[f64; 3]>,
    /// Distance driven [m]: of the true positions where these are known, else of the estimated ones.
    pub distance_m: f64,
    /// From the first to the last step of the robot's time [s].
    pub duration_s: f64,
    /// Targets that were not reached.
    pub given_up: Vec<GivenUp>,
    /// Whether the robot lay on its side.
    pub tipped: bool,
    /// Distance driven by its time [ns], one for every step of the track.
    odometer: BTreeMap<i64, f64>,
    /// True poses `map_from_robot` by their time [ns], one for every stretch without motion.
    truth: BTreeMap<i64, Pose>,
}

/// Adds up a way from positions that come many times a second.
#[derive(Default)]
struct Way {
    last: Option<[f64; 3]>,
    length: f64,
}

impl Way {
    /// Takes a position in; whether it is a step on from the last that counted.
    fn is_step(&mut self, position: [f64; 3]) -> bool {
        let Some(last) = self.last else {
            self.last = Some(position);
            return true;
        };
        let [x, y, z] = [0, 1, 2].map(|k: usize| position[k] - last[k]);
        let step = (x * x + y * y + z * z).sqrt();
        let counts = step >= TRACK_STEP_M;
        if counts {
            self.length += step;
            self.last = Some(position);
        }
        counts
    }
}

impl Drive {
    /// Reads it from a recording.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub(super) fn read(reader: &mut RunReader) -> Result<Self, ReadError> {
        let mut drive = Self::default();
        let (mut estimated, mut real) = (Way::default(), Way::default());
        let (mut first, mut last) = (None, 0_i64);
        reader.for_each::<topics::RobotPoses>(|meta, poses| {
            for pose in poses.iter().filter_map(|pose| pose_from_rows(&pose.map_from_robot)) {
                let position = pose.translation.vector.into();
                if estimated.is_step(position) {
                    drive.track.push(position);
                    drive.odometer.insert(meta.header.stamp_ns, estimated.length);
                }
            }
        })?;
        let (mut standing, mut by_truth) = (None, BTreeMap::new());
        reader.for_each::<topics::RobotState>(|meta, states| {
            let stamp = meta.header.stamp_ns;
            first.get_or_insert(stamp);
            last = last.max(stamp);
            for state in states {
                drive.tipped |= state.tipped != 0;
                let Some(pose) = pose_from_rows(&state.map_from_robot) else { continue };
                if real.is_step(pose.translation.vector.into()) {
                    by_truth.insert(stamp, real.length);
                }
                if standing != Some(pose) {
                    drive.truth.insert(stamp, pose);
                    standing = Some(pose);
                }
            }
        })?;
        if !by_truth.is_empty() {
            drive.odometer = by_truth;
        }
        drive.distance_m = if drive.truth.is_empty() { estimated.length } else { real.length };
        drive.duration_s = first.map_or(0.0, |first| (last - first) as f64 * 1e-9);
        reader.for_each::<topics::NavigationStatus>(|meta, statuses| {
            let scan = meta.header.scan();
            for status in statuses.iter().filter(|status| status.state == GAVE_UP) {
                drive.give_up(scan, status);
            }
        })?;
        Ok(drive)
    }

    /// A state is said more than once.
    fn give_up(&mut self, scan: u32, status: &NavigationStatus) {
        let given_up = GivenUp { scan, reason: text::unpack(&status.reason).to_owned() };
        if self.given_up.last() != Some(&given_up) {
            self.given_up.push(given_up);
        }
    }

    /// Distance driven up to a time [m], by steps of the true track, else of the estimated one.
    pub(super) fn driven_until(&self, stamp_ns: i64) -> f64 {
        let last = self.odometer.range(..=stamp_ns).next_back();
        last.map_or(0.0, |(_, metres)| *metres)
    }

    /// The true pose `map_from_robot` at a time [ns]; `None` where nobody knows it.
    fn true_pose(&self, stamp_ns: i64) -> Option<Pose> {
        self.truth.range(..=stamp_ns).next_back().map(|(_, pose)| *pose)
    }

    /// The true poses `map_from_scanner` of the scans, by their `source_index`; `None` when none is known.
    pub(super) fn truth_of(&self, scans: &[ScanRecord], robot_from_scanner: &Pose) -> Option<BTreeMap<u32, Pose>> {
        let of = |record: &ScanRecord| {
            let pose = self.true_pose(record.scan.header.stamp_ns)? * robot_from_scanner;
            Some((record.scan.source_index, pose))
        };
        let truth: BTreeMap<_, _> = scans.iter().filter_map(of).collect();
        (!truth.is_empty()).then_some(truth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Translation3;

    #[test]
    fn a_way_counts_steps_and_not_the_trembling_in_between() {
        let mut way = Way::default();
        for k in 0..1000 {
            let trembling = if k % 2 == 0 { 0.02 } else { -0.02 };
            way.is_step([f64::from(k) * 0.01, trembling, 0.0]);
        }
        assert!((way.length - 9.99).abs() < 0.6, "{}", way.length);
        let mut still = Way::default();
        (0..1000).for_each(|k| {
            still.is_step([0.03 * f64::from(k % 2), 0.0, 0.0]);
        });
        assert_eq!(still.length, 0.0);
    }

    #[test]
    fn the_truth_of_a_scan_is_where_the_robot_stood_at_its_time() {
        let at = |x: f64| Pose::from_parts(Translation3::new(x, 0.0, 0.0), nalgebra::UnitQuaternion::identity());
        let drive = Drive { truth: BTreeMap::from([(0, at(0.0)), (100, at(1.0))]), ..Drive::default() };
        let mut scan = ScanRecord::default();
        scan.scan.header.stamp_ns = 250;
        scan.scan.source_index = 3;
        let mount = Pose::from_parts(Translation3::new(0.0, 0.0, 1.0), nalgebra::UnitQuaternion::identity());
        let truth = drive.truth_of(&[scan], &mount).unwrap();
        assert_eq!(truth[&3].translation.vector, nalgebra::Vector3::new(1.0, 0.0, 1.0));
        assert!(drive.true_pose(-1).is_none());
        assert_eq!(Drive::default().truth_of(&[ScanRecord::default()], &mount), None);
    }
}
