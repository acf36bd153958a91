//! What stands in the way: the front laser's returns and the rangers' echoes in the corridor that the robot will sweep.
//!
//! The laser looks level 0.4 m over the ground, so ground that rises ahead shows in it as a wall does. A slope that the
//! robot can climb begins at its wheels at the earliest, so it cannot show nearer than that height over its tangent: what
//! is nearer is an obstacle, what is farther only slows the robot, unless the path is known to rise there.

use nalgebra::{Point3, Vector2};

use super::config::ObstacleConfig;
use super::path::Path;
use crate::geometry::Pose;

/// A hit this much over the path's own height is not its ground [m].
const OVER_PATH_M: f64 = 0.15;
/// Beams that must agree on an obstacle.
const BEAMS: usize = 2;
/// Hits farther away than this are of no interest [m].
const REACH_M: f64 = 4.0;
/// An echo shorter than this share of the one from level ground slows the robot.
const SHORT_ECHO: f64 = 0.8;
/// Ground ahead that falls by more than this below the robot's plane within a metre is an expected edge [m].
const FALLING_M: f64 = 0.1;

/// A sweep of the front laser, as it came.
#[derive(Debug, Clone, Copy)]
pub struct LaserView<'a> {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Angle of the first beam [rad].
    pub first_angle: f64,
    /// Angle between two beams [rad].
    pub angle_step: f64,
    /// Position in the robot's frame [m].
    pub mount_xyz: [f64; 3],
    /// Yaw in the robot's frame [rad].
    pub mount_yaw: f64,
    /// Ranges [m], NaN without a return.
    pub ranges: &'a [f32],
}

/// An echo of a ranger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Echo {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Which ranger.
    pub sensor: u32,
    /// Position in the robot's frame [m].
    pub mount_xyz: [f64; 3],
    /// Yaw, and pitch positive downwards [rad].
    pub yaw_pitch: [f64; 2],
    /// Opening angle of the cone [rad].
    pub aperture: f64,
    /// Range [m], NaN where nothing was heard.
    pub range: f64,
}

/// What is in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Way {
    /// Free way in front of the robot's front [m].
    pub gap: f64,
    /// The same to things that may be rising ground [m].
    pub doubtful_gap: f64,
    /// Whether the rangers see the ground fall away.
    pub may_drop: bool,
    /// Whether an echo is shorter than level ground gives.
    pub is_short: bool,
}

/// What the sensors have seen lately.
#[derive(Debug, Clone, Default)]
pub struct Surroundings {
    /// Returns of the laser, robot frame, at its time.
    hits: Vec<Point3<f64>>,
    hits_ns: i64,
    echoes: Vec<Echo>,
}

impl Surroundings {
    /// Takes a sweep in.
    pub fn laser(&mut self, view: &LaserView<'_>) {
        self.hits.clear();
        self.hits_ns = view.stamp_ns;
        let [x, y, z] = view.mount_xyz;
        for (beam, range) in view.ranges.iter().enumerate() {
            let range = f64::from(*range);
            if range > 0.02 && range < REACH_M {
                let (sin, cos) = (view.mount_yaw + view.first_angle + view.angle_step * beam as f64).sin_cos();
                self.hits.push(Point3::new(x + range * cos, y + range * sin, z));
            }
        }
    }

    /// Takes an echo in.
    pub fn echo(&mut self, echo: Echo) {
        match self.echoes.iter_mut().find(|known| known.sensor == echo.sensor) {
            Some(known) => *known = echo,
            None => self.echoes.push(echo),
        }
    }

    /// What is in the way along the pieces `ahead` [m, map frame], the first of which begins at the robot.
    pub(super) fn way(
        &self,
        now_ns: i64,
        map_from_robot: &Pose,
        ahead: &[Vector2<f64>],
        path: &Path,
        along: f64,
        config: &ObstacleConfig,
    ) -> Way {
        let mut certain = Nearest::default();
        let mut doubtful = Nearest::default();
        let keep_ns = (config.keep_s * 1e9) as i64;
        if now_ns.saturating_sub(self.hits_ns) <= keep_ns {
            for hit in &self.hits {
                let in_map = map_from_robot * hit;
                let Some(way) = swept(&in_map.xy().coords, ahead, config) else { continue };
                let over_path = in_map.z - path.height(along + way);
                let can_rise = (hit.x.hypot(hit.y) - config.axle_m) * config.steepest_deg.to_radians().tan();
                if hit.z > can_rise {
                    certain.add(way);
                } else if over_path > OVER_PATH_M {
                    doubtful.add(way);
                }
            }
        }
        let front = certain.value() - config.half_length_m;
        let mut way =
            Way { gap: front, doubtful_gap: doubtful.value() - config.half_length_m, may_drop: false, is_short: false };
        self.listen(now_ns, keep_ns, map_from_robot, path, along, config, &mut way);
        way
    }

    /// Adds what the rangers in front say.
    #[expect(clippy::too_many_arguments, reason = "the second half of `way`")]
    fn listen(
        &self,
        now_ns: i64,
        keep_ns: i64,
        map_from_robot: &Pose,
        path: &Path,
        along: f64,
        config: &ObstacleConfig,
        way: &mut Way,
    ) {
        let mut long = 0;
        for echo in &self.echoes {
            let [yaw, pitch] = echo.yaw_pitch;
            if yaw.cos() <= 0.3 || now_ns.saturating_sub(echo.stamp_ns) > keep_ns {
                continue;
            }
            let [x, y, height] = echo.mount_xyz;
            let (sin, cos) = (pitch + 0.5 * echo.aperture).sin_cos();
            let level = height / sin.max(0.05);
            let rising = height / (sin + cos * config.steepest_deg.to_radians().tan()).max(0.05);
            // Noise of the ranger.
            if echo.range < rising - 0.02 {
                let reach = echo.range * cos;
                let lateral = y + reach * yaw.sin();
                if lateral.abs() < config.half_width_m + config.side_margin_m {
                    way.gap = way.gap.min(x + reach * yaw.cos() - config.half_length_m);
                }
            }
            way.is_short |= echo.range < SHORT_ECHO * level;
            long += usize::from(echo.range.is_nan() || echo.range > config.drop_ratio * level);
        }
        // The ground of a path that is known to fall falls.
        let nose = map_from_robot.rotation * nalgebra::Vector3::x();
        let falls = path.height(along + 1.2) - path.height(along) - 1.2 * nose.z < -FALLING_M;
        way.may_drop = long >= 2 && !falls;
    }

    /// Free way behind the robot's back by the rangers [m].
    pub(super) fn gap_behind(&self, now_ns: i64, config: &ObstacleConfig) -> f64 {
        let keep_ns = (config.keep_s * 1e9) as i64;
        let mut gap = f64::INFINITY;
        for echo in &self.echoes {
            let [yaw, pitch] = echo.yaw_pitch;
            if yaw.cos() > -0.3 || now_ns.saturating_sub(echo.stamp_ns) > keep_ns {
                continue;
            }
            let (sin, cos) = (pitch + 0.5 * echo.aperture).sin_cos();
            let rising = echo.mount_xyz[2] / (sin + cos * config.steepest_deg.to_radians().tan()).max(0.05);
            if echo.range < rising - 0.02 {
                gap = gap.min(-echo.mount_xyz[0] - echo.range * cos * yaw.cos() - config.half_length_m);
            }
        }
        gap
    }
}

/// Distance along the corridor at which a place lies in it.
fn swept(at: &Vector2<f64>, ahead: &[Vector2<f64>], config: &ObstacleConfig) -> Option<f64> {
    let wide = config.half_width_m + config.side_margin_m;
    let mut before = 0.0;
    let mut best: Option<f64> = None;
    for (k, piece) in ahead.windows(2).enumerate() {
        let length = (piece[1] - piece[0]).norm();
        if length < 1e-6 {
            continue;
        }
        let direction = (piece[1] - piece[0]) / length;
        let offset = at - piece[0];
        let (way, side) = (offset.dot(&direction), direction.perp(&offset));
        // The body reaches beyond the end of the last piece.
        let beyond = if k + 2 == ahead.len() { config.half_length_m + config.stop_gap_m } else { 0.0 };
        if side.abs() < wide && (0.0..=length + beyond).contains(&way) {
            best = Some(best.map_or(before + way, |best| best.min(before + way)));
        }
        before += length;
    }
    best
}

/// The nearest of several distances that enough beams agree on.
#[derive(Debug, Clone, Copy)]
struct Nearest([f64; BEAMS]);

impl Default for Nearest {
    fn default() -> Self {
        Self([f64::INFINITY; BEAMS])
    }
}

impl Nearest {
    fn add(&mut self, value: f64) {
        if value < self.0[BEAMS - 1] {
            self.0[BEAMS - 1] = value;
            self.0.sort_unstable_by(f64::total_cmp);
        }
    }

    fn value(&self) -> f64 {
        self.0[BEAMS - 1]
    }
}
