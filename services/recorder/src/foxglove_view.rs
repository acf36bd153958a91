//! The run as viewers like it: foxglove's message types beside the raw records.
//!
//! Nothing here is read back by mirador. Clouds are thinned; a scan appears when both its pose and its scores are
//! there, and only if it was aligned, so that a wrong guess does not spoil the picture.

use std::collections::BTreeMap;

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    FrameTransform, Grid, PackedElementField, PointCloud, Pose, PosesInFrame, Quaternion, Timestamp, Vector2, Vector3,
};
use foxglove::{Encode, Schema};
use mirador_core::geometry;
use mirador_ipc_schema::Header;
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, AlignmentMeta, CANDIDATE_OPEN, CandidateView, MAP_TILE_SIDE, MapMeta, MapTile, Point,
    PointScore, PoseCorrection, ScanId, Waypoint,
};

use mirador_ipc_schema::topics::{self, Topic};

use crate::write::Stamps;
use crate::{RunWriter, WriteError};

/// The frame of everything in the view.
const MAP: &str = "map";
/// More cells along a side than this are not drawn.
const LARGEST_GRID: usize = 4096;

/// A channel of the view.
pub(crate) struct ViewChannel {
    pub(crate) topic: &'static str,
    /// Schema and message encoding.
    pub(crate) declaration: fn() -> (Schema, String),
}

fn declaration<M: Encode>() -> (Schema, String) {
    // All foxglove message types have a schema; one without would be written as a channel that viewers list unnamed.
    let schema = M::get_schema().unwrap_or_else(|| Schema::new("", "", Vec::new()));
    (schema, M::get_message_encoding())
}

const CLOUD: &str = "/cloud";
const POSES: &str = "/poses";
const CANDIDATES: &str = "/candidates";
const PATH: &str = "/path";
const GRID: &str = "/map";
const TF: &str = "/tf";

/// Every channel of the view.
pub(crate) const VIEW_CHANNELS: &[ViewChannel] = &[
    ViewChannel { topic: CLOUD, declaration: declaration::<PointCloud> },
    ViewChannel { topic: POSES, declaration: declaration::<PosesInFrame> },
    ViewChannel { topic: CANDIDATES, declaration: declaration::<PosesInFrame> },
    ViewChannel { topic: PATH, declaration: declaration::<PosesInFrame> },
    ViewChannel { topic: GRID, declaration: declaration::<Grid> },
    ViewChannel { topic: TF, declaration: declaration::<FrameTransform> },
];

/// A thinned scan that waits for its pose and its scores.
#[derive(Default)]
struct Thinned {
    /// Index in the scan, and position in the scanner's frame.
    points: Vec<(usize, [f32; 3])>,
    quality: Option<Vec<f32>>,
    map_from_scanner: Option<geometry::Pose>,
}

/// Builds the view from the messages of a run.
pub(crate) struct FoxgloveView {
    most_points: usize,
    waiting: BTreeMap<u32, Thinned>,
    trajectory: BTreeMap<u32, geometry::Pose>,
    /// The lowest level of the tiles.
    tiles: BTreeMap<(i32, i32), Box<MapTile>>,
}

impl FoxgloveView {
    pub(crate) fn new(most_points: usize) -> Self {
        Self { most_points, waiting: BTreeMap::new(), trajectory: BTreeMap::new(), tiles: BTreeMap::new() }
    }

    /// Takes in a message that an earlier incarnation recorded, so that trajectory and map go on where they were.
    pub(crate) fn restore(&mut self, topic: &str, data: &[u8]) {
        match topic {
            "alignment" => {
                if let Some((meta, _)) = unpack::<topics::Alignment>(data) {
                    self.place_scan(&meta);
                }
            }
            "pose_corrections" => {
                if let Some((_, corrections)) = unpack::<topics::PoseCorrections>(data) {
                    self.correct(&corrections);
                }
            }
            "information_map" => {
                if let Some((_, tiles)) = unpack::<topics::InformationMap>(data) {
                    self.keep_tiles(&tiles);
                }
            }
            _ => {}
        }
    }

    /// Keeps a thinned copy of a scan.
    pub(crate) fn scan(&mut self, header: &Header, points: &[Point]) {
        let step = points.len().div_ceil(self.most_points).max(1);
        let kept = points.iter().enumerate().step_by(step).filter(|(_, p)| p.x.is_finite());
        let points = kept.map(|(i, p)| (i, [p.x, p.y, p.z])).collect();
        self.waiting.insert(header.scan(), Thinned { points, ..Thinned::default() });
        // A scan whose scores never come must not stay for ever.
        while self.waiting.len() > 4 {
            self.waiting.pop_first();
        }
    }

    /// The pose of a scan: its cloud if the scores are there, the transform and the trajectory.
    pub(crate) fn alignment(&mut self, out: &mut RunWriter, meta: &AlignmentMeta) -> Result<(), WriteError> {
        let scan = meta.header.scan();
        let Some(pose) = self.place_scan(meta) else {
            self.waiting.remove(&scan);
            return Ok(());
        };
        if let Some(thinned) = self.waiting.get_mut(&scan) {
            thinned.map_from_scanner = Some(pose);
        }
        let drawn = draw_pose(&pose);
        let transform = FrameTransform {
            timestamp: Some(stamp(&meta.header)),
            parent_frame_id: MAP.into(),
            child_frame_id: "scanner".into(),
            translation: drawn.position,
            rotation: drawn.orientation,
        };
        out.view(TF, stamps(&meta.header), &transform)?;
        self.draw_trajectory(out, &meta.header)?;
        self.draw_cloud(out, &meta.header)
    }

    /// Corrected poses of older scans.
    pub(crate) fn corrections(
        &mut self,
        out: &mut RunWriter,
        header: &Header,
        corrections: &[PoseCorrection],
    ) -> Result<(), WriteError> {
        self.correct(corrections);
        self.draw_trajectory(out, header)
    }

    /// The scores of a scan.
    pub(crate) fn scored(
        &mut self,
        out: &mut RunWriter,
        header: &Header,
        scores: &[PointScore],
    ) -> Result<(), WriteError> {
        if let Some(thinned) = self.waiting.get_mut(&header.scan()) {
            let quality = |i: usize| scores.get(i).map_or(0.0, |s| f32::from(s.quality) / 65535.0);
            thinned.quality = Some(thinned.points.iter().map(|(i, _)| quality(*i)).collect());
        }
        self.draw_cloud(out, header)
    }

    /// Candidates of a view plan that were valued.
    pub(crate) fn candidates(
        &mut self,
        out: &mut RunWriter,
        header: &Header,
        candidates: &[CandidateView],
    ) -> Result<(), WriteError> {
        let open = candidates.iter().filter(|c| c.status == CANDIDATE_OPEN);
        let poses = open.map(|c| level_pose(c.position, c.heading)).collect();
        out.view(CANDIDATES, stamps(header), &poses_in_map(header, poses))
    }

    /// The path to the chosen view; every pose looks at the next.
    pub(crate) fn path(
        &mut self,
        out: &mut RunWriter,
        header: &Header,
        waypoints: &[Waypoint],
    ) -> Result<(), WriteError> {
        let mut heading = 0.0;
        let mut poses = Vec::with_capacity(waypoints.len());
        for (k, here) in waypoints.iter().enumerate() {
            if let Some(next) = waypoints.get(k + 1) {
                heading = (next.position[1] - here.position[1]).atan2(next.position[0] - here.position[0]);
            }
            poses.push(level_pose(here.position, heading));
        }
        out.view(PATH, stamps(header), &poses_in_map(header, poses))
    }

    /// Tiles of the map; the picture follows with the last part of an update.
    pub(crate) fn map(&mut self, out: &mut RunWriter, meta: &MapMeta, tiles: &[MapTile]) -> Result<(), WriteError> {
        self.keep_tiles(tiles);
        match (meta.part + 1 >= meta.parts, self.grid(meta)) {
            (true, Some(grid)) => out.view(GRID, stamps(&meta.header), &grid),
            _ => Ok(()),
        }
    }

    /// Enters the pose of an aligned scan in the trajectory.
    fn place_scan(&mut self, meta: &AlignmentMeta) -> Option<geometry::Pose> {
        let pose = geometry::pose_from_rows(&meta.map_from_scanner)?;
        if meta.status == ALIGNMENT_REJECTED {
            return None;
        }
        self.trajectory.insert(meta.header.scan(), pose);
        Some(pose)
    }

    fn correct(&mut self, corrections: &[PoseCorrection]) {
        for correction in corrections {
            let old = self.trajectory.get_mut(&ScanId::unpack(correction.id).scan);
            if let (Some(old), Some(new)) = (old, geometry::pose_from_rows(&correction.map_from_scanner)) {
                *old = new;
            }
        }
    }

    fn keep_tiles(&mut self, tiles: &[MapTile]) {
        for tile in tiles.iter().filter(|tile| tile.level == 0) {
            self.tiles.insert((tile.tile_x, tile.tile_y), Box::new(*tile));
        }
    }

    fn draw_trajectory(&self, out: &mut RunWriter, header: &Header) -> Result<(), WriteError> {
        let poses = self.trajectory.values().map(draw_pose).collect();
        out.view(POSES, stamps(header), &poses_in_map(header, poses))
    }

    /// Writes the cloud of a scan as soon as it has both pose and quality.
    fn draw_cloud(&mut self, out: &mut RunWriter, header: &Header) -> Result<(), WriteError> {
        let scan = header.scan();
        let ready = self.waiting.get(&scan).is_some_and(|t| t.quality.is_some() && t.map_from_scanner.is_some());
        if !ready {
            return Ok(());
        }
        let Some(Thinned { points, quality: Some(quality), map_from_scanner: Some(pose) }) = self.waiting.remove(&scan)
        else {
            return Ok(());
        };
        let mut data = Vec::with_capacity(points.len() * 16);
        for ((_, [x, y, z]), quality) in points.iter().zip(&quality) {
            for value in [x, y, z, quality] {
                data.extend_from_slice(&value.to_le_bytes());
            }
        }
        let cloud = PointCloud {
            timestamp: Some(stamp(header)),
            frame_id: MAP.into(),
            pose: Some(draw_pose(&pose)),
            point_stride: 16,
            fields: fields(&["x", "y", "z", "quality"], NumericType::Float32, 4),
            data: data.into(),
        };
        out.view(CLOUD, stamps(header), &cloud)
    }

    /// Navigability in colours, unknown cells transparent; `None` without tiles and for maps too large to draw.
    fn grid(&self, meta: &MapMeta) -> Option<Grid> {
        let bounds = |of: fn(&(i32, i32)) -> i32| {
            let values = || self.tiles.keys().map(of);
            Some((values().min()?, values().max()?))
        };
        let ((x0, x1), (y0, y1)) = (bounds(|k| k.0)?, bounds(|k| k.1)?);
        let side = |a: i32, b: i32| (b.abs_diff(a) as usize + 1).checked_mul(MAP_TILE_SIDE);
        let (columns, rows) = (side(x0, x1)?, side(y0, y1)?);
        if columns > LARGEST_GRID || rows > LARGEST_GRID {
            return None;
        }
        let mut data = vec![0_u8; columns * rows * 4];
        for ((x, y), tile) in &self.tiles {
            let (left, low) = (x.abs_diff(x0) as usize * MAP_TILE_SIDE, y.abs_diff(y0) as usize * MAP_TILE_SIDE);
            for (k, cell) in tile.cells.iter().enumerate().filter(|(_, c)| c.flags & 1 != 0) {
                let at = ((low + k / MAP_TILE_SIDE) * columns + left + k % MAP_TILE_SIDE) * 4;
                let navigability = (cell.navigability >> 8) as u8;
                data[at..at + 4].copy_from_slice(&[255 - navigability, navigability, 40, 255]);
            }
        }
        let corner = |tile: i32| f64::from(tile) * MAP_TILE_SIDE as f64 * meta.cell_m;
        Some(Grid {
            timestamp: Some(stamp(&meta.header)),
            frame_id: MAP.into(),
            pose: Some(level_pose([corner(x0), corner(y0), 0.0], 0.0)),
            column_count: columns as u32,
            cell_size: Some(Vector2 { x: meta.cell_m, y: meta.cell_m }),
            row_stride: columns as u32 * 4,
            cell_stride: 4,
            fields: fields(&["red", "green", "blue", "alpha"], NumericType::Uint8, 1),
            data: data.into(),
        })
    }
}

/// Meta part and items of a raw record; `None` when it is not of that topic.
fn unpack<T: Topic>(data: &[u8]) -> Option<(T::Meta, Vec<T::Item>)> {
    let (front, rest) = data.split_at_checked(size_of::<T::Meta>())?;
    let items = rest.chunks_exact(size_of::<T::Item>());
    if !items.remainder().is_empty() {
        return None;
    }
    Some((bytemuck::pod_read_unaligned(front), items.map(bytemuck::pod_read_unaligned).collect()))
}

/// Packed fields of the same type, one behind the other.
fn fields(names: &[&str], kind: NumericType, bytes: u32) -> Vec<PackedElementField> {
    let field =
        |(k, name): (u32, &&str)| PackedElementField { name: (*name).into(), offset: k * bytes, r#type: kind as i32 };
    (0..).zip(names).map(field).collect()
}

fn poses_in_map(header: &Header, poses: Vec<Pose>) -> PosesInFrame {
    PosesInFrame { timestamp: Some(stamp(header)), frame_id: MAP.into(), poses }
}

fn draw_pose(pose: &geometry::Pose) -> Pose {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    Pose {
        position: Some(Vector3 { x: t.x, y: t.y, z: t.z }),
        orientation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// A pose on the ground that looks in direction `heading` [rad].
fn level_pose([x, y, z]: [f64; 3], heading: f64) -> Pose {
    let (sin, cos) = (0.5 * heading).sin_cos();
    Pose { position: Some(Vector3 { x, y, z }), orientation: Some(Quaternion { x: 0.0, y: 0.0, z: sin, w: cos }) }
}

fn stamp(header: &Header) -> Timestamp {
    let ns = u64::try_from(header.stamp_ns).unwrap_or(0);
    let seconds = u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (ns % 1_000_000_000) as u32).unwrap_or(Timestamp::MAX)
}

fn stamps(header: &Header) -> Stamps {
    Stamps {
        sequence: header.scan(),
        log_time: header.sent_ns,
        publish_time: u64::try_from(header.stamp_ns).unwrap_or(0),
    }
}

#[cfg(test)]
#[path = "foxglove_view_tests.rs"]
mod tests;
