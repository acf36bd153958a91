//! Scans with their true and prior poses, and which of them make pairs.

use std::path::{Path, PathBuf};

use mirador_core::formats::{Cloud, list_scans, read_cloud, read_poses};
use mirador_core::geometry::{Pose, rotation_angle};
use mirador_core::registration::Limits;
use mirador_core::scan::ScanView;

use super::AllPairsOptions;
use crate::registration::RegistrationBenchError;

/// Files in which data sets keep their own poses.
const OWN_POSES: [&str; 4] = ["truth.tum", "poses.tum", "groundtruth.txt", "poses.txt"];

/// Two scans of the set.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pair {
    pub target: usize,
    pub source: usize,
    /// The true `target_from_source`.
    pub truth: Pose,
    /// Where registration starts.
    pub start: Pose,
}

/// A data set in memory.
pub(super) struct DataSet {
    pub name: String,
    scans: Vec<Cloud>,
    pub pairs: Vec<Pair>,
    /// In words.
    pub about: Vec<String>,
}

impl DataSet {
    pub fn read(options: &AllPairsOptions) -> Result<Self, RegistrationBenchError> {
        let folder = &options.data;
        let files = list_scans(folder)?.files;
        let truth_file = truth_file(options)?;
        let truth = poses(&truth_file, files.len())?;
        let priors = options.poses.as_ref().map(|file| poses(&folder.join(file), files.len())).transpose()?;
        let (pairs, beyond) = pairs(&truth, priors.as_deref(), options.max_distance_m);
        if pairs.is_empty() {
            let reason = format!(
                "{}: no two of its {} scans lie within {} m and the limits of a registration; raise --max-distance, or give \
                 priors by --poses",
                folder.display(),
                files.len(),
                options.max_distance_m
            );
            return Err(RegistrationBenchError::NothingMeasured { reason });
        }
        let mut scans = Vec::with_capacity(files.len());
        for file in &files {
            scans.push(read_cloud(file)?);
        }
        let named = folder.canonicalize().unwrap_or_else(|_| folder.clone());
        let name = named.file_name().map_or_else(|| "data".into(), |name| name.to_string_lossy().into_owned());
        let mut about = vec![
            format!(
                "{name}: {} scans, {} pairs no farther apart than {} m",
                scans.len(),
                pairs.len(),
                options.max_distance_m
            ),
            format!("truth: {}", truth_file.display()),
            match &options.poses {
                Some(file) => format!("starts: the motions in {}", file.display()),
                None => "starts: the identity, as there are no priors".into(),
            },
        ];
        if beyond > 0 {
            about.push(format!(
                "{beyond} more pairs are left out: their starts are farther from the truth than any registration goes"
            ));
        }
        Ok(Self { name, scans, pairs, about })
    }

    /// A scan as methods take it.
    pub fn view(&self, scan: usize) -> ScanView<'_> {
        match self.scans.get(scan) {
            Some(cloud) => ScanView::with_grid(&cloud.points, cloud.grid),
            None => ScanView::unordered(&[]),
        }
    }
}

/// The file of true poses: as named, else the data's own.
fn truth_file(options: &AllPairsOptions) -> Result<PathBuf, RegistrationBenchError> {
    let folder = &options.data;
    if let Some(file) = &options.truth {
        return Ok(folder.join(file));
    }
    if let Some(own) = OWN_POSES.iter().map(|name| folder.join(name)).find(|file| file.is_file()) {
        return Ok(own);
    }
    if read_poses(folder).is_ok() {
        // The .pose files beside 3DTK's scans.
        return Ok(folder.clone());
    }
    let reason = format!(
        "{} has no poses of its own ({} or .pose files): name the file with the true ones",
        folder.display(),
        OWN_POSES.join(", ")
    );
    Err(RegistrationBenchError::BadOption { field: "truth", reason })
}

fn poses(file: &Path, scans: usize) -> Result<Vec<Pose>, RegistrationBenchError> {
    let poses = read_poses(file)?;
    if poses.len() != scans {
        let reason = format!("{} poses for {scans} scans; it needs one for each", poses.len());
        return Err(RegistrationBenchError::BadFile { path: file.to_path_buf(), reason });
    }
    Ok(poses.iter().map(|pose| pose.map_from_scanner).collect())
}

/// The pairs within `max_distance_m`, the earlier scan as target; and how many are left out because no registration goes so
/// far from its start.
fn pairs(truth: &[Pose], priors: Option<&[Pose]>, max_distance_m: f64) -> (Vec<Pair>, usize) {
    let (limits, mut pairs, mut beyond) = (Limits::default(), Vec::new(), 0);
    let motion = |poses: &[Pose], target: usize, source: usize| poses[target].inverse() * poses[source];
    for source in 0..truth.len() {
        for target in 0..source {
            let motion_between = motion(truth, target, source);
            if motion_between.translation.vector.norm() > max_distance_m {
                continue;
            }
            let start = priors.map_or_else(Pose::identity, |priors| motion(priors, target, source));
            let from_start = start.inverse() * motion_between;
            let is_within = from_start.translation.vector.norm() <= limits.max_translation_m
                && rotation_angle(&from_start) <= limits.max_rotation;
            if is_within {
                pairs.push(Pair { target, source, truth: motion_between, start });
            } else {
                beyond += 1;
            }
        }
    }
    (pairs, beyond)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn pose(x: f64, yaw: f64) -> Pose {
        Pose::new(Vector3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, yaw))
    }

    #[test]
    fn pairs_are_all_that_are_near_and_within_reach_of_a_start() {
        let truth = [pose(0.0, 0.0), pose(1.0, 0.0), pose(2.5, 1.0), pose(9.0, 0.0)];
        let (near, beyond) = pairs(&truth, None, 3.0);
        let places: Vec<(usize, usize)> = near.iter().map(|pair| (pair.target, pair.source)).collect();
        assert_eq!((places, beyond), (vec![(0, 1)], 2), "turned by 1 rad from an identity start");
        // Priors that turn along bring them within reach.
        let (near, beyond) = pairs(&truth, Some(&truth), 3.0);
        assert_eq!((near.len(), beyond), (3, 0));
        assert!((near[0].start.inverse() * near[0].truth).translation.vector.norm() < 1e-12);
    }
}
