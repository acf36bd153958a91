//! What is written down so that a restarted planning goes on where it stopped: where every scan of the map stands, the
//! zones, the obstructions, and the last messages. The map itself is made again from the summaries of the scans.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flate2::Crc;
use mirador_core::information_map::{InformationMap, Obstruction, ScanPoses, ZoneList};
use mirador_ipc_schema::messages::Header;
use mirador_service_common::{CheckpointError, ServiceError, checkpoint};

use crate::PlanningServiceConfig;
use crate::scan_file::ScanFile;

/// Begins the checkpoint; the last byte is the version.
const MARK: [u8; 4] = *b"MPS\x04";

/// Where planning is.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Progress {
    /// Number of scans planned on.
    pub planned_scans: u32,
    /// Number of scans after which older ones stand where they belong.
    pub finished_scans: u32,
    /// What identifies the last scan: id, time of its sensor [ns], and the clock of that.
    pub last_scan: (u64, i64, u32),
    /// The last view plan and path as bytes. Readers that were not there when they were sent get them from the topic's
    /// history, which dies with the process.
    pub last_plan: Vec<u8>,
    pub last_path: Vec<u8>,
    /// Height of the ground under the robot at the last scan, relative to the scanner [m].
    pub ground_height_m: f64,
    /// The scans planned on, and where the robot was then [m, map frame]: strategies keep away from where they have been.
    pub visited: Vec<(u32, [f64; 3])>,
}

impl Progress {
    /// The header of a message about the last scan.
    pub fn header(&self, began_ns: u64) -> Header {
        let (id, stamp_ns, clock_id) = self.last_scan;
        Header::about(&Header { id, stamp_ns, clock_id, ..Header::default() }, began_ns)
    }
}

/// The map with what belongs to it.
pub(crate) struct KeptMap {
    pub map: InformationMap,
    pub poses: ScanPoses,
    pub file: ScanFile,
}

/// Writes down where planning is.
///
/// # Errors
/// [`CheckpointError`].
pub(crate) fn save(path: &Path, kept: &KeptMap, progress: &Progress) -> Result<(), CheckpointError> {
    let mut out = MARK.to_vec();
    out.extend_from_slice(&[0; 4]);
    for number in [progress.planned_scans, progress.finished_scans, progress.last_scan.2] {
        out.extend_from_slice(&number.to_le_bytes());
    }
    out.extend_from_slice(&progress.last_scan.0.to_le_bytes());
    out.extend_from_slice(&progress.last_scan.1.to_le_bytes());
    out.extend_from_slice(&progress.ground_height_m.to_le_bytes());
    out.extend_from_slice(&kept.map.revision().to_le_bytes());
    out.extend_from_slice(&(kept.file.places().len() as u64).to_le_bytes());
    for (scan, (at, length)) in kept.file.places() {
        out.extend_from_slice(&scan.to_le_bytes());
        out.extend_from_slice(&at.to_le_bytes());
        out.extend_from_slice(&length.to_le_bytes());
    }
    kept.poses.write(&mut out);
    kept.map.zone_list().write(&mut out);
    out.extend_from_slice(&(kept.map.obstructions().len() as u64).to_le_bytes());
    for Obstruction { centre: [x, y], radius_m } in kept.map.obstructions() {
        [x, y, radius_m].iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }
    out.extend_from_slice(&(kept.map.driven().len() as u64).to_le_bytes());
    kept.map.driven().iter().flatten().flatten().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    out.extend_from_slice(&(progress.visited.len() as u64).to_le_bytes());
    for (scan, place) in &progress.visited {
        out.extend_from_slice(&scan.to_le_bytes());
        place.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }
    for message in [&progress.last_plan, &progress.last_path] {
        out.extend_from_slice(&(message.len() as u64).to_le_bytes());
        out.extend_from_slice(message);
    }
    let sum = checksum(&out[8..]);
    out[4..8].copy_from_slice(&sum.to_le_bytes());
    checkpoint::save(path, &out)
}

/// Opens the map: empty for a new run, else as an earlier incarnation has left it.
///
/// # Errors
/// See [`ServiceError`].
pub(crate) fn open(
    path: &Path,
    is_new: bool,
    config: &PlanningServiceConfig,
) -> Result<(KeptMap, Progress), ServiceError> {
    let mut map = InformationMap::new(config.map).map_err(|e| ServiceError::Config(e.to_string()))?;
    let scans = path.with_extension("scans");
    let content = if is_new { None } else { checkpoint::load(path)? };
    let Some(content) = content else {
        let kept = KeptMap { map, poses: ScanPoses::default(), file: ScanFile::create(&scans)? };
        return Ok((kept, Progress::default()));
    };
    let saved = read(path.into(), &content)?;
    let mut file = ScanFile::open(&scans, saved.places)?;
    let missing = |reason: String| CheckpointError::Invalid { path: scans.clone(), reason };
    for (scan, pose) in saved.poses.iter() {
        let evidence = u32::try_from(scan).ok().map(|scan| file.read(scan)).transpose()?.flatten();
        let evidence = evidence.ok_or_else(|| missing(format!("it does not hold scan {scan}")))?;
        map.add(&evidence, pose).map_err(|e| missing(format!("scan {scan}: {e}")))?;
    }
    map.restore_zones(saved.zones);
    for obstruction in saved.obstructions {
        map.obstruct(obstruction);
    }
    for piece in saved.driven {
        map.drove(&piece);
    }
    map.resume_revision(saved.revision);
    Ok((KeptMap { map, poses: saved.poses, file }, saved.progress))
}

/// What a checkpoint holds.
struct Saved {
    progress: Progress,
    revision: u64,
    places: BTreeMap<u32, (u64, u32)>,
    poses: ScanPoses,
    zones: ZoneList,
    obstructions: Vec<Obstruction>,
    driven: Vec<[[f64; 2]; 2]>,
}

fn read(path: PathBuf, content: &[u8]) -> Result<Saved, CheckpointError> {
    let invalid = |reason: &str| CheckpointError::Invalid { path: path.clone(), reason: reason.into() };
    let (mark, rest) = content.split_first_chunk::<4>().ok_or_else(|| invalid("it is empty"))?;
    if *mark != MARK {
        return Err(invalid("it does not begin as one of this version"));
    }
    let (sum, body) = rest.split_first_chunk::<4>().ok_or_else(|| invalid("it is torn"))?;
    if checksum(body).to_le_bytes() != *sum {
        return Err(invalid("its checksum does not fit"));
    }
    parse(body).ok_or_else(|| invalid("it is torn"))
}

fn parse(body: &[u8]) -> Option<Saved> {
    let mut rest = body;
    let [planned_scans, finished_scans, clock] = [(); 3].map(|()| take(&mut rest).map(u32::from_le_bytes));
    let last_scan = (u64::from_le_bytes(take(&mut rest)?), i64::from_le_bytes(take(&mut rest)?), clock?);
    let ground_height_m = f64::from_le_bytes(take(&mut rest)?);
    let revision = u64::from_le_bytes(take(&mut rest)?);
    let mut places = BTreeMap::new();
    for _ in 0..u64::from_le_bytes(take(&mut rest)?) {
        let scan = u32::from_le_bytes(take(&mut rest)?);
        let at = u64::from_le_bytes(take(&mut rest)?);
        places.insert(scan, (at, u32::from_le_bytes(take(&mut rest)?)));
    }
    let poses = ScanPoses::read(&mut rest)?;
    let zones = ZoneList::read(&mut rest)?;
    let mut obstructions = Vec::new();
    for _ in 0..u64::from_le_bytes(take(&mut rest)?) {
        let [x, y, radius_m] = [(); 3].map(|()| take(&mut rest).map(f64::from_le_bytes));
        obstructions.push(Obstruction { centre: [x?, y?], radius_m: radius_m? });
    }
    let mut driven = Vec::new();
    for _ in 0..u64::from_le_bytes(take(&mut rest)?) {
        let [a, b, c, d] = [(); 4].map(|()| take(&mut rest).map(f64::from_le_bytes));
        driven.push([[a?, b?], [c?, d?]]);
    }
    let mut visited = Vec::new();
    for _ in 0..u64::from_le_bytes(take(&mut rest)?) {
        let scan = u32::from_le_bytes(take(&mut rest)?);
        let [x, y, z] = [(); 3].map(|()| take(&mut rest).map(f64::from_le_bytes));
        visited.push((scan, [x?, y?, z?]));
    }
    let (last_plan, last_path) = (message(&mut rest)?, message(&mut rest)?);
    let progress = Progress {
        planned_scans: planned_scans?,
        finished_scans: finished_scans?,
        last_scan,
        last_plan,
        last_path,
        ground_height_m,
        visited,
    };
    rest.is_empty().then_some(Saved { progress, revision, places, poses, zones, obstructions, driven })
}

fn message(rest: &mut &[u8]) -> Option<Vec<u8>> {
    let length = usize::try_from(u64::from_le_bytes(take(rest)?)).ok()?;
    let (message, behind) = rest.split_at_checked(length)?;
    *rest = behind;
    Some(message.to_vec())
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (first, behind) = rest.split_first_chunk::<N>()?;
    *rest = behind;
    Some(*first)
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mirador_core::analysis::PointScore;
    use mirador_core::geometry::Pose;
    use mirador_core::information_map::{Condenser, MoveConfig, Zone, ZoneConfig};
    use mirador_core::scan::{Point, ScanView};
    use nalgebra::{Point3, Vector3};

    /// A map of three scans, the second of which was moved and the third of which is to be.
    fn some_state(path: &Path, config: &PlanningServiceConfig) -> (KeptMap, Progress) {
        let (mut kept, mut progress) = open(path, true, config).unwrap();
        let mut condenser = Condenser::new();
        for scan in 0..3_u32 {
            let points: Vec<_> = (0..500).map(|k| Point::new(0.1 * k as f32, scan as f32, -1.0)).collect();
            let scores = vec![PointScore { flags: 3, navigable: 60_000, ..PointScore::NONE }; points.len()];
            let pose = Pose::translation(f64::from(scan), 1.0 / 3.0, 0.0);
            let view = ScanView::unordered(&points);
            let (evidence, _) = condenser.condense(view, &scores, &pose, &config.map, 1).unwrap();
            kept.file.append(scan, evidence).unwrap();
            kept.map.add(evidence, &pose).unwrap();
            kept.poses.added(scan.into(), pose);
        }
        let zone = Zone { centre: Point3::new(5.0, 0.0, 1.0), normal: Vector3::x() };
        kept.map.obstruct(Obstruction { centre: [1.0 / 3.0, -2.0], radius_m: 0.3 });
        kept.map.drove(&[[0.0, 1.0], [1.0 / 3.0, 1.0], [2.0, -1.0]]);
        kept.map.update_zones(1, &[zone], &Pose::translation(0.0, 60.0, 0.0), &ZoneConfig::default());
        let there = Pose::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.0, 0.0, 0.01));
        kept.poses.correct(1, &there, &MoveConfig::default());
        let due = kept.poses.next_move().unwrap();
        let evidence = kept.file.read(1).unwrap().unwrap();
        kept.map.move_scan(&evidence, &due.from, &due.to).unwrap();
        kept.poses.moved(&due);
        kept.poses.correct(2, &there, &MoveConfig::default());
        progress =
            Progress { planned_scans: 3, finished_scans: 2, last_scan: (7, -8, 9), ground_height_m: -1.25, ..progress };
        (progress.last_plan, progress.last_path) = (vec![1; 50], vec![2; 5]);
        progress.visited = vec![(0, [0.1, 1.0 / 3.0, -1.0]), (2, [1e-300, 7.0, 0.0])];
        save(path, &kept, &progress).unwrap();
        (kept, progress)
    }

    #[test]
    fn a_restarted_planning_has_the_same_map_and_knows_what_is_still_to_be_moved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("planning.state");
        let config = PlanningServiceConfig::default();
        let (kept, progress) = some_state(&path, &config);
        let (again, found) = open(&path, false, &config).unwrap();
        assert!(again.map == kept.map);
        assert_eq!((again.map.revision(), found), (kept.map.revision(), progress));
        assert_eq!(again.poses, kept.poses);
        assert_eq!(again.poses.next_move().unwrap().scan, 2);
    }

    #[test]
    fn a_damaged_checkpoint_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("planning.state");
        let config = PlanningServiceConfig::default();
        some_state(&path, &config);
        let content = std::fs::read(&path).unwrap();
        for length in [0, 3, 7, 20, content.len() - 1] {
            std::fs::write(&path, &content[..length]).unwrap();
            let error = open(&path, false, &config).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains("planning.state"), "{length}: {error}");
        }
        std::fs::write(&path, &content).unwrap();
        std::fs::remove_file(path.with_extension("scans")).unwrap();
        let error = open(&path, false, &config).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("planning.scans"), "{error}");
    }
}
