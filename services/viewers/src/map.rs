//! The information map: its lowest level as a grid, and as dots at the height of every known cell.

use std::collections::BTreeMap;

use foxglove::messages::{Grid, PointCloud, Vector2};
use mirador_ipc_schema::messages::{MAP_TILE_SIDE, MapCell, MapMeta, MapTile};

use crate::colour::red_to_green;
use crate::points::{colour_fields, dots, fields, level_pose, stamps, timestamp};
use crate::{MAP, Stamps};

/// More cells along a side than this are not drawn.
const LARGEST_GRID: usize = 4096;

/// The tiles of the lowest level, and what was said of the map last.
#[derive(Default)]
pub(crate) struct Tiles {
    tiles: BTreeMap<(i32, i32), Box<MapTile>>,
    last: Option<MapMeta>,
}

impl Tiles {
    /// Keeps tiles; whether the update that they belong to is whole now.
    pub(crate) fn keep(&mut self, meta: &MapMeta, tiles: &[MapTile]) -> bool {
        for tile in tiles.iter().filter(|tile| tile.level == 0) {
            self.tiles.insert((tile.tile_x, tile.tile_y), Box::new(*tile));
        }
        self.last = Some(*meta);
        meta.part + 1 >= meta.parts
    }

    /// Navigability in colours, unknown cells transparent; `None` without tiles and for maps too large to draw.
    pub(crate) fn grid(&self) -> Option<(Stamps, Grid)> {
        let meta = self.last.as_ref()?;
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
            for (k, cell) in known(tile) {
                let at = ((low + k / MAP_TILE_SIDE) * columns + left + k % MAP_TILE_SIDE) * 4;
                let [r, g, b] = colour(cell);
                data[at..at + 4].copy_from_slice(&[r, g, b, 255]);
            }
        }
        let corner = |tile: i32| f64::from(tile) * MAP_TILE_SIDE as f64 * meta.cell_m;
        let stamps = stamps(&meta.header);
        let grid = Grid {
            timestamp: Some(timestamp(stamps)),
            frame_id: MAP.into(),
            pose: Some(level_pose([corner(x0), corner(y0), 0.0], 0.0)),
            column_count: columns as u32,
            cell_size: Some(Vector2 { x: meta.cell_m, y: meta.cell_m }),
            row_stride: columns as u32 * 4,
            cell_stride: 4,
            fields: fields(&colour_fields(0)),
            data: data.into(),
        };
        Some((stamps, grid))
    }

    /// A dot for every known cell.
    pub(crate) fn dots(&self) -> Option<(Stamps, PointCloud)> {
        let meta = self.last.as_ref()?;
        let middle = |tile: i32, k: usize| (f64::from(tile) * MAP_TILE_SIDE as f64 + k as f64 + 0.5) * meta.cell_m;
        let cells = self.tiles.iter().flat_map(|((x, y), tile)| {
            known(tile).filter(|(_, cell)| cell.height.is_finite()).map(move |(k, cell)| {
                let place = [middle(*x, k % MAP_TILE_SIDE), middle(*y, k / MAP_TILE_SIDE), cell.height.into()];
                (place, colour(cell))
            })
        });
        let stamps = stamps(&meta.header);
        Some((stamps, dots(stamps, cells)))
    }
}

fn known(tile: &MapTile) -> impl Iterator<Item = (usize, &MapCell)> {
    tile.cells.iter().enumerate().filter(|(_, cell)| cell.flags & 1 != 0)
}

fn colour(cell: &MapCell) -> [u8; 3] {
    red_to_green(f64::from(cell.navigability) / 65535.0)
}
