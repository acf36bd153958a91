//! Poses, times and packed points as foxglove has them.

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{PackedElementField, PointCloud, Pose, PosesInFrame, Quaternion, Timestamp, Vector3};
use mirador_core::geometry;
use mirador_ipc_schema::Header;

use crate::colour::{Colour, UNKNOWN, blue_to_yellow};
use crate::{MAP, Stamps};

/// Bytes of a scored point: x, y, z, red, green, blue, alpha, quality.
const SCORED_POINT: u32 = 20;
/// Bytes of a dot: x, y, z, red, green, blue, alpha.
const DOT: u32 = 16;

/// A point of the map [m] with its quality in [0, 1], which is not there for points that were not scored.
pub(crate) type ScoredPoint = ([f32; 3], Option<f32>);

/// Times of the message with this header.
pub(crate) fn stamps(header: &Header) -> Stamps {
    Stamps {
        sequence: header.scan(),
        log_time: header.sent_ns,
        publish_time: u64::try_from(header.stamp_ns).unwrap_or(0),
    }
}

pub(crate) fn timestamp(stamps: Stamps) -> Timestamp {
    let seconds = u32::try_from(stamps.log_time / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (stamps.log_time % 1_000_000_000) as u32).unwrap_or(Timestamp::MAX)
}

pub(crate) fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

pub(crate) fn draw_pose(pose: &geometry::Pose) -> Pose {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    Pose {
        position: Some(Vector3 { x: t.x, y: t.y, z: t.z }),
        orientation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// A pose on the ground that looks in direction `heading` [rad].
pub(crate) fn level_pose(position: [f64; 3], heading: f64) -> Pose {
    let (sin, cos) = (0.5 * heading).sin_cos();
    Pose { position: Some(vector(position)), orientation: Some(Quaternion { x: 0.0, y: 0.0, z: sin, w: cos }) }
}

pub(crate) fn poses_in_map(stamps: Stamps, poses: Vec<Pose>) -> PosesInFrame {
    PosesInFrame { timestamp: Some(timestamp(stamps)), frame_id: MAP.into(), poses }
}

/// Packed fields: name, type and offset.
pub(crate) fn fields(of: &[(&str, NumericType, u32)]) -> Vec<PackedElementField> {
    of.iter()
        .map(|(name, kind, offset)| PackedElementField { name: (*name).into(), offset: *offset, r#type: *kind as i32 })
        .collect()
}

/// The four bytes of a colour, from `offset` on.
pub(crate) fn colour_fields(offset: u32) -> [(&'static str, NumericType, u32); 4] {
    let byte = NumericType::Uint8;
    [("red", byte, offset), ("green", byte, offset + 1), ("blue", byte, offset + 2), ("alpha", byte, offset + 3)]
}

const POSITION: [(&str, NumericType, u32); 3] =
    [("x", NumericType::Float32, 0), ("y", NumericType::Float32, 4), ("z", NumericType::Float32, 8)];

/// A cloud coloured by quality, at `pose`; where there is no quality the field has NaN.
pub(crate) fn scored_cloud(stamps: Stamps, pose: Pose, points: impl Iterator<Item = ScoredPoint>) -> PointCloud {
    let mut data = Vec::with_capacity(points.size_hint().0 * SCORED_POINT as usize);
    for (position, quality) in points {
        let [r, g, b] = quality.map_or(UNKNOWN, |q| blue_to_yellow(q.into()));
        data.extend(position.into_iter().flat_map(f32::to_le_bytes));
        data.extend_from_slice(&[r, g, b, 255]);
        data.extend_from_slice(&quality.unwrap_or(f32::NAN).to_le_bytes());
    }
    let fields = fields(&[&POSITION[..], &colour_fields(12), &[("quality", NumericType::Float32, 16)]].concat());
    cloud(stamps, pose, SCORED_POINT, fields, data)
}

/// Coloured points of the map.
pub(crate) fn dots(stamps: Stamps, points: impl Iterator<Item = ([f64; 3], Colour)>) -> PointCloud {
    let mut data = Vec::with_capacity(points.size_hint().0 * DOT as usize);
    for (position, [r, g, b]) in points {
        data.extend(position.into_iter().flat_map(|c| (c as f32).to_le_bytes()));
        data.extend_from_slice(&[r, g, b, 255]);
    }
    let fields = fields(&[&POSITION[..], &colour_fields(12)].concat());
    cloud(stamps, level_pose([0.0; 3], 0.0), DOT, fields, data)
}

fn cloud(stamps: Stamps, pose: Pose, point_stride: u32, fields: Vec<PackedElementField>, data: Vec<u8>) -> PointCloud {
    PointCloud {
        timestamp: Some(timestamp(stamps)),
        frame_id: MAP.into(),
        pose: Some(pose),
        point_stride,
        fields,
        data: data.into(),
    }
}
