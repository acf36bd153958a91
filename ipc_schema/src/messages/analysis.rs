//! Scores of points, zones of interest, and the tiles of the information map.

use super::Header;
use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

message! {
    /// The scores of one point, under the same index as in the scan.
    pub struct PointScore: "mirador/PointScore/1", size 16 {
        /// F, navigable surface.
        pub navigable: u16,
        /// B, obstacle.
        pub obstacle: u16,
        /// D, quality.
        pub quality: u16,
        /// Bit 0 valid, bit 1 reachable, bit 2 the normal's z is negative, bits 4 to 7: the triangle of this cell's quad
        /// (this cell, next in the row, next row, next row and next) that leaves out corner 0 to 3 is in the mesh.
        pub flags: u16,
        /// Unit normal in the scanner's frame: x and y times 32767.
        pub normal_xy: [i16; 2],
        /// The point's share of the surface [m^2].
        pub area: f32,
    }
}

message! {
    /// The meta part of a scored scan; the items are one [`PointScore`] per point of the scan.
    pub struct ScoredScanMeta: "mirador/ScoredScanMeta/1", size 168 {
        /// Names the scan.
        pub header: Header,
        /// When the scan was sent, CLOCK_MONOTONIC [ns].
        pub scan_sent_ns: u64,
        /// When its alignment was sent, CLOCK_MONOTONIC [ns].
        pub alignment_sent_ns: u64,
        /// Time the surface (mesh, normals, areas, quality) took [ns].
        pub surface_ns: u64,
        /// Time the scores took, after the alignment was there [ns].
        pub analysis_ns: u64,
        /// Height of the ground under the robot in the level frame, that is relative to the scanner [m].
        pub ground_height_m: f64,
        /// Mean quality of the valid points, in [0, 1].
        pub mean_quality: f64,
        /// Triangles in the mesh.
        pub triangles_kept: u32,
        /// Triangles discarded because they span two surfaces.
        pub triangles_discarded: u32,
        /// Points with a normal.
        pub points_valid: u32,
        /// Points the robot could reach.
        pub points_reachable: u32,
        /// 1 when the ground height was estimated from the scan, 0 when it was given, 2 when neither and a default holds.
        pub ground_source: u32,
        /// Status of the alignment, one of the `ALIGNMENT_*` constants.
        pub alignment_status: u32,
        /// Position of the scanner in the map [m].
        pub scanner_position: [f64; 3],
        /// Zones of interest found.
        pub zones: u32,
        /// Not used.
        pub reserved: u32,
        /// Not used.
        pub reserved2: [u64; 2],
    }
}

message! {
    /// An occluded plane worth another look.
    pub struct Zone: "mirador/Zone/1", size 40 {
        /// Centre in the map [m].
        pub centre: [f32; 3],
        /// Normal in the map, its length is the area [m^2].
        pub normal: [f32; 3],
        /// Area [m^2].
        pub area: f32,
        /// Discarded triangles in it.
        pub triangles: u32,
        /// The scan of the run it was seen in last.
        pub scan: u32,
        /// 1 when merged with a zone of an earlier scan.
        pub merged: u32,
    }
}

/// Value of [`Zone::merged`] for a zone that was seen from more than one scan.
pub const ZONE_MERGED: u32 = 1;

/// Cells along the side of a [`MapTile`].
pub const MAP_TILE_SIDE: usize = 16;
/// Cells of a [`MapTile`].
pub const MAP_TILE_CELLS: usize = MAP_TILE_SIDE * MAP_TILE_SIDE;

message! {
    /// One level of a cell of the information map.
    pub struct MapCell: "mirador/MapCell/2", size 32 {
        /// Mean height of everything seen of it [m, map]; NaN when unknown.
        pub height: f32,
        /// Mean height of its ground [m, map]; NaN without ground to drive on.
        pub ground: f32,
        /// Free height over it to what hangs there or to the next level [m]; infinite under the open sky.
        pub clearance: f32,
        /// C_nc, navigability; only with evidence.
        pub navigability: u16,
        /// Q_a, mean quality; only with evidence.
        pub quality: u16,
        /// Mean F over the navigable points.
        pub navigable_mean: u16,
        /// Mean B over the obstacle points.
        pub obstacle_mean: u16,
        /// Points measured.
        pub measured: u32,
        /// Triangles that cover its middle.
        pub interpolated: u32,
        /// Bit 0: known (any evidence at all).
        pub flags: u32,
    }
}

message! {
    /// One level of a square of the information map: cell (column, row) of the tile has index `row * 16 + column`. A tile
    /// is always sent with all its levels; readers drop those from `levels` on, which it had before.
    pub struct MapTile: "mirador/MapTile/2", size 8208 {
        /// Column of the tile; its first cell begins at `tile_x * 16 * cell size` in the map.
        pub tile_x: i32,
        /// Row of the tile.
        pub tile_y: i32,
        /// Which level of the cells, counted from the lowest of each: 1 is the deck where 0 is the road under it.
        pub level: u32,
        /// Number of levels of the tile; 1 unless something can be passed both under and over.
        pub levels: u32,
        /// The cells.
        pub cells: [MapCell; 256],
    }
}

/// The map has changed because of the scan that the header names.
pub const MAP_CAUSE_SCAN: u32 = 0;
/// Poses were corrected after that scan.
pub const MAP_CAUSE_CORRECTION: u32 = 1;
/// Nothing has changed: the whole map is said again after a restart.
pub const MAP_CAUSE_RESTART: u32 = 2;

message! {
    /// The meta part of an information map message; the items are the tiles that changed.
    pub struct MapMeta: "mirador/MapMeta/2", size 104 {
        /// Names the scan after which the tiles hold.
        pub header: Header,
        /// Counts the updates of the map.
        pub revision: u64,
        /// Side of a cell [m].
        pub cell_m: f64,
        /// Tiles of the whole map.
        pub tiles_total: u32,
        /// Known cells of the whole map.
        pub cells_known: u32,
        /// Mean quality of the known cells, in [0, 1].
        pub mean_quality: f64,
        /// Bytes the map takes in memory.
        pub bytes: u64,
        /// This message of the update, counted from 0.
        pub part: u32,
        /// Messages of the update.
        pub parts: u32,
        /// One of the `MAP_CAUSE_*` constants.
        pub cause: u32,
        /// Scans that were moved since the update before.
        pub moved_scans: u32,
    }
}
