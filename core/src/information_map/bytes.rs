//! The map as plain bytes, for checkpoints: versioned, checked, little endian.
//!
//! Layout: `MIRADMAP`, version (u32), settings, revision (u64), number of tiles (u64), each tile as place (2 x i32),
//! revision (u64), number of known cells (u16) and those cells (place u8, then 140 bytes); the zones; and last a
//! CRC-32 of everything before it.

use super::cell::Cell;
use super::config::{MapConfig, MapConfigError};
use super::index::{LARGEST_COORDINATE, TileIndex};
use super::map::InformationMap;
use super::tile::{TILE_SIDE, Tile};
use super::zones::ZoneList;
use flate2::Crc;
use thiserror::Error;

/// Version of the layout written by [`InformationMap::to_bytes`].
pub const MAP_FORMAT_VERSION: u32 = 1;

const MAGIC: &[u8; 8] = b"MIRADMAP";

/// Why bytes are not a map.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MapBytesError {
    /// They do not begin like one.
    #[error("information map: the bytes do not begin with MIRADMAP, so this is not a map")]
    NotAMap,
    /// They were written by another version of the layout.
    #[error("information map: layout version {found}, this program reads version {MAP_FORMAT_VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
    /// They end too early.
    #[error("information map: the bytes end at {length}, before the map does")]
    Truncated {
        /// The number of bytes given.
        length: usize,
    },
    /// The checksum at the end does not fit the rest.
    #[error("information map: the checksum does not fit, the bytes are damaged")]
    Checksum,
    /// The settings inside are not allowed.
    #[error(transparent)]
    Config(#[from] MapConfigError),
    /// A value that no scan can have made.
    #[error("information map: {what} is impossible, the bytes were not written by this program")]
    Impossible {
        /// What is wrong.
        what: &'static str,
    },
}

/// The bytes ended before the value did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TruncatedMap;

/// Takes values off the front of some bytes.
pub(super) struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], TruncatedMap> {
        let (first, rest) = self.rest.split_first_chunk::<N>().ok_or(TruncatedMap)?;
        self.rest = rest;
        Ok(*first)
    }
}

impl InformationMap {
    /// The map as bytes; the same map always gives the same bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(1024 + self.tiles.len() * 8192);
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&MAP_FORMAT_VERSION.to_le_bytes());
        write_config(&self.config, &mut out);
        out.extend_from_slice(&self.revision.to_le_bytes());
        out.extend_from_slice(&(self.slots.len() as u64).to_le_bytes());
        for tile in self.tiles() {
            write_tile(tile, &mut out);
        }
        self.zones.write(&mut out);
        let sum = checksum(&out);
        out.extend_from_slice(&sum.to_le_bytes());
        out
    }

    /// The map that [`InformationMap::to_bytes`] wrote.
    ///
    /// # Errors
    /// See [`MapBytesError`]. Bytes of any other origin are refused, never trusted.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MapBytesError> {
        if !bytes.starts_with(MAGIC) {
            return Err(MapBytesError::NotAMap);
        }
        let truncated = |_: TruncatedMap| MapBytesError::Truncated { length: bytes.len() };
        let mut reader = Reader { rest: &bytes[MAGIC.len()..] };
        let found = u32::from_le_bytes(reader.array().map_err(truncated)?);
        if found != MAP_FORMAT_VERSION {
            return Err(MapBytesError::Version { found });
        }
        let (body, sum) = bytes.split_last_chunk::<4>().ok_or(MapBytesError::Truncated { length: bytes.len() })?;
        if checksum(body) != u32::from_le_bytes(*sum) {
            return Err(MapBytesError::Checksum);
        }
        let mut map = Self::new(read_config(&mut reader).map_err(truncated)??)?;
        map.revision = u64::from_le_bytes(reader.array().map_err(truncated)?);
        let count = u64::from_le_bytes(reader.array().map_err(truncated)?);
        for _ in 0..count {
            let tile = read_tile(&mut reader).map_err(truncated)??;
            if tile.revision > map.revision {
                return Err(MapBytesError::Impossible { what: "a tile newer than the map" });
            }
            if map.slots.last_key_value().is_some_and(|(last, _)| *last >= tile.index) {
                return Err(MapBytesError::Impossible { what: "the order of the tiles" });
            }
            map.slots.insert(tile.index, map.tiles.len());
            map.tiles.push(tile);
        }
        let zones = ZoneList::read(&mut reader).map_err(truncated)?;
        map.zones = zones.ok_or(MapBytesError::Impossible { what: "a zone without place or area" })?;
        if reader.rest != sum {
            return Err(MapBytesError::Impossible { what: "more bytes after the zones" });
        }
        Ok(map)
    }
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

fn write_config(config: &MapConfig, out: &mut Vec<u8>) {
    out.extend_from_slice(&config.cell_m.to_le_bytes());
    out.extend_from_slice(&config.navigable_threshold.to_le_bytes());
    out.extend_from_slice(&config.obstacle_threshold.to_le_bytes());
    out.extend_from_slice(&config.obstacle_weight.to_le_bytes());
    out.extend_from_slice(&(config.max_cells_per_triangle as u64).to_le_bytes());
}

fn read_config(reader: &mut Reader<'_>) -> Result<Result<MapConfig, MapBytesError>, TruncatedMap> {
    let config = MapConfig {
        cell_m: f64::from_le_bytes(reader.array()?),
        navigable_threshold: f32::from_le_bytes(reader.array()?),
        obstacle_threshold: f32::from_le_bytes(reader.array()?),
        obstacle_weight: f64::from_le_bytes(reader.array()?),
        max_cells_per_triangle: usize::try_from(u64::from_le_bytes(reader.array()?)).unwrap_or(usize::MAX),
    };
    Ok(config.validate().map(|()| config).map_err(MapBytesError::from))
}

fn write_tile(tile: &Tile, out: &mut Vec<u8>) {
    out.extend_from_slice(&tile.index.x.to_le_bytes());
    out.extend_from_slice(&tile.index.y.to_le_bytes());
    out.extend_from_slice(&tile.revision.to_le_bytes());
    out.extend_from_slice(&(tile.known_cells().count() as u16).to_le_bytes());
    for (within, cell) in tile.cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown()) {
        out.push(within as u8);
        cell.write(out);
    }
}

fn read_tile(reader: &mut Reader<'_>) -> Result<Result<Tile, MapBytesError>, TruncatedMap> {
    let impossible = |what| Ok(Err(MapBytesError::Impossible { what }));
    let index = TileIndex { x: i32::from_le_bytes(reader.array()?), y: i32::from_le_bytes(reader.array()?) };
    let limit = LARGEST_COORDINATE / TILE_SIDE;
    if !(-limit..limit).contains(&index.x) || !(-limit..limit).contains(&index.y) {
        return impossible("the place of a tile");
    }
    let mut tile = Tile::new(index);
    tile.revision = u64::from_le_bytes(reader.array()?);
    let mut last = None;
    for _ in 0..u16::from_le_bytes(reader.array()?) {
        let [within] = reader.array()?;
        if last.is_some_and(|last| last >= within) {
            return impossible("the order of the cells of a tile");
        }
        last = Some(within);
        let cell = Cell::read(reader)?;
        if !cell.is_possible() {
            return impossible("the evidence of a cell");
        }
        tile.cells[usize::from(within)] = cell;
    }
    Ok(Ok(tile))
}
