//! Which frames become nodes of a pose graph, and what the graph is told of them.

use serde::{Deserialize, Serialize};

use super::FrameRecord;
use super::voxel_key::{key_of, voxel_at};
use crate::geometry::{Covariance, Pose, adjoint, rotation_angle};
use crate::registration::ConfigError;

/// When a frame becomes a keyframe: at the first of the three.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// So far from the last keyframe [m].
    pub distance_m: f64,
    /// Turned so far from the last keyframe [rad].
    pub rotation: f64,
    /// A smaller share of the points than this lies in voxels that the last keyframe saw, 0 to 1.
    pub overlap: f64,
    /// Edge of the voxels of which a keyframe keeps one point each; overlap is counted in voxels twice as wide [m].
    pub thinning_m: f64,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self { distance_m: 2.0, rotation: 0.35, overlap: 0.5, thinning_m: 0.5 }
    }
}

impl KeyframeConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("keyframes.distance_m", self.distance_m, 1e-3, 1e4)?;
        ConfigError::check("keyframes.rotation", self.rotation, 1e-3, std::f64::consts::PI)?;
        ConfigError::check("keyframes.overlap", self.overlap, 0.0, 1.0)?;
        ConfigError::check("keyframes.thinning_m", self.thinning_m, 1e-2, 10.0)
    }
}

/// A node of a pose graph and the edge to the one before.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Thinned points [m, scanner frame at the end of the scan].
    pub points: Vec<[f32; 3]>,
    /// Where the odometry saw it.
    pub map_from_scanner: Pose,
    /// The motion since the last keyframe; identity for the first.
    pub last_from_this: Pose,
    /// Covariance of `last_from_this`: 6x6, translation [m^2] before rotation [rad^2], perturbation on the right, in
    /// this keyframe's frame. Zero for the first.
    pub covariance: Covariance,
}

/// Picks keyframes from the answers of an odometry.
#[derive(Debug)]
pub struct KeyframeSelector {
    config: KeyframeConfig,
    last: Option<Last>,
    keys: Vec<u64>,
}

/// The last keyframe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Last {
    map_from_scanner: Pose,
    covariance: Covariance,
    /// The wide voxels it saw, map axes, sorted.
    seen: Vec<u64>,
}

impl KeyframeSelector {
    /// A selector to which the next tracked frame is the first keyframe.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: KeyframeConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self { config, last: None, keys: Vec::new() })
    }

    /// Forgets the last keyframe: the next tracked frame is one.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// What it remembers, as TOML.
    #[must_use]
    pub fn to_text(&self) -> String {
        // Numbers are always TOML.
        self.last.as_ref().map(|last| toml::to_string(last).unwrap_or_default()).unwrap_or_default()
    }

    /// The selector of [`Self::to_text`]; `None` when that is no such text.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn from_text(config: KeyframeConfig, text: &str) -> Result<Option<Self>, ConfigError> {
        let selector = Self::new(config)?;
        if text.is_empty() {
            return Ok(Some(selector));
        }
        Ok(toml::from_str(text).ok().map(|last| Self { last: Some(last), ..selector }))
    }

    /// The keyframe that this frame is, if it is one. `points` are those of the frame
    /// ([`super::Odometry::frame_points`]) [m, scanner frame]. Frames without a pose never are.
    pub fn consider(&mut self, record: &FrameRecord, points: &[[f32; 3]]) -> Option<Keyframe> {
        if !record.status.is_tracked() {
            return None;
        }
        let pose = record.map_from_scanner;
        let (last_from_this, covariance) = match &self.last {
            None => (Pose::identity(), Covariance::zeros()),
            Some(last) => {
                let motion = last.map_from_scanner.inverse() * pose;
                let far = motion.translation.vector.norm() >= self.config.distance_m
                    || rotation_angle(&motion) >= self.config.rotation;
                if !far && overlap(&last.seen, points, &pose, self.wide()) >= self.config.overlap {
                    return None;
                }
                (motion, motion_covariance(&last.covariance, &motion, &record.covariance))
            }
        };
        let thinned = self.thin(points);
        let mut seen: Vec<u64> = thinned.iter().map(|p| wide_key(&pose, *p, self.wide())).collect();
        seen.sort_unstable();
        seen.dedup();
        self.last = Some(Last { map_from_scanner: pose, covariance: record.covariance, seen });
        Some(Keyframe { points: thinned, map_from_scanner: pose, last_from_this, covariance })
    }

    /// Edge of the voxels in which overlap is counted [m].
    fn wide(&self) -> f32 {
        2.0 * self.config.thinning_m as f32
    }

    /// As a keyframe's points are thinned: the first point of every voxel, in the order of the points.
    pub fn thin(&mut self, points: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let per_metre = 1.0 / self.config.thinning_m as f32;
        self.keys.clear();
        self.keys.extend(points.iter().map(|p| key_of(voxel_at(*p, per_metre))));
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        // By voxel, then by place in the scan: the first of each voxel stays.
        order.sort_unstable_by_key(|k| (self.keys.get(*k as usize).copied(), *k));
        order.dedup_by_key(|k| self.keys.get(*k as usize).copied());
        order.sort_unstable();
        order.iter().filter_map(|k| points.get(*k as usize).copied()).collect()
    }
}

/// The voxel of a point in the map's axes.
fn wide_key(map_from_scanner: &Pose, point: [f32; 3], edge: f32) -> u64 {
    let p = map_from_scanner * nalgebra::Point3::from(point).cast::<f64>();
    key_of([0, 1, 2].map(|k: usize| (p[k] / f64::from(edge)).floor() as i64 as i32))
}

/// The share of the points that lie in voxels seen before.
fn overlap(seen: &[u64], points: &[[f32; 3]], pose: &Pose, edge: f32) -> f64 {
    let within = points.iter().filter(|p| seen.binary_search(&wide_key(pose, **p, edge)).is_ok()).count();
    within as f64 / points.len().max(1) as f64
}

/// The covariance of `last_from_this` when both poses in the map have their own: with `T = last_from_this`,
/// `exp(-a) T exp(b) = T exp(-Ad(T^-1) a) exp(b)`, so that of the last is turned into this frame and added. What the map
/// itself drifted between the two is not in it.
fn motion_covariance(last: &Covariance, last_from_this: &Pose, this: &Covariance) -> Covariance {
    let adjoint = adjoint(&last_from_this.inverse());
    let sum = adjoint * last * adjoint.transpose() + this;
    (sum + sum.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_the_first_point_of_every_voxel() {
        let mut selector = KeyframeSelector::new(KeyframeConfig::default()).unwrap();
        let points = [[0.1, 0.1, 0.1], [3.0, 0.1, 0.1], [0.2, 0.2, 0.2], [0.6, 0.1, 0.1], [3.1, 0.2, 0.2]];
        assert_eq!(selector.thin(&points), [points[0], points[1], points[3]]);
    }

    #[test]
    fn a_setting_out_of_range_is_refused() {
        let config = KeyframeConfig { overlap: 1.5, ..KeyframeConfig::default() };
        assert_eq!(KeyframeSelector::new(config).unwrap_err().field, "keyframes.overlap");
    }
}
