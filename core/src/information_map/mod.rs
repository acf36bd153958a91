//! The information map (section 4.1 of the spec): what every scan so far says about every piece of ground.
//!
//! A scored scan is condensed to its evidence ([`ScanEvidence`], 16 bytes an item); evidence and pose give what goes into
//! the map. When a pose is corrected, the scan is moved: what it said is taken away exactly and what it says now is
//! added. The map is therefore a function of summaries and poses: bit for bit the same in whatever order scans came and
//! however often they were moved.
//!
//! The map is a grid in the map frame that grows in all directions by tiles. Cells keep their evidence by height, so
//! that a bridge and the road under it are two levels of the same cells ([`Cell::levels`]); [`LevelChoice`] says which
//! one a robot would be on.

mod band;
mod block;
mod cell;
mod condense;
mod config;
mod evidence;
mod grid_line;
mod index;
mod item;
mod level_choice;
mod level_search;
mod map;
mod navigability;
mod normal_statistics;
mod obstructions;
mod patches;
mod places;
mod projection;
mod rasterise;
mod scan_evidence;
mod scan_poses;
#[cfg(test)]
mod test_world;
mod tile;
mod zones;

pub use cell::{Cell, Level, Levels, MAX_LEVELS};
pub use condense::{CondenseSummary, Condenser, InsertError};
pub use config::{MapConfig, MapConfigError};
pub use evidence::Evidence;
pub use grid_line::{cells_of_line, cells_touched_by_segment};
pub use index::{CellIndex, TileIndex};
pub use level_choice::{LevelChoice, Reach};
pub(crate) use level_search::{LevelSearch, TileLevels};
pub use map::InformationMap;
pub use navigability::{CellState, navigability_of};
pub use normal_statistics::{NormalStatistics, incidence};
pub use obstructions::Obstruction;
pub use scan_evidence::{EVIDENCE_FORMAT_VERSION, EvidenceBytesError, ScanEvidence};
pub use scan_poses::{Correction, Move, MoveConfig, ScanPoses};
pub use tile::{TILE_CELLS, TILE_SIDE, Tile};
pub use zones::{Zone, ZoneConfig, ZoneList, ZoneUpdate};
