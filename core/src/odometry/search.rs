//! Where the prediction leads nowhere: many starts around the last pose, all headings, the promising ones followed.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::OdometryConfig;
use super::local_map::LocalMap;
use super::registration::{Frame, Schedule};
use crate::geometry::Pose;
use crate::threads;

/// Headings tried: 15 degrees apart, within the reach of an alignment in coarse voxels.
const HEADINGS: usize = 24;
/// Starts a heading, in search radii ahead and to the left.
const SHIFTS: [(f64, f64); 9] =
    [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)];
/// Points of the frame that take part.
const POINTS: usize = 400;
/// Steps before the starts are compared.
const FIRST_STEPS: u32 = 5;
/// Steps after that.
const FURTHER_STEPS: u32 = 15;
/// Starts followed after that.
const FOLLOWED: usize = 12;
/// Poses handed back.
pub(super) const BEST: usize = 3;
/// Two starts that came so close to each other are one: they carry no point within `SAME_RANGE_M` farther apart [m].
const SAME_M: f64 = 0.5;
const SAME_RANGE_M: f64 = 10.0;

/// The search and its buffers.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// The thinned frame, once a thread.
    frames: Vec<Frame>,
    /// Score and pose of every start.
    poses: Vec<(f64, Pose)>,
}

/// What a search came to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// The most promising poses, best first.
    pub best: [Option<Pose>; BEST],
    /// Starts tried.
    pub tried: u32,
}

impl Search {
    pub fn bytes(&self) -> usize {
        self.frames.iter().map(Frame::bytes).sum::<usize>() + self.poses.capacity() * size_of::<(f64, Pose)>()
    }

    /// Looks for the frame within `radius_m` of `last`: headings about the scanner's own z axis, which hand-held and
    /// driven scanners turn about far more than about the others.
    pub fn run(
        &mut self,
        map: &LocalMap,
        frame: &Frame,
        last: &Pose,
        radius_m: f64,
        schedule: &Schedule,
        config: &OdometryConfig,
    ) -> Found {
        self.frames.resize_with(config.threads, Frame::default);
        self.frames.iter_mut().for_each(|own| own.set_thinned(frame, POINTS));
        self.poses.clear();
        for heading in 0..HEADINGS {
            let angle = heading as f64 / HEADINGS as f64 * std::f64::consts::TAU;
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            for (ahead, left) in SHIFTS {
                let shift = Translation3::new(ahead * radius_m, left * radius_m, 0.0);
                self.poses.push((0.0, last * Pose::from_parts(shift, turn)));
            }
        }
        let tried = self.poses.len() as u32;
        let first = Schedule { most_iterations: FIRST_STEPS, first_scale_m: 2.0 * schedule.last_scale_m, ..*schedule };
        self.follow(map, &first, config);
        self.keep(FOLLOWED);
        let further = Schedule { first_scale_m: schedule.last_scale_m, most_iterations: FURTHER_STEPS, ..*schedule };
        self.follow(map, &further, config);
        self.keep(BEST);
        Found { best: std::array::from_fn(|k| self.poses.get(k).map(|(_, pose)| *pose)), tried }
    }

    /// Aligns from every pose, and writes where that led. What a start leads to does not depend on who follows it.
    fn follow(&mut self, map: &LocalMap, schedule: &Schedule, config: &OdometryConfig) {
        let share = self.poses.len().div_ceil(self.frames.len().max(1)).max(1);
        let parts = self.poses.chunks_mut(share).zip(&mut self.frames);
        threads::for_each(parts, config.threads, |(poses, frame)| {
            for (score, pose) in poses {
                let outcome = frame.align(map, pose, schedule, config);
                (*score, *pose) = (outcome.score, outcome.map_from_scanner);
            }
        });
    }

    /// Keeps the best poses, one of those that came to the same place.
    fn keep(&mut self, most: usize) {
        // Stable: of equals the earlier start stays first.
        self.poses.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept = 0;
        for k in 0..self.poses.len() {
            let candidate = self.poses[k];
            let known = self.poses[..kept].iter().any(|(_, pose)| is_same(pose, &candidate.1));
            if !known && kept < most {
                self.poses[kept] = candidate;
                kept += 1;
            }
        }
        self.poses.truncate(kept);
    }
}

/// Whether two poses are one: within what the next alignment brings together anyway.
fn is_same(one: &Pose, other: &Pose) -> bool {
    super::threshold::displacement_m(&(one.inverse() * other), SAME_RANGE_M) < SAME_M
}
