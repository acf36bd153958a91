//! A path as straight pieces, and where the robot is along it.

use nalgebra::{Point3, Vector2};
use thiserror::Error;

use crate::geometry::Pose;

/// Why waypoints are no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PathError {
    /// Fewer than one waypoint.
    #[error("the path has no waypoint")]
    Empty,
    /// A coordinate is not finite.
    #[error("waypoint {index} is not finite")]
    NotFinite {
        /// Which.
        index: usize,
    },
}

/// Straight pieces between waypoints.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    points: Vec<[f64; 3]>,
    /// Distance of each waypoint from the first, along the path, in plan [m].
    along: Vec<f64>,
}

/// The nearest place of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Projection {
    /// Distance from the first waypoint along the path [m].
    pub along: f64,
    /// Distance of the robot from it [m].
    pub off: f64,
}

impl Path {
    /// Waypoints in the order in which they are driven to [m, map frame]; repeated ones count once.
    ///
    /// # Errors
    /// See [`PathError`].
    pub fn new(waypoints: &[[f64; 3]]) -> Result<Self, PathError> {
        if let Some(index) = waypoints.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(PathError::NotFinite { index });
        }
        let mut points: Vec<[f64; 3]> = Vec::with_capacity(waypoints.len());
        let mut along: Vec<f64> = Vec::with_capacity(waypoints.len());
        for point in waypoints {
            let step = points.last().map(|last| (point[0] - last[0]).hypot(point[1] - last[1]));
            if step.is_none_or(|step| step > 1e-3) {
                along.push(along.last().copied().unwrap_or(0.0) + step.unwrap_or(0.0));
                points.push(*point);
            }
        }
        if points.is_empty() { Err(PathError::Empty) } else { Ok(Self { points, along }) }
    }

    /// Its length in plan [m].
    #[must_use]
    pub fn length(&self) -> f64 {
        self.along.last().copied().unwrap_or(0.0)
    }

    /// The end of the first piece and its distance, if it leads straight back from how the robot stands and others follow [m].
    pub(super) fn leads_back(&self, map_from_robot: &Pose) -> Option<(Vector2<f64>, f64)> {
        let &[_, second, _, ..] = self.points.as_slice() else { return None };
        let height = map_from_robot.translation.z;
        let own = map_from_robot.inverse_transform_point(&Point3::new(second[0], second[1], height));
        (own.x < -0.25 && own.y.abs() < -own.x).then(|| (Vector2::new(second[0], second[1]), own.x.hypot(own.y)))
    }

    /// Moves it as a whole; what is left of it is as long as before but for the tilt of the motion, which is next to none.
    pub fn move_by(&mut self, new_from_old: &Pose) {
        for point in &mut self.points {
            *point = (new_from_old * Point3::from(*point)).coords.into();
        }
    }

    /// Where it leads.
    #[must_use]
    pub fn goal(&self) -> Vector2<f64> {
        self.plan(self.points.len() - 1)
    }

    /// Number of the waypoint that a place along the path is driven to.
    #[must_use]
    pub fn waypoint_after(&self, along: f64) -> usize {
        self.along.partition_point(|at| *at <= along).min(self.points.len() - 1)
    }

    /// Distance of a waypoint from the first along the path [m].
    pub(super) fn along_of(&self, waypoint: usize) -> f64 {
        self.along[waypoint.min(self.along.len() - 1)]
    }

    fn plan(&self, index: usize) -> Vector2<f64> {
        Vector2::new(self.points[index][0], self.points[index][1])
    }

    /// Direction of the piece that ends at a waypoint; of the first piece for the first.
    pub(super) fn direction(&self, waypoint: usize) -> Vector2<f64> {
        if self.points.len() < 2 {
            return Vector2::x();
        }
        let end = waypoint.clamp(1, self.points.len() - 1);
        (self.plan(end) - self.plan(end - 1)).normalize()
    }

    /// By how much the path bends at a waypoint [rad].
    pub(super) fn bend(&self, waypoint: usize) -> f64 {
        if waypoint == 0 || waypoint + 1 >= self.points.len() {
            return 0.0;
        }
        let (before, after) = (self.direction(waypoint), self.direction(waypoint + 1));
        before.perp(&after).atan2(before.dot(&after)).abs()
    }

    /// The place so far along the path; behind `last`, straight on beyond it.
    pub(super) fn place(&self, along: f64, last: usize) -> Vector2<f64> {
        if self.points.len() < 2 {
            return self.goal();
        }
        let end = self.along.partition_point(|at| *at < along).clamp(1, last.max(1));
        self.plan(end) + (along - self.along[end]) * self.direction(end)
    }

    /// Height of the path there, linear between waypoints [m].
    pub(super) fn height(&self, along: f64) -> f64 {
        let end = self.along.partition_point(|at| *at < along).min(self.points.len() - 1);
        if end == 0 {
            return self.points[0][2];
        }
        let share = ((along - self.along[end - 1]) / (self.along[end] - self.along[end - 1])).clamp(0.0, 1.0);
        self.points[end - 1][2] + share * (self.points[end][2] - self.points[end - 1][2])
    }

    /// The nearest place of the path between two distances along it.
    pub(super) fn project(&self, at: &Vector2<f64>, from: f64, to: f64) -> Projection {
        let mut best = Projection { along: from, off: (self.place(from, self.points.len() - 1) - at).norm() };
        for end in 1..self.points.len() {
            let (begin, until) = (self.along[end - 1].max(from), self.along[end].min(to));
            if begin > until {
                continue;
            }
            let offset = (at - self.plan(end - 1)).dot(&self.direction(end));
            let along = (self.along[end - 1] + offset).clamp(begin, until);
            let off = (self.plan(end - 1) + (along - self.along[end - 1]) * self.direction(end) - at).norm();
            if off < best.off {
                best = Projection { along, off };
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Path {
        Path::new(&[[0.0, 0.0, 0.0], [2.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 3.0, 1.0]]).unwrap()
    }

    #[test]
    fn a_path_knows_its_length_bends_and_heights() {
        let path = corner();
        assert!((path.length() - 5.0).abs() < 1e-12 && (path.height(1.0) - 0.5).abs() < 1e-12);
        assert!((path.bend(1) - std::f64::consts::FRAC_PI_2).abs() < 1e-12 && path.bend(2) == 0.0);
        assert_eq!((path.waypoint_after(0.5), path.waypoint_after(2.5)), (1, 2));
    }

    #[test]
    fn a_robot_is_projected_to_the_nearest_place_ahead() {
        let path = corner();
        let at = path.project(&Vector2::new(1.0, 0.3), 0.0, 1.5);
        assert!((at.along - 1.0).abs() < 1e-12 && (at.off - 0.3).abs() < 1e-12);
        let round = path.project(&Vector2::new(2.5, 1.0), 1.0, 5.0);
        assert!((round.along - 3.0).abs() < 1e-12 && (round.off - 0.5).abs() < 1e-12);
    }

    #[test]
    fn waypoints_that_are_no_path_are_refused() {
        assert_eq!(Path::new(&[]), Err(PathError::Empty));
        assert_eq!(Path::new(&[[0.0; 3], [f64::NAN, 0.0, 0.0]]), Err(PathError::NotFinite { index: 1 }));
    }
}
