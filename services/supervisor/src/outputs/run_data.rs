//! What the outputs need of a recording: everything but the points, so that memory does not grow with them.

use std::collections::BTreeMap;

use mirador_core::geometry::{Pose, Twist, pose_from_rows};
use mirador_core::odometry::MotionTable;
use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, CLOCK_ENDED, CLOCK_FAULT, CandidateView,
    MAP_TILE_SIDE, MapCell, MapTile, ScanId, ScanMeta, ScoredScanMeta, ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::{text, topics};
use mirador_recorder::{ReadError, RunReader};

use super::drive::Drive;
use super::work::WorkLog;

/// Everything that was said about one scan, without its points.
#[derive(Debug, Clone, Default)]
pub struct ScanRecord {
    /// The scan.
    pub scan: ScanMeta,
    /// How it was aligned.
    pub alignment: Option<AlignmentMeta>,
    /// The last correction of its pose, map_from_scanner.
    pub corrected: Option<Pose>,
    /// Its scores in sum.
    pub scored: Option<ScoredScanMeta>,
    /// The first view plan after it.
    pub first_plan: Option<ViewPlanMeta>,
    /// The last view plan after it, with the chosen candidate.
    pub plan: Option<(ViewPlanMeta, Option<CandidateView>)>,
    /// The last path after it.
    pub path: Vec<Waypoint>,
    /// The length of that path [m].
    pub path_length_m: f64,
}

impl ScanRecord {
    /// Number of the scan in the run.
    #[must_use]
    pub fn number(&self) -> u32 {
        self.scan.header.scan()
    }

    /// Whether the scan has its place in the map.
    #[must_use]
    pub fn is_aligned(&self) -> bool {
        self.alignment.is_some_and(|a| a.status == ALIGNMENT_FIRST || a.status == ALIGNMENT_ACCEPTED)
    }

    /// map_from_scanner: the last correction, else the alignment (the guess where that failed).
    #[must_use]
    pub fn pose(&self) -> Option<Pose> {
        self.corrected.or_else(|| pose_from_rows(&self.alignment?.map_from_scanner))
    }

    /// The motion during the scan by which its points are deskewed; `None` where the scanner stood.
    #[must_use]
    pub fn scan_motion(&self) -> Option<MotionTable> {
        let motion = self.alignment?.scan_motion;
        let is_motion = motion.iter().all(|v| v.is_finite()) && motion.iter().any(|v| *v != 0.0);
        is_motion.then(|| MotionTable::new(&Twist::from(motion)))
    }

    /// How the alignment ended, in a word.
    #[must_use]
    pub fn status(&self) -> &'static str {
        match self.alignment.map(|a| a.status) {
            Some(ALIGNMENT_FIRST) => "first",
            Some(ALIGNMENT_ACCEPTED) => "accepted",
            Some(ALIGNMENT_REJECTED) => "rejected",
            Some(_) => "unknown",
            None => "missing",
        }
    }

    /// Why the scan is not aligned; `None` when it is.
    #[must_use]
    pub fn reason(&self) -> Option<String> {
        match &self.alignment {
            _ if self.is_aligned() => None,
            Some(alignment) if alignment.reason[0] != 0 => Some(text::unpack(&alignment.reason).to_owned()),
            Some(_) => Some("no reason was given".to_owned()),
            None => Some("the run ended before it was aligned".to_owned()),
        }
    }
}

/// The information map at the end of a run.
#[derive(Debug, Clone, Default)]
pub struct FinalMap {
    /// Side of a cell [m].
    pub cell_m: f64,
    /// The lowest level of the tiles, by column and row.
    pub tiles: BTreeMap<(i32, i32), Box<MapTile>>,
    /// The higher levels, by column, row and level.
    pub upper: BTreeMap<(i32, i32, u32), Box<MapTile>>,
    /// Mean quality of the known cells.
    pub mean_quality: f64,
    /// Known cells.
    pub cells_known: u32,
}

impl FinalMap {
    /// The cell (column, row); `None` when nothing is known of it.
    #[must_use]
    pub fn cell(&self, column: i64, row: i64) -> Option<&MapCell> {
        let side = MAP_TILE_SIDE as i64;
        let tile = (i32::try_from(column.div_euclid(side)).ok()?, i32::try_from(row.div_euclid(side)).ok()?);
        let index = row.rem_euclid(side) * side + column.rem_euclid(side);
        let cell = self.tiles.get(&tile)?.cells.get(index as usize)?;
        (cell.flags & 1 != 0).then_some(cell)
    }

    /// The highest level over the lowest at a position of the map [m]; `None` where there is but one.
    #[must_use]
    pub fn above(&self, x: f64, y: f64) -> Option<&MapCell> {
        let side = MAP_TILE_SIDE as i64;
        let [column, row] = [x, y].map(|v| (v / self.cell_m).floor() as i64);
        let tile = (i32::try_from(column.div_euclid(side)).ok()?, i32::try_from(row.div_euclid(side)).ok()?);
        let index = (row.rem_euclid(side) * side + column.rem_euclid(side)) as usize;
        let levels = self.upper.range((tile.0, tile.1, 1)..=(tile.0, tile.1, u32::MAX)).rev();
        levels.filter_map(|(_, tile)| tile.cells.get(index)).find(|cell| cell.flags & 1 != 0)
    }

    /// Takes in tiles that changed.
    pub fn take(&mut self, tiles: &[MapTile]) {
        for tile in tiles {
            let (x, y) = (tile.tile_x, tile.tile_y);
            if tile.level == 0 {
                self.tiles.insert((x, y), Box::new(*tile));
                // Levels that the tile has no more.
                self.upper.retain(|key, _| (key.0, key.1) != (x, y) || key.2 < tile.levels);
            } else {
                self.upper.insert((x, y, tile.level), Box::new(*tile));
            }
        }
    }

    /// The cell of the lowest level at a position of the map [m].
    #[must_use]
    pub fn at(&self, x: f64, y: f64) -> Option<&MapCell> {
        self.cell((x / self.cell_m).floor() as i64, (y / self.cell_m).floor() as i64)
    }
}

/// How the source of the scans ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SourceEnd {
    /// It did not say.
    #[default]
    Open,
    /// All its scans were released and finished.
    Ended,
    /// It could not go on.
    Fault,
}

/// A recording without its points.
#[derive(Debug, Clone, Default)]
pub struct RunData {
    /// The scans, by number.
    pub scans: Vec<ScanRecord>,
    /// The last view plan and its candidates.
    pub last_plan: Option<(ViewPlanMeta, Vec<CandidateView>)>,
    /// The map.
    pub map: FinalMap,
    /// How the robot drove.
    pub drive: Drive,
    /// What the services did when.
    pub work: WorkLog,
    /// How the source ended.
    pub source: SourceEnd,
    /// Whether scans were taken as the robot went, their number known to nobody before.
    pub is_live: bool,
    /// Whether the recording was ended in order.
    pub complete: bool,
}

impl RunData {
    /// Reads everything but the points.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn read(reader: &mut RunReader) -> Result<Self, ReadError> {
        let mut data = Self { complete: reader.is_complete(), ..Self::default() };
        let mut scans = BTreeMap::new();
        reader.for_each_meta::<topics::Scan>(|meta, _| {
            let number = meta.header.scan();
            scans.entry(number).or_insert_with(|| ScanRecord { scan: *meta, ..ScanRecord::default() });
        })?;
        reader.for_each_meta::<topics::Alignment>(|meta, _| {
            if let Some(record) = scans.get_mut(&meta.header.scan()) {
                record.alignment = Some(*meta);
            }
        })?;
        reader.for_each::<topics::PoseCorrections>(|_, corrections| {
            for correction in corrections {
                let record = scans.get_mut(&ScanId::unpack(correction.id).scan);
                if let (Some(record), Some(pose)) = (record, pose_from_rows(&correction.map_from_scanner)) {
                    record.corrected = Some(pose);
                }
            }
        })?;
        reader.for_each_meta::<topics::ScoredScan>(|meta, _| {
            if let Some(record) = scans.get_mut(&meta.header.scan()) {
                record.scored = Some(*meta);
            }
        })?;
        data.read_plans(reader, &mut scans)?;
        data.read_map(reader)?;
        data.drive = Drive::read(reader)?;
        reader.for_each::<topics::ServiceHealth>(|_, reports| reports.iter().for_each(|r| data.work.take(r)))?;
        reader.for_each_meta::<topics::Clock>(|meta, _| {
            data.is_live = meta.scans_expected == 0;
            data.source = match meta.state {
                CLOCK_ENDED => SourceEnd::Ended,
                CLOCK_FAULT => SourceEnd::Fault,
                _ => data.source,
            };
        })?;
        data.scans = scans.into_values().collect();
        Ok(data)
    }

    fn read_plans(&mut self, reader: &mut RunReader, scans: &mut BTreeMap<u32, ScanRecord>) -> Result<(), ReadError> {
        reader.for_each::<topics::ViewPlan>(|meta, candidates| {
            if let Some(record) = scans.get_mut(&meta.header.scan()) {
                let chosen = usize::try_from(meta.chosen).ok().and_then(|k| candidates.get(k)).copied();
                record.first_plan.get_or_insert(*meta);
                record.plan = Some((*meta, chosen));
            }
            self.last_plan = Some((*meta, candidates.to_vec()));
        })?;
        reader.for_each::<topics::Path>(|meta, waypoints| {
            if let Some(record) = scans.get_mut(&meta.header.scan()) {
                record.path = waypoints.to_vec();
                record.path_length_m = meta.length_m;
            }
        })
    }

    fn read_map(&mut self, reader: &mut RunReader) -> Result<(), ReadError> {
        let map = &mut self.map;
        reader.for_each::<topics::InformationMap>(|meta, tiles| {
            map.cell_m = meta.cell_m;
            map.mean_quality = meta.mean_quality;
            map.cells_known = meta.cells_known;
            map.take(tiles);
        })
    }

    /// Distance driven, or, where no robot drove, from the first to the last scan [m]. A leg is as long as the planned path where the next scan was taken
    /// at its end, and straight otherwise.
    #[must_use]
    pub fn distance_m(&self) -> f64 {
        if !self.drive.track.is_empty() {
            return self.drive.distance_m;
        }
        let aligned: Vec<_> =
            self.scans.iter().filter(|s| s.is_aligned()).filter_map(|s| Some((s, s.pose()?))).collect();
        aligned
            .windows(2)
            .map(|leg| {
                let ((from, a), (_, b)) = (&leg[0], &leg[1]);
                let b = b.translation.vector;
                let arrived = from
                    .path
                    .last()
                    .is_some_and(|end| (end.position[0] - b.x).hypot(end.position[1] - b.y) < ARRIVED_M);
                if arrived { from.path_length_m } else { (b - a.translation.vector).norm() }
            })
            .sum()
    }
}

/// A scan taken within this distance of the end of a path was taken at its end [m].
const ARRIVED_M: f64 = 0.5;
