//! A robot that turns on the spot beside an edge swings its corners over it, and one that drives along it may get a wheel
//! over. It shows in how it leans: then it turns or goes back to where it stood well.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector2, Vector3};

use crate::geometry::Pose;

/// A robot that turns on the spot and leans by so much more than when it began, and by so much in all, has a wheel over an edge
/// [deg].
const MORE_DEG: f64 = 8.0;
const LEANING_DEG: f64 = 13.0;
/// The same for one that drives: more than at its best over the last stretch of the way [deg, m]. Slopes that are planned on
/// come more slowly.
const DRIVING_MORE_DEG: f64 = 9.0;
const DRIVING_LEANING_DEG: f64 = 18.0;
const STRETCH_M: f64 = 0.5;
/// Either has less left when it leaned more than this before: by this share of what is above, up to so much [deg].
const STEEP_DEG: f64 = 5.0;
const STEEPEST_DEG: f64 = 15.0;
const LESS: f64 = 0.4;
/// The way is noted this finely [m].
const NOTE_M: f64 = 0.02;
/// Where it leans forwards or backwards by this share it does not turn back, by which its nose or tail would slide down further.
const ALONG: f64 = 0.3;
/// It has turned back within this angle [rad].
const TURNED_BACK: f64 = 0.1;

/// How the robot gets away from an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Escape {
    /// Back to a heading [rad], in a direction of turning, then back the way it came.
    Turn(f64, f64),
    /// Straight: backwards or, where its tail hangs over, forwards.
    Straight(f64),
}

/// Watches how the robot leans.
#[derive(Debug, Clone, Default)]
pub(super) struct LeanWatch {
    /// Heading and tilt when the turn began [rad, deg].
    began: Option<(f64, f64)>,
    /// Once it has a wheel over an edge.
    escape: Option<Escape>,
    /// Way driven and tilt there, over the last stretch [m, deg].
    stretch: VecDeque<(f64, f64)>,
}

impl LeanWatch {
    /// Takes note of a step of driving; whether it has driven a wheel over an edge.
    pub fn leans_on_the_way(&mut self, driven_m: f64, tilt_deg: f64) -> bool {
        while self.stretch.front().is_some_and(|(at, _)| *at < driven_m - STRETCH_M) {
            self.stretch.pop_front();
        }
        if self.stretch.back().is_none_or(|(at, _)| *at + NOTE_M <= driven_m) {
            self.stretch.push_back((driven_m, tilt_deg));
        }
        let least_deg = self.stretch.iter().map(|(_, tilt)| *tilt).fold(tilt_deg, f64::min);
        let leans = tilt_deg > DRIVING_LEANING_DEG && tilt_deg > least_deg + DRIVING_MORE_DEG - less_deg(least_deg);
        if leans {
            self.escape = Some(Escape::Straight(-1.0));
            self.stretch.clear();
        }
        leans
    }

    /// Takes note of a step; `turning` is the speed at which it turns on the spot, if it does [rad/s]. Whether it has turned a
    /// wheel over an edge.
    pub fn leans(&mut self, turning: Option<f64>, map_from_robot: &Pose, tilt_deg: f64) -> bool {
        let Some(turning) = turning else {
            self.began = None;
            return false;
        };
        let (heading, level_deg) = *self.began.get_or_insert((heading(map_from_robot), tilt_deg));
        let leans = tilt_deg > LEANING_DEG && tilt_deg > level_deg + MORE_DEG - less_deg(level_deg);
        if leans {
            let ahead = downhill(map_from_robot, 1.0).x;
            let is_along = ahead.abs() > ALONG;
            self.escape = Some(if is_along {
                Escape::Straight(-ahead.signum())
            } else {
                Escape::Turn(heading, -turning.signum())
            });
            self.began = None;
        }
        leans
    }

    /// Whether it is to turn back.
    pub fn is_over_an_edge(&self) -> bool {
        self.escape.is_some()
    }

    /// Begins to get away: forgets the edge, unless it is to turn back first. Which way straight, where that is so.
    pub fn straight_away(&mut self) -> Option<f64> {
        let Some(Escape::Straight(way)) = self.escape else { return None };
        self.escape = None;
        Some(way)
    }

    /// Which way to turn back, if it is to, until it stands as it did before the turn.
    pub fn way_back(&mut self, map_from_robot: &Pose) -> Option<f64> {
        let Some(Escape::Turn(to, way)) = self.escape else { return None };
        let off = to - heading(map_from_robot);
        if off.sin().atan2(off.cos()).abs() <= TURNED_BACK {
            self.escape = None;
        }
        self.escape.map(|_| way)
    }
}

/// By how much less a robot may lean on top of what it leaned before [deg].
fn less_deg(before_deg: f64) -> f64 {
    LESS * (before_deg.clamp(STEEP_DEG, STEEPEST_DEG) - STEEP_DEG)
}

/// The place so far from the robot's middle on the side to which it leans [m, robot frame].
pub(super) fn downhill(map_from_robot: &Pose, metres: f64) -> Point3<f64> {
    let up = map_from_robot.rotation.inverse() * Vector3::z();
    let down = -Vector2::new(up.x, up.y).try_normalize(1e-6).unwrap_or_else(Vector2::x);
    Point3::new(metres * down.x, metres * down.y, 0.0)
}

fn heading(pose: &Pose) -> f64 {
    let ahead = pose.rotation * Vector3::x();
    ahead.y.atan2(ahead.x)
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    fn pose(heading_deg: f64, roll_deg: f64) -> Pose {
        let rotation = UnitQuaternion::from_euler_angles(roll_deg.to_radians(), 0.0, heading_deg.to_radians());
        Pose::from_parts(Vector3::zeros().into(), rotation)
    }

    #[test]
    fn a_robot_that_stands_on_a_slope_has_less_to_lean() {
        let mut watch = LeanWatch::default();
        let mut step = |heading: f64, roll: f64| watch.leans(Some(-0.5), &pose(heading, roll), roll.abs());
        assert!(!step(35.0, 12.0) && !step(24.0, 14.2) && !step(18.0, 16.5), "the slope is not even");
        assert!(step(12.0, 17.5));
    }

    #[test]
    fn a_robot_that_begins_to_lean_while_it_turns_turns_back_the_way_it_came() {
        let mut watch = LeanWatch::default();
        let mut step = |heading: f64, roll: f64| watch.leans(Some(-0.5), &pose(heading, roll), roll.abs());
        assert!(!step(106.0, 3.0) && !step(50.0, 9.0) && !step(30.0, 10.5), "rough ground");
        assert!(step(10.0, 14.0) && watch.is_over_an_edge());
        assert_eq!(watch.way_back(&pose(10.0, 14.0)), Some(1.0));
        assert_eq!(watch.way_back(&pose(95.0, 3.0)), Some(1.0));
        assert_eq!((watch.way_back(&pose(102.0, 3.0)), watch.is_over_an_edge()), (None, false));
    }

    #[test]
    fn a_robot_whose_nose_or_tail_hangs_over_an_edge_does_not_turn() {
        for (pitch, way) in [(0.2, -1.0), (-0.2, 1.0)] {
            let mut watch = LeanWatch::default();
            let rotation = UnitQuaternion::from_euler_angles(0.2, pitch, 0.3);
            let leaning = Pose::from_parts(Vector3::zeros().into(), rotation);
            assert!(!watch.leans(Some(-0.5), &pose(60.0, 3.0), 3.0) && watch.leans(Some(-0.5), &leaning, 16.0));
            assert!(watch.is_over_an_edge() && watch.way_back(&leaning).is_none());
            assert_eq!((watch.straight_away(), watch.is_over_an_edge()), (Some(way), false));
        }
    }

    #[test]
    fn on_a_slope_that_it_stands_on_anyway_it_may_turn_and_drive() {
        let mut watch = LeanWatch::default();
        assert!((0..36).all(|k| !watch.leans(Some(0.5), &pose(10.0 * f64::from(k), 15.0), 15.0)));
        let mut other = LeanWatch::default();
        assert!(!other.leans(Some(0.5), &pose(0.0, 3.0), 3.0) && !other.leans(None, &pose(5.0, 9.0), 9.0));
        assert!(!other.leans(Some(0.5), &pose(10.0, 16.0), 16.0), "what it leant by before it drove on does not count");
    }

    #[test]
    fn a_robot_that_begins_to_lean_on_its_way_goes_straight_back() {
        let mut watch = LeanWatch::default();
        // A slope of 20 degrees that comes within two metres, and bumps on the level.
        assert!((0..200).all(|k| !watch.leans_on_the_way(0.01 * f64::from(k), 0.1 * f64::from(k))));
        let mut watch = LeanWatch::default();
        assert!((0..200).all(|k| !watch.leans_on_the_way(0.01 * f64::from(k), [4.0, 15.0][k as usize / 5 % 2])));
        let mut watch = LeanWatch::default();
        let tilt = |k: u32| if k < 100 { 6.0 } else { 6.0 + 0.8 * f64::from(k - 100) };
        let stopped = (0..200).find(|&k| watch.leans_on_the_way(0.01 * f64::from(k), tilt(k)));
        assert!(matches!(stopped, Some(110..120)), "{stopped:?}");
        assert!(watch.is_over_an_edge() && watch.straight_away() == Some(-1.0) && !watch.is_over_an_edge());
    }

    #[test]
    fn what_it_leans_to_lies_downhill() {
        // Its left side is up: a roll about x.
        let leaning = pose(0.0, 20.0);
        let place = downhill(&leaning, 0.5);
        assert!(place.x.abs() < 1e-9 && (place.y + 0.5).abs() < 1e-9, "{place}");
        assert!((leaning * place).z < -0.1 && (downhill(&pose(0.0, 0.0), 0.5).coords.norm() - 0.5).abs() < 1e-9);
    }
}
