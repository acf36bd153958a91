//! Scores a whole scan: each point's own F_l and B_l first, then the means over the neighbours, straight into the
//! caller's records.

use nalgebra::{UnitQuaternion, Vector3};

use super::config::{HeightForm, ObstacleForm, ScoreConfig, ScoreConfigError};
use super::ground_height::{GroundHeight, GroundHeightOrigin};
use super::navigable::{height_factor, slope_factor};
use super::obstacle::{obstacle_score, within_reach};
use super::point_score::PointScore;
use crate::scan::{Point, ScanView};
use crate::surface::{Surface, SurfacePoint};
use crate::threads::for_blocks;

/// Why a scan has no scores.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScoreError {
    /// Scan, surface and records must describe the same points.
    #[error("the scan has {scan} points, its surface {surface}, and there are {out} records: all must be equal")]
    LengthMismatch {
        /// Points of the scan.
        scan: usize,
        /// Points of the surface.
        surface: usize,
        /// Records for the scores.
        out: usize,
    },
    /// A setting outside its range.
    #[error(transparent)]
    Config(#[from] ScoreConfigError),
}

/// What a scored scan amounts to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreSummary {
    /// Points with a return and a normal.
    pub valid: usize,
    /// Of these, points the robot can reach.
    pub reachable: usize,
    /// Mean D of the valid points, 0 when there are none.
    pub mean_quality: f64,
    /// Height of the scanner over the ground under the robot that was used [m].
    pub scanner_height_m: f64,
    /// Where that height is from.
    pub ground_origin: GroundHeightOrigin,
}

/// A point's own scores before its neighbours are asked.
#[derive(Debug, Clone, Copy, Default)]
struct Local {
    navigable: f32,
    obstacle: f32,
    state: State,
}

/// What is known of a point.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum State {
    /// It does not belong to the surface.
    #[default]
    Invalid,
    /// It does, but the robot cannot get there.
    OutOfReach,
    /// It can.
    Reachable,
}

/// Scores one scan after the other. Its buffer grows to the largest scan and is then reused.
#[derive(Debug, Default)]
pub struct Scorer {
    local: Vec<Local>,
}

/// Points handled together; a block of work is a whole number of these.
const CHUNK: usize = 1024;

impl Scorer {
    /// A scorer without buffers yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Scores every point of `scan` into the record of the same index in `out`. `surface` is the scan's own,
    /// `level_from_scanner` the rotation of its alignment, `ground` from [`GroundHeight::resolve`].
    ///
    /// # Errors
    /// [`ScoreError`] when the three do not describe the same number of points, or a setting is wrong; `out` is then
    /// untouched.
    pub fn score(
        &mut self,
        scan: ScanView<'_>,
        surface: &Surface,
        level_from_scanner: &UnitQuaternion<f64>,
        ground: GroundHeight,
        config: &ScoreConfig,
        out: &mut [PointScore],
    ) -> Result<ScoreSummary, ScoreError> {
        config.validate()?;
        let points = scan.points;
        if points.len() != surface.len() || points.len() != out.len() {
            return Err(ScoreError::LengthMismatch { scan: points.len(), surface: surface.len(), out: out.len() });
        }
        let rule = Rule::new(level_from_scanner, ground, config);
        self.local.resize(points.len(), Local::default());
        for_blocks(&mut self.local, CHUNK, config.threads, |first, block| {
            let start = first * CHUNK;
            for ((local, point), shape) in block.iter_mut().zip(&points[start..]).zip(&surface.points()[start..]) {
                *local = rule.local(point, shape);
            }
        });
        let local = &self.local;
        for_blocks(out, CHUNK, config.threads, |first, block| {
            for (offset, record) in block.iter_mut().enumerate() {
                *record = rule.record(first * CHUNK + offset, local, surface);
            }
        });
        Ok(self.summary(surface, ground))
    }

    fn summary(&self, surface: &Surface, ground: GroundHeight) -> ScoreSummary {
        let (mut valid, mut reachable, mut quality) = (0usize, 0usize, 0.0f64);
        for (local, shape) in self.local.iter().zip(surface.points()) {
            valid += usize::from(local.state != State::Invalid);
            reachable += usize::from(local.state == State::Reachable);
            quality += f64::from(shape.quality);
        }
        ScoreSummary {
            valid,
            reachable,
            mean_quality: if valid == 0 { 0.0 } else { quality / valid as f64 },
            scanner_height_m: ground.scanner_height_m,
            ground_origin: ground.origin,
        }
    }
}

/// The formulas with their constants, in single precision.
struct Rule {
    /// The rows of the rotation from the scanner's frame to the level one.
    level_from_scanner: [[f32; 3]; 3],
    scanner_height: f32,
    robot_height: f32,
    cos_theta: f32,
    tan_theta: f32,
    weights: [f32; 4],
    height_form: HeightForm,
    obstacle_form: ObstacleForm,
}

impl Rule {
    fn new(level_from_scanner: &UnitQuaternion<f64>, ground: GroundHeight, config: &ScoreConfig) -> Self {
        let theta = config.theta_deg.to_radians();
        let rotation = level_from_scanner.to_rotation_matrix();
        Self {
            level_from_scanner: [0, 1, 2].map(|row| [0, 1, 2].map(|col| rotation[(row, col)] as f32)),
            scanner_height: ground.scanner_height_m as f32,
            robot_height: config.robot_height_m as f32,
            cos_theta: theta.cos() as f32,
            tan_theta: theta.tan() as f32,
            weights: [config.w_l, config.w_g, config.w_bl, config.w_bg].map(|w| w as f32),
            height_form: config.height_form,
            obstacle_form: config.obstacle_form,
        }
    }

    fn to_level(&self, v: [f32; 3]) -> [f32; 3] {
        let row = |r: usize| {
            let [x, y, z] = self.level_from_scanner[r];
            x * v[0] + y * v[1] + z * v[2]
        };
        [row(0), row(1), row(2)]
    }

    /// F_l (3.14) and B_l (3.19) of a point.
    fn local(&self, point: &Point, shape: &SurfacePoint) -> Local {
        if !shape.is_valid() {
            return Local::default();
        }
        let [x, y, z] = self.to_level([point.x, point.y, point.z]);
        let (height, distance) = (z + self.scanner_height, length(x, y));
        if !within_reach(height, distance, self.tan_theta, self.robot_height) {
            return Local { state: State::OutOfReach, ..Local::default() };
        }
        let [normal_x, normal_y, normal_z] = self.to_level(shape.normal);
        let h = height_factor(self.height_form, height, distance, self.tan_theta);
        let navigable = slope_factor(normal_z, self.cos_theta) * h;
        let obstacle = if height <= self.robot_height {
            obstacle_score(self.obstacle_form, length(normal_x, normal_y).min(1.0), shape.incidence, || h)
        } else {
            0.0
        };
        Local { navigable, obstacle, state: State::Reachable }
    }

    /// The record of a point: its own scores and the means of its neighbours' (3.17 to 3.21), its quality and shape.
    fn record(&self, index: usize, local: &[Local], surface: &Surface) -> PointScore {
        let (own, shape) = (&local[index], &surface.points()[index]);
        let mut record = PointScore { flags: PointScore::KEPT_WITHOUT * surface.kept_bits(index), ..PointScore::NONE };
        if own.state == State::Invalid {
            return record;
        }
        record.flags |= PointScore::VALID;
        record.quality = PointScore::quantise(shape.quality);
        record.area = shape.area;
        record.set_normal(&Vector3::from(shape.normal));
        if own.state == State::OutOfReach {
            return record;
        }
        record.flags |= PointScore::REACHABLE;
        let (mut navigable, mut obstacle, mut count) = (0.0, 0.0, 0.0f32);
        surface.for_each_neighbour(index, |neighbour| {
            let other = &local[neighbour];
            if other.state != State::Invalid {
                navigable += other.navigable;
                obstacle += other.obstacle;
                count += 1.0;
            }
        });
        let [w_l, w_g, w_bl, w_bg] = self.weights;
        let share = 1.0 / count.max(1.0);
        record.navigable = PointScore::quantise(w_l * own.navigable + w_g * navigable * share);
        record.obstacle = PointScore::quantise(w_bl * own.obstacle + w_bg * obstacle * share);
        record
    }
}

/// The length of a vector in the plane. (`hypot` guards against overflow, which metres do not need, at ten times the
/// cost.)
fn length(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
#[path = "scorer_tests.rs"]
mod tests;
