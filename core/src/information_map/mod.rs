//! The information map (section 4.1 of the spec): what every scan so far says about every piece of ground.
//!
//! A 2D grid in the map frame that grows in all directions by tiles. Every aligned scan is projected into it; cells
//! accumulate evidence in integers, so the map is the same, bit for bit, in whatever order the points arrive.
//! Known limits: one level (a bridge and the road under it share their cells), and evidence is only ever added.

mod bytes;
mod cell;
mod config;
mod frame;
mod grid_line;
mod index;
mod insert;
mod map;
mod navigability;
mod normal_statistics;
mod projection;
mod rasterise;
mod tile;
mod zones;

pub use bytes::{MAP_FORMAT_VERSION, MapBytesError};
pub use cell::{Cell, Evidence};
pub use config::{MapConfig, MapConfigError};
pub use grid_line::{cells_of_line, cells_touched_by_segment};
pub use index::{CellIndex, TileIndex};
pub use insert::{InsertError, InsertSummary};
pub use map::InformationMap;
pub use navigability::{CellState, navigability_of};
pub use normal_statistics::{NormalStatistics, incidence};
pub use tile::{TILE_CELLS, TILE_SIDE, Tile};
pub use zones::{Zone, ZoneConfig, ZoneList, ZoneUpdate};
