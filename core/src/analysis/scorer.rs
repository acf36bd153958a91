//! Scores a whole scan: each point's own F_l and B_l first, then the means over the neighbours, straight into the
//! caller's records.

use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{UnitQuaternion, Vector3};

use super::config::{HeightForm, ObstacleForm, ScoreConfig, ScoreConfigError};
use super::ground_height::{GroundHeight, GroundHeightOrigin};
use super::navigable::{height_factor, slope_factor};
use super::obstacle::{obstacle_score, within_reach};
use super::point_score::PointScore;
use crate::scan::{Point, ScanView};
use crate::simd::widest;
use crate::surface::{Surface, SurfacePoint};
use crate::threads::{for_blocks, for_each};

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

/// Every point's own scores before its neighbours are asked; 0 where there are none.
#[derive(Debug, Default)]
struct Local {
    navigable: Vec<f32>,
    obstacle: Vec<f32>,
    /// [`VALID`] and [`REACHABLE`].
    state: Vec<u8>,
}

/// The point belongs to the surface.
const VALID: u8 = 1;
/// The robot can get there.
const REACHABLE: u8 = 1 << 1;

/// Points worked on together.
const LANES: usize = 8;

/// Scores one scan after the other. Its buffers grow to the largest scan and are then reused.
#[derive(Debug, Default)]
pub struct Scorer {
    local: Local,
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
        let Local { navigable, obstacle, state } = &mut self.local;
        navigable.resize(points.len(), 0.0);
        obstacle.resize(points.len(), 0.0);
        state.resize(points.len(), 0);
        for_blocks3([navigable, obstacle], state, config.threads, |start, [navigable, obstacle], state| {
            let shapes = &surface.points()[start..start + state.len()];
            let points = &points[start..start + state.len()];
            widest(
                #[inline(always)]
                || rule.score_locally(points, shapes, navigable, obstacle, state),
            );
        });
        let (local, tally) = (&self.local, Tally::default());
        for_blocks(out, CHUNK, config.threads, |first, block| {
            widest(
                #[inline(always)]
                || rule.record(first * CHUNK, block, local, surface, &tally),
            );
        });
        Ok(tally.summary(ground))
    }
}

/// Cuts three arrays of the same length into blocks.
fn for_blocks3(
    [first, second]: [&mut [f32]; 2],
    third: &mut [u8],
    threads: usize,
    work: impl Fn(usize, [&mut [f32]; 2], &mut [u8]) + Sync,
) {
    let block = third.len().div_ceil(threads.max(1) * 4).next_multiple_of(CHUNK);
    let parts = first.chunks_mut(block).zip(second.chunks_mut(block)).zip(third.chunks_mut(block)).enumerate();
    for_each(parts, threads, |(k, ((first, second), third))| work(k * block, [first, second], third));
}

/// What is counted over all blocks. Whole numbers: the order in which they come does not matter.
#[derive(Debug, Default)]
struct Tally {
    valid: AtomicU64,
    reachable: AtomicU64,
    quality: AtomicU64,
}

impl Tally {
    fn summary(&self, ground: GroundHeight) -> ScoreSummary {
        let read = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let valid = read(&self.valid) as usize;
        ScoreSummary {
            valid,
            reachable: read(&self.reachable) as usize,
            mean_quality: read(&self.quality) as f64 / (65535.0 * valid.max(1) as f64),
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

    #[inline(always)]
    fn to_level(&self, x: f32, y: f32, z: f32) -> [f32; 3] {
        let [a, b, c] = &self.level_from_scanner;
        [a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z]
    }

    /// F_l (3.14) and B_l (3.19) of some points.
    #[inline(always)]
    fn score_locally(
        &self,
        points: &[Point],
        shapes: &[SurfacePoint],
        navigable: &mut [f32],
        obstacle: &mut [f32],
        state: &mut [u8],
    ) {
        let count = points.len();
        let (shapes, navigable) = (&shapes[..count], &mut navigable[..count]);
        let (obstacle, state) = (&mut obstacle[..count], &mut state[..count]);
        for start in (0..count).step_by(LANES) {
            let range = start..(start + LANES).min(count);
            // Half of a scan is sky.
            if shapes[range.clone()].iter().all(|shape| shape.area == 0.0) {
                navigable[range.clone()].fill(0.0);
                obstacle[range.clone()].fill(0.0);
                state[range].fill(0);
                continue;
            }
            for k in range {
                let (point, shape) = (&points[k], &shapes[k]);
                let [nx, ny, nz] = shape.normal;
                let is_valid = (nx != 0.0) | (ny != 0.0) | (nz != 0.0);
                let [x, y, z] = self.to_level(point.x, point.y, point.z);
                let (height, distance) = (z + self.scanner_height, length(x, y));
                let is_reachable = is_valid & within_reach(height, distance, self.tan_theta, self.robot_height);
                let [normal_x, normal_y, normal_z] = self.to_level(nx, ny, nz);
                let h = height_factor(self.height_form, height, distance, self.tan_theta);
                let f = slope_factor(normal_z, self.cos_theta) * h;
                let horizontal = length(normal_x, normal_y).min(1.0);
                let b = obstacle_score(self.obstacle_form, horizontal, shape.incidence, h);
                navigable[k] = if is_reachable { f } else { 0.0 };
                obstacle[k] = if is_reachable & (height <= self.robot_height) { b } else { 0.0 };
                state[k] = u8::from(is_valid) | u8::from(is_reachable) << 1;
            }
        }
    }

    /// The records of the points from `first` on: their own scores and the means of their neighbours' (3.17 to 3.21),
    /// their quality and shape.
    #[inline(always)]
    fn record(&self, first: usize, out: &mut [PointScore], local: &Local, surface: &Surface, tally: &Tally) {
        let (mut valid, mut reachable, mut quality) = (0u64, 0u64, 0u64);
        let offsets = surface.link_offsets();
        for (group, records) in out.chunks_mut(LANES).enumerate() {
            let start = first + group * LANES;
            let links = surface.links().get(start..).and_then(<[u8]>::first_chunk::<LANES>);
            let around = offsets.filter(|_| records.len() == LANES).zip(links);
            let around = around.filter(|(offsets, _)| surface.is_inside(start, LANES, offsets));
            let means = match around {
                Some((_, links)) if u64::from_ne_bytes(*links) == 0 => [[0.0; LANES]; 2],
                Some((offsets, links)) => neighbour_means(start, &offsets, links, local),
                None => one_by_one(start, records.len(), local, surface),
            };
            for (k, record) in records.iter_mut().enumerate() {
                let index = start + k;
                *record = PointScore { flags: PointScore::KEPT_WITHOUT * surface.kept_bits(index), ..PointScore::NONE };
                let state = local.state[index];
                if state & VALID == 0 {
                    continue;
                }
                let shape = &surface.points()[index];
                record.flags |= PointScore::VALID;
                record.quality = PointScore::quantise(shape.quality);
                record.area = shape.area;
                record.set_normal(&Vector3::from(shape.normal));
                valid += 1;
                quality += u64::from(record.quality);
                if state & REACHABLE == 0 {
                    continue;
                }
                reachable += 1;
                record.flags |= PointScore::REACHABLE;
                let [w_l, w_g, w_bl, w_bg] = self.weights;
                record.navigable = PointScore::quantise(w_l * local.navigable[index] + w_g * means[0][k]);
                record.obstacle = PointScore::quantise(w_bl * local.obstacle[index] + w_bg * means[1][k]);
            }
        }
        tally.valid.fetch_add(valid, Ordering::Relaxed);
        tally.reachable.fetch_add(reachable, Ordering::Relaxed);
        tally.quality.fetch_add(quality, Ordering::Relaxed);
    }
}

/// The means of F_l and B_l over the neighbours of eight cells from `start` on, none of which lies at the grid's edge.
#[inline(always)]
fn neighbour_means(start: usize, offsets: &[isize; 8], links: &[u8; LANES], local: &Local) -> [[f32; LANES]; 2] {
    let (mut navigable, mut obstacle, mut count) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
    for (bit, offset) in offsets.iter().enumerate() {
        let at = start.wrapping_add_signed(*offset);
        let Some(f) = local.navigable.get(at..).and_then(<[f32]>::first_chunk::<LANES>) else { continue };
        let Some(b) = local.obstacle.get(at..).and_then(<[f32]>::first_chunk::<LANES>) else { continue };
        let Some(state) = local.state.get(at..).and_then(<[u8]>::first_chunk::<LANES>) else { continue };
        for k in 0..LANES {
            let is_linked = (links[k] >> bit) & state[k] & VALID != 0;
            navigable[k] += if is_linked { f[k] } else { 0.0 };
            obstacle[k] += if is_linked { b[k] } else { 0.0 };
            count[k] += if is_linked { 1.0 } else { 0.0 };
        }
    }
    for k in 0..LANES {
        let share = 1.0 / count[k].max(1.0);
        navigable[k] *= share;
        obstacle[k] *= share;
    }
    [navigable, obstacle]
}

/// As [`neighbour_means`], at the edges of a grid and without one.
fn one_by_one(start: usize, len: usize, local: &Local, surface: &Surface) -> [[f32; LANES]; 2] {
    let [mut navigable_means, mut obstacle_means] = [[0.0; LANES]; 2];
    let means = navigable_means.iter_mut().zip(&mut obstacle_means);
    for (k, (navigable_mean, obstacle_mean)) in means.enumerate().take(len) {
        let (mut navigable, mut obstacle, mut count) = (0.0f32, 0.0f32, 0.0f32);
        surface.for_each_neighbour(start + k, |neighbour| {
            if local.state[neighbour] & VALID != 0 {
                navigable += local.navigable[neighbour];
                obstacle += local.obstacle[neighbour];
                count += 1.0;
            }
        });
        let share = 1.0 / count.max(1.0);
        (*navigable_mean, *obstacle_mean) = (navigable * share, obstacle * share);
    }
    [navigable_means, obstacle_means]
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
