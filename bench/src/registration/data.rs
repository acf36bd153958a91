//! The recorded data: pairs of scans with the true pose between them, and sequences.

use std::path::{Path, PathBuf};

use mirador_core::formats::{list_scans, read_cloud, read_poses};
use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_core::scan::Point;
use nalgebra::{Translation3, UnitQuaternion};

use super::RegistrationBenchError;

/// How well the truth of a pair is known. Errors below it cannot be told apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Of the translation [m].
    pub translation_m: f64,
    /// Of the rotation [deg]; `None` where the true rotation is not known at all.
    pub rotation_deg: Option<f64>,
}

/// A pair data set as it lies on disk.
struct PairFiles {
    name: &'static str,
    target: &'static str,
    source: &'static str,
    truth: Truth,
    accuracy: Accuracy,
    correspondence_m: f64,
}

/// Where the true pose of a pair is written.
enum Truth {
    /// A file with the 4x4 matrix, `target_from_source`.
    Matrix(&'static str),
    /// Row (from 0) of a table after its head line: a name, then the 4x4 matrix.
    TableRow(&'static str, usize),
    /// Only a translation is known [m].
    Translation([f64; 3]),
}

/// What every method agrees on for the frames 0 and 1 of `kitti00_first6` [m]; the poses shipped with it are 0.17 m off.
const KITTI_CONSENSUS_M: [f64; 3] = [0.689, 0.004, 0.008];

const EXACT: Accuracy = Accuracy { translation_m: 0.0, rotation_deg: Some(0.0) };

/// The pairs. The data's README has the accuracies of the translations of `handheld_pair` and `libpointmatcher` and of the
/// rotation of `small_gicp`; the others are our estimates: 8 mm at the 10 m of typical points are 0.05 deg, and 2 cm and
/// 0.3 deg where nothing is said.
const PAIRS: [PairFiles; 5] = [
    PairFiles {
        name: "synth_pair",
        target: "target.xyz32.bin",
        source: "source.xyz32.bin",
        truth: Truth::Matrix("target_from_source.txt"),
        accuracy: EXACT,
        correspondence_m: 1.0,
    },
    PairFiles {
        name: "handheld_pair",
        target: "target.xyz32.bin",
        source: "source.xyz32.bin",
        truth: Truth::Matrix("target_from_source.txt"),
        accuracy: Accuracy { translation_m: 0.008, rotation_deg: Some(0.05) },
        correspondence_m: 2.0,
    },
    PairFiles {
        name: "kitti00_first6",
        target: "000000.xyz32.bin",
        source: "000001.xyz32.bin",
        truth: Truth::Translation(KITTI_CONSENSUS_M),
        accuracy: Accuracy { translation_m: 0.02, rotation_deg: None },
        correspondence_m: 1.0,
    },
    PairFiles {
        name: "small_gicp",
        target: "target.ply",
        source: "source.ply",
        truth: Truth::Matrix("T_target_source.txt"),
        accuracy: Accuracy { translation_m: 0.02, rotation_deg: Some(0.3) },
        correspondence_m: 1.0,
    },
    PairFiles {
        name: "libpointmatcher",
        target: "car_cloud400.csv.gz",
        source: "car_cloud401.csv.gz",
        truth: Truth::TableRow("carCloudList.csv", 1),
        accuracy: Accuracy { translation_m: 0.02, rotation_deg: Some(0.3) },
        correspondence_m: 1.0,
    },
];

/// Two scans and the pose between them.
#[derive(Debug, Clone)]
pub struct PairData {
    /// Name of the data set.
    pub name: String,
    /// Raw points of the target [m, its scanner's frame].
    pub target: Vec<Point>,
    /// Raw points of the source [m, its scanner's frame].
    pub source: Vec<Point>,
    /// The true `target_from_source`.
    pub truth: Pose,
    /// How well it is known.
    pub accuracy: Accuracy,
    /// The farthest partner of a point that the peers are given [m].
    pub correspondence_m: f64,
}

/// The pairs below `root` one after the other, read when their turn comes; a data set that is not there is reported to
/// `say` and passed over. A `root` that holds `target_from_source.txt` is itself the only pair.
pub(super) fn for_each_pair(
    root: &Path,
    say: &mut dyn FnMut(&str),
    mut with: impl FnMut(PairData, &mut dyn FnMut(&str)) -> Result<(), RegistrationBenchError>,
) -> Result<(), RegistrationBenchError> {
    if root.join("target_from_source.txt").is_file() {
        return with(lone_pair(root)?, say);
    }
    for files in &PAIRS {
        let folder = root.join(files.name);
        if !folder.is_dir() {
            say(&format!("no data at {}: its rows are left out", folder.display()));
            continue;
        }
        with(read_pair(&folder, files)?, say)?;
    }
    Ok(())
}

fn read_pair(folder: &Path, files: &PairFiles) -> Result<PairData, RegistrationBenchError> {
    let truth = match files.truth {
        Truth::Matrix(name) => read_matrix(&folder.join(name))?,
        Truth::TableRow(name, row) => read_table_row(&folder.join(name), row)?,
        Truth::Translation([x, y, z]) => Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::identity()),
    };
    Ok(PairData {
        name: files.name.into(),
        target: returns(&folder.join(files.target))?,
        source: returns(&folder.join(files.source))?,
        truth,
        accuracy: files.accuracy,
        correspondence_m: files.correspondence_m,
    })
}

/// A pair of the user: `target.*`, `source.*` of any known format and the exact `target_from_source.txt`.
fn lone_pair(folder: &Path) -> Result<PairData, RegistrationBenchError> {
    let scans = list_scans(folder)?;
    let scan = |name: &str| {
        let starts = |file: &&PathBuf| {
            file.file_name().is_some_and(|file| file.to_string_lossy().starts_with(&format!("{name}.")))
        };
        scans.files.iter().find(starts).ok_or_else(|| RegistrationBenchError::BadFile {
            path: folder.to_path_buf(),
            reason: format!("it has no scan called {name}"),
        })
    };
    let name = folder.canonicalize().ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
    Ok(PairData {
        name: name.unwrap_or_else(|| "pair".into()),
        target: returns(scan("target")?)?,
        source: returns(scan("source")?)?,
        truth: read_matrix(&folder.join("target_from_source.txt"))?,
        accuracy: EXACT,
        correspondence_m: 1.0,
    })
}

/// Scans in a row.
#[derive(Debug, Clone)]
pub struct SequenceData {
    /// Name of the data set.
    pub name: String,
    /// Raw points of each scan [m, its scanner's frame].
    pub scans: Vec<Vec<Point>>,
    /// `map_from_scanner` by odometry, one a scan; empty where there is none.
    pub priors: Vec<Pose>,
    /// The true `map_from_scanner`, one a scan; empty where there is none.
    pub truth: Vec<Pose>,
}

/// The 45 handheld scans with their drifting odometry.
pub(super) fn read_handheld(folder: &Path) -> Result<SequenceData, RegistrationBenchError> {
    let poses = |name: &str| -> Result<Vec<Pose>, RegistrationBenchError> {
        Ok(read_poses(&folder.join(name))?.into_iter().map(|pose| pose.map_from_scanner).collect())
    };
    let scans = list_scans(folder)?.files.iter().map(|file| returns(file)).collect::<Result<Vec<_>, _>>()?;
    let (priors, truth) = (poses("odometry.tum")?, poses("poses.tum")?);
    if priors.len() != scans.len() || truth.len() != scans.len() {
        let reason = format!("{} scans, {} priors and {} true poses", scans.len(), priors.len(), truth.len());
        return Err(RegistrationBenchError::BadFile { path: folder.to_path_buf(), reason });
    }
    Ok(SequenceData { name: "handheld".into(), scans, priors, truth })
}

/// The first frames of KITTI 00: no odometry, no usable poses.
pub(super) fn read_kitti(folder: &Path) -> Result<SequenceData, RegistrationBenchError> {
    let scans = list_scans(folder)?.files.iter().map(|file| returns(file)).collect::<Result<Vec<_>, _>>()?;
    Ok(SequenceData { name: "kitti00_first6".into(), scans, priors: Vec::new(), truth: Vec::new() })
}

/// How far the motion between the first two frames of KITTI is from the consensus [m].
pub(super) fn kitti_error_m(poses: &[Pose]) -> Option<f64> {
    let [first, second, ..] = poses else { return None };
    let motion = first.inverse() * second;
    Some((motion.translation.vector - nalgebra::Vector3::from(KITTI_CONSENSUS_M)).norm())
}

/// The returns of a cloud, in the order of the file.
fn returns(file: &Path) -> Result<Vec<Point>, RegistrationBenchError> {
    let cloud = read_cloud(file)?;
    Ok(cloud.points.into_iter().filter(Point::is_return).collect())
}

fn read_matrix(file: &Path) -> Result<Pose, RegistrationBenchError> {
    pose_of(file, &read_text(file)?)
}

fn read_table_row(file: &Path, row: usize) -> Result<Pose, RegistrationBenchError> {
    let text = read_text(file)?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let values = lines.get(1 + row).and_then(|line| line.split_once(',')).map_or("", |(_, values)| values);
    pose_of(file, &values.replace(',', " "))
}

fn read_text(file: &Path) -> Result<String, RegistrationBenchError> {
    std::fs::read_to_string(file).map_err(|e| bad_file(file, e.to_string()))
}

/// The pose of 16 numbers, row by row.
fn pose_of(file: &Path, text: &str) -> Result<Pose, RegistrationBenchError> {
    let numbers: Vec<f64> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
    let rows: Option<[f64; 16]> = numbers.try_into().ok();
    rows.as_ref().and_then(pose_from_rows).ok_or_else(|| bad_file(file, "it is not a rigid 4x4 matrix".into()))
}

fn bad_file(file: &Path, reason: String) -> RegistrationBenchError {
    RegistrationBenchError::BadFile { path: file.to_path_buf(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_sixteen_numbers_of_a_rigid_motion() {
        let file = Path::new("p.txt");
        let pose = pose_of(file, "1 0 0 0.5\n0 1 0 -2\n0 0 1 3\n0 0 0 1\n").unwrap();
        assert_eq!(pose.translation.vector.as_slice(), [0.5, -2.0, 3.0]);
        for wrong in ["", "1 2 3", "2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "1 0 0 x 0 1 0 0 0 0 1 0 0 0 0 1"] {
            assert!(pose_of(file, wrong).unwrap_err().to_string().contains("p.txt"), "{wrong}");
        }
    }

    #[test]
    fn the_error_at_kitti_is_that_of_the_first_motion() {
        let pose = |x: f64| Pose::from_parts(Translation3::new(x, 0.004, 0.008), UnitQuaternion::identity());
        let error = kitti_error_m(&[Pose::identity(), pose(0.699)]).unwrap();
        assert!((error - 0.01).abs() < 1e-12);
        assert_eq!(kitti_error_m(&[Pose::identity()]), None);
    }

    #[test]
    fn absent_data_sets_are_named_and_passed_over() {
        let mut said = Vec::new();
        let root = Path::new("/no/such/folder");
        for_each_pair(root, &mut |line| said.push(line.to_owned()), |_, _| unreachable!()).unwrap();
        assert_eq!(said.len(), PAIRS.len());
        assert!(said[0].contains("/no/such/folder/synth_pair"), "{said:?}");
    }
}
