//! How far the robot has moved since an earlier sweep of its level laser: what the wheels of a skidding or stuck robot do not
//! tell.
//!
//! Points of the new sweep are put where the estimate has them and are matched to the lines through the neighbours of the
//! earlier sweep's points in their direction (A. Censi, "An ICP variant using a point-to-line metric", ICRA 2008); the motion left is
//! small, so that a few steps are enough. The rotation is nearly known from the gyroscopes.

use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};

use super::config::LaserModel;
use super::readings::SweepSample;
use crate::geometry::Pose;

/// Steps of the matching, and how far a point may lie from its line in the first and in the last one [m].
const STEPS: usize = 4;
const FAR_M: f64 = 0.3;
const NEAR_M: f64 = 0.1;
/// Neighbours on either side that make a line, at most and at least, how far away they may be [m], and how far two of them may
/// lie apart per metre of range.
const SIDE: usize = 12;
const LEAST_SIDE: usize = 2;
const SIDE_M: f64 = 0.3;
const GAP_PER_M: f64 = 0.06;
/// A line seen at less than this sine says little [-].
const GRAZING: f64 = 0.17;
/// A point this far off the plane of the earlier sweep has seen something else [m].
const OFF_PLANE_M: f64 = 0.1;
/// Between two sweeps the robot may have tilted by this [rad] and risen by this [m] at most: else sloping ground that both have
/// seen would look as if it had moved.
const TILTED: f64 = 0.004;
const RISEN_M: f64 = 0.01;
/// The same where only the turn is asked for: what stands upright tells it, tilted or not.
const WALLS_TILTED: f64 = 0.02;
const WALLS_RISEN_M: f64 = 0.05;
/// How well the gyroscopes know the turn between two sweeps [rad].
const TURN_SIGMA: f64 = 0.002;
/// Where that is asked for: how well the estimate has the way between them [m], and the turn, at the very most [rad].
const WAY_SIGMA_M: f64 = 0.1;
const WIDE_TURN_SIGMA: f64 = 0.02;
/// Neighbouring beams err alike: so many count as one.
const ALIKE: f64 = 4.0;

/// A place on a line, and the line's normal, in the plane of the laser.
#[derive(Debug, Clone, Copy)]
struct Mark {
    at: Vector2<f64>,
    normal: Vector2<f64>,
}

/// What the matching adds to the motion that the estimate has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// In the plane of the laser at the earlier sweep [m].
    pub metres: Vector2<f64>,
    /// Its covariance [m^2].
    pub covariance: Matrix2<f64>,
}

/// How much farther the robot has turned than the estimate has it, about the laser's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turn {
    /// To the left [rad].
    pub radians: f64,
    /// Its variance [rad^2].
    pub variance: f64,
}

/// How well the estimate has the way and the turn between two sweeps [m, rad].
#[derive(Debug, Clone, Copy)]
struct Expected {
    metres: f64,
    radians: f64,
}

/// An earlier sweep.
#[derive(Debug, Clone)]
pub(super) struct ReferenceSweep {
    first_angle: f64,
    angle_step: f64,
    robot_from_laser: Pose,
    marks: Vec<Option<Mark>>,
}

impl ReferenceSweep {
    pub fn new(sweep: &SweepSample) -> Self {
        let points: Vec<Option<Vector2<f64>>> = (0..sweep.ranges.len()).map(|beam| point(sweep, beam)).collect();
        let marks = (0..points.len()).map(|beam| mark(&points, beam)).collect();
        let (first_angle, angle_step) = (sweep.first_angle, sweep.angle_step);
        Self { first_angle, angle_step, robot_from_laser: sweep.robot_from_laser(), marks }
    }

    /// Matches a later sweep, put by `then_from_now`, the pose of the robot now in that of the earlier sweep, for the way between
    /// them. `None` where the surroundings do not tell, or too few of the points fit.
    pub fn shift(&self, sweep: &SweepSample, then_from_now: &Pose, config: &LaserModel) -> Option<Shift> {
        let expected = Expected { metres: f64::INFINITY, radians: TURN_SIGMA };
        let (off, covariance) = self.matched(sweep, then_from_now, [TILTED, RISEN_M], expected, config)?;
        let covariance = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let is_sure = covariance.symmetric_eigenvalues().max() < config.sigma_max_m.powi(2);
        is_sure.then(|| Shift { metres: off.xy(), covariance })
    }

    /// The same for the turn, which surroundings may tell that do not tell the way.
    pub fn turn(&self, sweep: &SweepSample, then_from_now: &Pose, config: &LaserModel) -> Option<Turn> {
        let expected = Expected { metres: WAY_SIGMA_M, radians: WIDE_TURN_SIGMA };
        let (off, covariance) = self.matched(sweep, then_from_now, [WALLS_TILTED, WALLS_RISEN_M], expected, config)?;
        let variance = covariance[(2, 2)];
        (variance < (0.2 * WIDE_TURN_SIGMA).powi(2)).then_some(Turn { radians: off.z, variance })
    }

    /// What the matching adds to `then_from_now` (two of translation, one of rotation about the laser), and its covariance.
    fn matched(
        &self,
        sweep: &SweepSample,
        then_from_now: &Pose,
        [tilted, risen_m]: [f64; 2],
        expected: Expected,
        config: &LaserModel,
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let up = then_from_now.rotation * Vector3::z();
        if up.xy().norm() > tilted || then_from_now.translation.vector.z.abs() > risen_m {
            return None;
        }
        let laser_then_from_now = self.robot_from_laser.inverse() * then_from_now * sweep.robot_from_laser();
        let placed: Vec<Vector2<f64>> = (0..sweep.ranges.len())
            .filter_map(|beam| point(sweep, beam))
            .map(|p| laser_then_from_now * Point3::new(p.x, p.y, 0.0))
            .filter(|p| p.z.abs() < OFF_PLANE_M)
            .map(|p| p.xy().coords)
            .collect();
        let centre = laser_then_from_now.translation.vector.xy();
        let mut off = Vector3::zeros();
        let mut fit = Fit::default();
        for step in 0..STEPS {
            let limit = if step + 1 < STEPS { FAR_M } else { NEAR_M };
            fit = self.fit(&placed, &centre, &off, limit, expected);
            off += fit.solve()?;
        }
        fit.judge(config).map(|covariance| (off, covariance))
    }

    /// Normal equations over the points, moved by `off` (two of translation, one of rotation about `centre`).
    fn fit(
        &self,
        placed: &[Vector2<f64>],
        centre: &Vector2<f64>,
        off: &Vector3<f64>,
        limit: f64,
        expected: Expected,
    ) -> Fit {
        let mut fit = Fit::default();
        let sigmas = Vector3::new(expected.metres, expected.metres, expected.radians);
        fit.normal = Matrix3::from_diagonal(&sigmas.map(|sigma| sigma.powi(-2)));
        fit.right = -fit.normal * off;
        for at in placed {
            let arm = at - centre;
            let at = at + off.xy() + off.z * Vector2::new(-arm.y, arm.x);
            let Some(mark) = self.towards(&at) else { continue };
            fit.candidates += 1;
            let residual = mark.normal.dot(&(mark.at - at));
            if residual.abs() > limit {
                continue;
            }
            let row = Vector3::new(mark.normal.x, mark.normal.y, mark.normal.y * arm.x - mark.normal.x * arm.y);
            fit.inliers += 1;
            fit.squares += residual * residual;
            fit.normal += row * row.transpose() / (ALIKE * RANGE_SIGMA.powi(2));
            fit.right += row * residual / (ALIKE * RANGE_SIGMA.powi(2));
        }
        fit
    }

    /// What the earlier sweep has seen in the direction of a place.
    fn towards(&self, at: &Vector2<f64>) -> Option<Mark> {
        let beam = (at.y.atan2(at.x) - self.first_angle) / self.angle_step;
        let beam = beam.round();
        (beam >= 0.0).then(|| self.marks.get(beam as usize).copied().flatten())?
    }
}

/// Standard deviation of a range that the fit is weighed with [m]; what the residuals show beyond it widens the covariance.
const RANGE_SIGMA: f64 = 0.015;

#[derive(Debug, Clone, Copy, Default)]
struct Fit {
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    candidates: usize,
    inliers: usize,
    squares: f64,
}

impl Fit {
    fn solve(&self) -> Option<Vector3<f64>> {
        (self.inliers >= 3).then(|| self.normal.cholesky().map(|c| c.solve(&self.right)))?
    }

    /// The covariance of what was found, where enough of the points fit and well enough.
    fn judge(&self, config: &LaserModel) -> Option<Matrix3<f64>> {
        let share = self.inliers as f64 / self.candidates.max(1) as f64;
        if self.inliers < config.least_beams as usize || share < config.least_share {
            return None;
        }
        let rms = (self.squares / self.inliers as f64).sqrt();
        let covariance = self.normal.try_inverse()? * (rms / RANGE_SIGMA).max(1.0).powi(2);
        (rms < config.rms_max_m).then_some(covariance)
    }
}

/// Where a beam has hit, in the plane of the laser.
fn point(sweep: &SweepSample, beam: usize) -> Option<Vector2<f64>> {
    let range = f64::from(*sweep.ranges.get(beam)?);
    let (sin, cos) = (sweep.first_angle + sweep.angle_step * beam as f64).sin_cos();
    (range > 0.05 && range.is_finite()).then(|| Vector2::new(range * cos, range * sin))
}

/// The line through a point and its neighbours of the same surface. Ranges are noisy, so it takes many of them: a line askew would
/// make every motion look longer.
fn mark(points: &[Option<Vector2<f64>>], beam: usize) -> Option<Mark> {
    let own = points[beam]?;
    let gap = GAP_PER_M * own.norm() + 0.05;
    let reach = |beams: &mut dyn Iterator<Item = usize>| {
        let mut last = own;
        let mut count = 0;
        for next in beams.map_while(|beam| points.get(beam).copied().flatten()).take(SIDE) {
            if (next - last).norm() > gap || (next - own).norm() > SIDE_M {
                break;
            }
            last = next;
            count += 1;
        }
        count
    };
    let (after, before) = (reach(&mut (beam + 1..points.len())), reach(&mut (0..beam).rev()));
    if after < LEAST_SIDE || before < LEAST_SIDE {
        return None;
    }
    let around = points[beam - before..=beam + after].iter().flatten();
    let count = (before + after + 1) as f64;
    let middle = around.clone().sum::<Vector2<f64>>() / count;
    let spread: Matrix2<f64> = around.map(|p| (p - middle) * (p - middle).transpose()).sum::<Matrix2<f64>>() / count;
    let eigen = spread.symmetric_eigen();
    let flat = usize::from(eigen.eigenvalues.x > eigen.eigenvalues.y);
    let normal: Vector2<f64> = eigen.eigenvectors.column(flat).into_owned();
    let is_line = eigen.eigenvalues[flat] < (0.1 * SIDE_M).powi(2).max(0.05 * eigen.eigenvalues[1 - flat]);
    let at = own - normal * normal.dot(&(own - middle));
    (is_line && normal.dot(&own).abs() > GRAZING * own.norm()).then_some(Mark { at, normal })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep of 180 degrees in half degrees from a place in a room of four walls with a pillar.
    fn sweep(x: f64, y: f64, yaw: f64, noise: u64) -> SweepSample {
        let mut random = crate::simulation::Noise::new(noise, 5);
        let walls = [
            ([-4.0, -3.0], [6.0, -3.0]),
            ([6.0, -3.0], [6.0, 4.0]),
            ([6.0, 4.0], [-4.0, 4.0]),
            ([-4.0, 4.0], [-4.0, -3.0]),
            ([3.0, 1.0], [3.0, 1.6]),
        ];
        let ranges = (0..361).map(|beam| {
            let (sin, cos) = (yaw - std::f64::consts::FRAC_PI_2 + 0.5_f64.to_radians() * f64::from(beam)).sin_cos();
            let hit = |(a, b): &([f64; 2], [f64; 2])| {
                let (u, v) = (b[0] - a[0], b[1] - a[1]);
                let d = cos * v - sin * u;
                let (px, py) = (a[0] - x, a[1] - y);
                let (t, s) = ((px * v - py * u) / d, (px * sin - py * cos) / d);
                (t > 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
            };
            (walls.iter().filter_map(hit).fold(f64::INFINITY, f64::min) + random.normal(0.015)) as f32
        });
        SweepSample {
            stamp_ns: 0,
            first_angle: -std::f64::consts::FRAC_PI_2,
            angle_step: 0.5_f64.to_radians(),
            mount_xyz: [0.5, 0.0, 0.4],
            mount_yaw: 0.0,
            ranges: ranges.collect(),
        }
    }

    /// The robot whose laser is at a place.
    fn robot(x: f64, y: f64, yaw: f64) -> Pose {
        Pose::new(Vector3::new(x, y, 0.0), Vector3::z() * yaw) * Pose::translation(-0.5, 0.0, 0.0)
    }

    #[test]
    fn the_way_between_two_sweeps_is_found_to_half_a_centimetre_whatever_the_wheels_say() {
        let reference = ReferenceSweep::new(&sweep(0.0, 0.0, 0.0, 1));
        for (k, (x, y, yaw)) in [(0.1, 0.02, 0.05), (0.0, 0.0, 0.0), (0.05, -0.04, -0.15)].into_iter().enumerate() {
            let truth = robot(0.0, 0.0, 0.0).inverse() * robot(x, y, yaw);
            for claimed in [-0.1, 0.0, 0.15] {
                let mut predicted = truth;
                predicted.translation.x += claimed;
                let found =
                    reference.shift(&sweep(x, y, yaw, k as u64 + 2), &predicted, &LaserModel::default()).unwrap();
                let off = found.metres - Vector2::new(-claimed, 0.0);
                assert!(off.norm() < 0.006, "{off} after {x} {y} {yaw}");
                let distance = off.dot(&(found.covariance.try_inverse().unwrap() * off));
                assert!(distance < 12.0, "{distance}");
            }
        }
    }

    #[test]
    fn a_corridor_does_not_tell_how_far_the_robot_has_gone_along_it() {
        let corridor = |noise| {
            let mut sweep = sweep(0.0, 0.0, 0.0, noise);
            for (beam, range) in sweep.ranges.iter_mut().enumerate() {
                let sin = (sweep.first_angle + sweep.angle_step * beam as f64).sin();
                let wall = 1.5 / sin.abs();
                *range = if wall < 15.0 { wall as f32 } else { f32::NAN };
            }
            sweep
        };
        let reference = ReferenceSweep::new(&corridor(1));
        let moved = Pose::translation(0.2, 0.0, 0.0);
        assert_eq!(reference.shift(&corridor(2), &moved, &LaserModel::default()), None);
        // But well how far it has turned.
        let turn = reference.turn(&corridor(2), &moved, &LaserModel::default()).unwrap();
        assert!(turn.radians.powi(2) < 9.0 * turn.variance && turn.variance.sqrt() < 0.002, "{turn:?}");
    }

    #[test]
    fn the_turn_between_two_sweeps_is_found_to_a_tenth_of_a_degree_whatever_the_gyroscopes_say() {
        let reference = ReferenceSweep::new(&sweep(0.0, 0.0, 0.0, 1));
        for (k, (x, y, yaw)) in [(1.4, 0.1, 0.05), (0.0, 0.0, 0.0), (0.05, -0.04, 0.5)].into_iter().enumerate() {
            let truth = robot(0.0, 0.0, 0.0).inverse() * robot(x, y, yaw);
            for claimed in [-0.03, 0.0, 0.03] {
                let predicted = truth * Pose::rotation(Vector3::z() * claimed);
                let found =
                    reference.turn(&sweep(x, y, yaw, k as u64 + 2), &predicted, &LaserModel::default()).unwrap();
                let off = found.radians + claimed;
                assert!(off.abs() < 1.7e-3, "{off} after {x} {y} {yaw}");
                assert!(off.powi(2) < 12.0 * found.variance, "{off} {found:?}");
            }
        }
    }

    #[test]
    fn a_sweep_of_something_else_or_of_nothing_says_nothing() {
        let reference = ReferenceSweep::new(&sweep(0.0, 0.0, 0.0, 1));
        let mut other = sweep(2.0, 1.8, 1.0, 2);
        assert_eq!(reference.shift(&other, &Pose::identity(), &LaserModel::default()), None);
        other.ranges.fill(f32::NAN);
        assert_eq!(reference.shift(&other, &Pose::identity(), &LaserModel::default()), None);
        assert_eq!(ReferenceSweep::new(&other).shift(&other, &Pose::identity(), &LaserModel::default()), None);
        other.ranges.clear();
        assert_eq!(reference.shift(&other, &Pose::identity(), &LaserModel::default()), None);
    }
}
