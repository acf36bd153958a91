//! The state of an odometry as bytes: what a restarted process goes on from to the last bit.
//!
//! Layout: mark with version, length of the head (u32), the head as TOML, the voxels of the fine and the coarse level
//! (key and sums of each, 48 bytes), the centroids of the first frame while it is alone, and a CRC-32 of all before it;
//! little-endian. Planes are fitted again from the sums, which gives the same bits.

use flate2::Crc;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::local_map::MapHead;
use super::reduce::Centroid;
use super::threshold::AdaptiveThreshold;
use super::track::Track;
use super::{Odometry, OdometryConfig};
use crate::registration::ConfigError;

/// Begins every snapshot; the last byte is the version.
const MARK: [u8; 8] = *b"MIRODOM\x01";
/// Bytes of a centroid: place, time, returns.
const CENTROID_BYTES: usize = 20;

/// Why bytes are no snapshot.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SnapshotError {
    /// The settings are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// They do not begin as a snapshot of this version does, or end elsewhere than they say.
    #[error("these are not the bytes of an odometry of this version")]
    Layout,
    /// They were changed.
    #[error("the bytes of the odometry are damaged: their checksum is another")]
    Checksum,
    /// The odometry had other settings.
    #[error(
        "the odometry had voxels of {voxel_m} m and up to {max_voxels} of them; now it is {config_voxel_m} m and {config_max_voxels}"
    )]
    OtherSettings {
        /// Edge of its voxels [m].
        voxel_m: f64,
        /// Most voxels.
        max_voxels: usize,
        /// Edge of the voxels by the settings [m].
        config_voxel_m: f64,
        /// Most voxels by the settings.
        config_max_voxels: usize,
    },
}

/// Everything but the voxels and the centroids.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    voxel_m: f64,
    max_voxels: usize,
    usual_score: f64,
    first: usize,
    threshold: AdaptiveThreshold,
    track: Track,
    map: MapHead,
}

impl Odometry {
    /// The state as bytes, some 50 a voxel of the map. The points of the last frame are not in it.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        let map = self.map.write(&mut body);
        for centroid in &self.first {
            centroid.point.iter().for_each(|v| body.extend_from_slice(&v.to_le_bytes()));
            body.extend_from_slice(&centroid.time.to_le_bytes());
            body.extend_from_slice(&centroid.returns.to_le_bytes());
        }
        let head = Head {
            voxel_m: self.config.voxel_m,
            max_voxels: self.config.max_voxels,
            usual_score: self.usual_score,
            first: self.first.len(),
            threshold: self.threshold.clone(),
            track: self.track.clone(),
            map,
        };
        // Numbers and options of numbers are always TOML; without a head the bytes would be refused when read.
        let head = toml::to_string(&head).unwrap_or_default();
        let mut bytes = MARK.to_vec();
        bytes.extend_from_slice(&(head.len() as u32).to_le_bytes());
        bytes.extend_from_slice(head.as_bytes());
        bytes.extend_from_slice(&body);
        let sum = checksum(&bytes);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// The odometry of [`Self::to_bytes`], which goes on with the same bits.
    ///
    /// # Errors
    /// [`SnapshotError`] for any other bytes, and for settings of another map.
    pub fn from_bytes(config: OdometryConfig, bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (content, sum) = bytes.split_last_chunk::<4>().ok_or(SnapshotError::Layout)?;
        let rest = content.strip_prefix(&MARK).ok_or(SnapshotError::Layout)?;
        if checksum(content) != u32::from_le_bytes(*sum) {
            return Err(SnapshotError::Checksum);
        }
        let (length, rest) = rest.split_first_chunk::<4>().ok_or(SnapshotError::Layout)?;
        let (head, body) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or(SnapshotError::Layout)?;
        let head = std::str::from_utf8(head).ok().and_then(|text| toml::from_str::<Head>(text).ok());
        let head = head.ok_or(SnapshotError::Layout)?;
        let mut odometry = Self::new(config)?;
        let config = &odometry.config;
        if (head.voxel_m, head.max_voxels) != (config.voxel_m, config.max_voxels) {
            return Err(SnapshotError::OtherSettings {
                voxel_m: head.voxel_m,
                max_voxels: head.max_voxels,
                config_voxel_m: config.voxel_m,
                config_max_voxels: config.max_voxels,
            });
        }
        let first = odometry.map.read(&head.map, body).ok_or(SnapshotError::Layout)?;
        let (first, rest) = first.as_chunks::<CENTROID_BYTES>();
        if !rest.is_empty() || first.len() != head.first {
            return Err(SnapshotError::Layout);
        }
        odometry.first.extend(first.iter().map(centroid));
        (odometry.usual_score, odometry.threshold, odometry.track) = (head.usual_score, head.threshold, head.track);
        Ok(odometry)
    }
}

fn centroid(bytes: &[u8; CENTROID_BYTES]) -> Centroid {
    let word = |k: usize| [bytes[4 * k], bytes[4 * k + 1], bytes[4 * k + 2], bytes[4 * k + 3]];
    let number = |k: usize| f32::from_le_bytes(word(k));
    Centroid { point: [number(0), number(1), number(2)], time: number(3), returns: u32::from_le_bytes(word(4)) }
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geometry::Pose;
    use crate::odometry::FrameRecord;
    use crate::registration::test_scenes::{YARD, scan_of};
    use crate::scan::{Point, ScanView};

    fn config() -> OdometryConfig {
        OdometryConfig { voxel_m: 0.6, max_range_m: 30.0, max_voxels: 4000, ..OdometryConfig::default() }
    }

    /// Frames of a walk through the yard, each beam with its time, the fourth a jump that only the search finds.
    fn frames() -> Vec<Vec<Point>> {
        let scan = |k: usize| {
            let jump = if k >= 3 { 1.5 } else { 0.0 };
            let place = Vector3::new(0.2 * k as f64 + jump, 0.05 * k as f64, 0.0);
            let mut points =
                scan_of(&YARD, &Pose::new(place, Vector3::z() * (0.04 * k as f64 + jump)), 40.0, k as u64 + 1);
            points.iter_mut().enumerate().for_each(|(n, point)| point.time = (n % 65_536) as u16);
            points
        };
        (0..8).map(scan).collect()
    }

    fn go_on(odometry: &mut Odometry, frames: &[Vec<Point>]) -> Vec<FrameRecord> {
        frames.iter().map(|points| odometry.register_frame(ScanView::unordered(points), None, None)).collect()
    }

    #[test]
    fn an_odometry_from_its_bytes_goes_on_with_the_same_bits() {
        let frames = frames();
        for at in 0..frames.len() {
            let mut odometry = Odometry::new(config()).unwrap();
            go_on(&mut odometry, &frames[..at]);
            let bytes = odometry.to_bytes();
            let mut again = Odometry::from_bytes(config(), &bytes).unwrap();
            assert!(again.to_bytes() == bytes, "after {at} frames");
            assert_eq!(go_on(&mut again, &frames[at..]), go_on(&mut odometry, &frames[at..]), "after {at} frames");
            assert!(again.to_bytes() == odometry.to_bytes(), "after all frames");
        }
    }

    #[test]
    fn changed_or_foreign_bytes_are_refused() {
        let mut odometry = Odometry::new(config()).unwrap();
        go_on(&mut odometry, &frames()[..2]);
        let bytes = odometry.to_bytes();
        for at in [0, 5, 20, bytes.len() / 2, bytes.len() - 1] {
            let mut changed = bytes.clone();
            changed[at] ^= 0x20;
            assert!(Odometry::from_bytes(config(), &changed).is_err(), "byte {at}");
            assert!(Odometry::from_bytes(config(), &bytes[..at]).is_err(), "{at} bytes");
        }
        let other = OdometryConfig { voxel_m: 0.5, ..config() };
        let error = Odometry::from_bytes(other, &bytes).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("0.6 m") && error.contains("0.5 m"), "{error}");
    }
}
