//! Scores a whole scan: the formulas of one point, and the way over all points, straight into the caller's records.

use std::sync::{Mutex, PoisonError};

use nalgebra::UnitQuaternion;

use super::cloud::ScoreCloud;
use super::config::{HeightForm, ObstacleForm, ScoreConfig, ScoreConfigError};
use super::ground_height::{GroundHeight, GroundHeightOrigin};
use super::lines::ScoreLines;
use super::navigable::{height_factor, slope_factor};
use super::obstacle::{obstacle_score, within_reach};
use super::point_score::PointScore;
use crate::scan::{Grid, Point, ScanView};
use crate::simd::widest;
use crate::surface::{Surface, Topology};
use crate::threads::for_each;

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

/// The point belongs to the surface.
pub(super) const VALID: u32 = PointScore::VALID as u32;
/// The robot can get there.
pub(super) const REACHABLE: u32 = PointScore::REACHABLE as u32;
/// The normal's z component is negative.
pub(super) const NEGATIVE: u32 = PointScore::NORMAL_Z_NEGATIVE as u32;
/// The point is reachable and below the robot's height: it may be an obstacle.
pub(super) const LOW: u32 = 1 << 3;

/// A point's own scores, before its neighbours are asked.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Own {
    /// Its position in the level frame [m].
    pub level: [f32; 3],
    /// F_l and B_l; 0 where there are none.
    pub navigable: f32,
    pub obstacle: f32,
    /// [`VALID`], [`REACHABLE`], [`NEGATIVE`] and [`LOW`].
    pub state: u32,
}

/// Blocks a thread: enough that all end at about the same time.
const BLOCKS_A_THREAD: usize = 4;

/// Scores one scan after the other. Its buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct Scorer {
    blocks: Vec<ScoreLines>,
    cloud: ScoreCloud,
}

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
        let tally = match surface.topology() {
            Some(topology) => self.score_lines(&rule, points, surface, &topology, config.threads, out),
            None => self.cloud.score(&rule, points, surface, config.threads, out),
        };
        Ok(tally.summary(ground))
    }

    fn score_lines(
        &mut self,
        rule: &Rule,
        points: &[Point],
        surface: &Surface,
        topology: &Topology,
        threads: usize,
        out: &mut [PointScore],
    ) -> Tally {
        let Grid { rows, cols } = topology.grid;
        let blocks = if threads > 1 { threads * BLOCKS_A_THREAD } else { 1 };
        let lines = rows.div_ceil(blocks).max(1);
        self.blocks.resize_with(rows.div_ceil(lines), ScoreLines::default);
        let total = Mutex::new(Tally::default());
        let parts = out.chunks_mut((lines * cols).max(1)).zip(&mut self.blocks).enumerate();
        for_each(parts, threads, |(k, (out, block))| {
            let tally = widest(
                #[inline(always)]
                || block.score(rule, points, surface, topology, k * lines, out),
            );
            total.lock().unwrap_or_else(PoisonError::into_inner).add(&tally);
        });
        total.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What is counted. Whole numbers: the order in which they come does not matter.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub valid: u64,
    pub reachable: u64,
    /// Sum of D [1/65535].
    pub quality: u64,
}

impl Tally {
    pub(super) fn add(&mut self, other: &Self) {
        self.valid += other.valid;
        self.reachable += other.reachable;
        self.quality += other.quality;
    }

    fn summary(&self, ground: GroundHeight) -> ScoreSummary {
        ScoreSummary {
            valid: self.valid as usize,
            reachable: self.reachable as usize,
            mean_quality: self.quality as f64 / (65535.0 * self.valid.max(1) as f64),
            scanner_height_m: ground.scanner_height_m,
            ground_origin: ground.origin,
        }
    }
}

/// The formulas with their constants, in single precision.
pub(super) struct Rule {
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
            level_from_scanner: rotation.matrix().transpose().cast::<f32>().data.0,
            scanner_height: ground.scanner_height_m as f32,
            robot_height: config.robot_height_m as f32,
            cos_theta: theta.cos() as f32,
            tan_theta: theta.tan() as f32,
            weights: [config.w_l, config.w_g, config.w_bl, config.w_bg].map(|w| w as f32),
            height_form: config.height_form,
            obstacle_form: config.obstacle_form,
        }
    }

    /// Whether steps of the mesh count as obstacles.
    #[inline(always)]
    pub(super) fn has_steps(&self) -> bool {
        self.obstacle_form == ObstacleForm::Stepped
    }

    #[inline(always)]
    fn to_level(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let [a, b, c] = &self.level_from_scanner;
        [a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z]
    }

    #[inline(always)]
    pub(super) fn height_form(&self) -> HeightForm {
        self.height_form
    }

    #[inline(always)]
    pub(super) fn obstacle_form(&self) -> ObstacleForm {
        self.obstacle_form
    }

    /// F_l (3.14) and B_l (3.19) of a point of the scanner's frame with its normal, which is zero where there is none.
    pub(super) fn own(&self, point: [f32; 3], normal: [f32; 3], incidence: f32) -> Own {
        self.own_by_forms((self.height_form, self.obstacle_form), point, normal, incidence)
    }

    /// As [`Rule::own`], with the rule's forms known to the compiler.
    #[inline(always)]
    pub(super) fn own_by_forms(
        &self,
        (height_form, obstacle_form): (HeightForm, ObstacleForm),
        point: [f32; 3],
        normal: [f32; 3],
        incidence: f32,
    ) -> Own {
        let is_valid = (normal[0] != 0.0) | (normal[1] != 0.0) | (normal[2] != 0.0);
        let level = self.to_level(point);
        let (height, distance) = (level[2] + self.scanner_height, length(level[0], level[1]));
        let is_reachable = is_valid & within_reach(height, distance, self.tan_theta, self.robot_height);
        let is_low = is_reachable & (height <= self.robot_height);
        let [normal_x, normal_y, normal_z] = self.to_level(normal);
        let h = height_factor(height_form, height, distance, self.tan_theta);
        let f = slope_factor(normal_z, self.cos_theta) * h;
        let horizontal = length(normal_x, normal_y).min(1.0);
        let b = obstacle_score(obstacle_form, horizontal, incidence, h);
        let bit = |holds: bool, bit: u32| if holds { bit } else { 0 };
        Own {
            level,
            navigable: if is_reachable { f } else { 0.0 },
            obstacle: if is_low { b } else { 0.0 },
            state: bit(is_valid, VALID)
                | bit(is_reachable, REACHABLE)
                | bit(normal[2] < 0.0, NEGATIVE)
                | bit(is_low, LOW),
        }
    }

    /// F (3.18) and B (3.21) from a point's own scores and those of its neighbours.
    #[inline(always)]
    pub(super) fn combine(&self, [f, b]: [f32; 2], [f_around, b_around]: [f32; 2]) -> [f32; 2] {
        let [w_l, w_g, w_bl, w_bg] = self.weights;
        [w_l * f + w_g * f_around, w_bl * b + w_bg * b_around]
    }
}

/// The length of a vector in the plane. (`hypot` guards against overflow, which metres do not need, at ten times the
/// cost.)
#[inline(always)]
fn length(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
#[path = "scorer_tests.rs"]
mod tests;
