//! The summaries of all scans of the map, in one file of the run directory: memory does not grow with them.
//!
//! Summaries are only added, behind the others. The checkpoint says how much of the file counts; what lies behind,
//! written just before a death, is cut off.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use mirador_core::information_map::ScanEvidence;
use mirador_service_common::CheckpointError;

/// The file, open for what comes next.
pub(crate) struct ScanFile {
    file: File,
    path: PathBuf,
    bytes: u64,
    /// Where the summary of a scan begins, and its length.
    places: BTreeMap<u32, (u64, u32)>,
    buffer: Vec<u8>,
}

impl ScanFile {
    /// An empty file.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn create(path: &Path) -> Result<Self, CheckpointError> {
        let fail = |source| CheckpointError::Io { path: path.into(), source };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(fail)?;
        }
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(path).map_err(fail)?;
        Ok(Self { file, path: path.into(), bytes: 0, places: BTreeMap::new(), buffer: Vec::new() })
    }

    /// Goes on with a file of which the checkpoint knows these summaries.
    ///
    /// # Errors
    /// [`CheckpointError`] when it is shorter.
    pub fn open(path: &Path, places: BTreeMap<u32, (u64, u32)>) -> Result<Self, CheckpointError> {
        let fail = |source| CheckpointError::Io { path: path.into(), source };
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(fail)?;
        let bytes = places.values().map(|(at, length)| at.saturating_add(u64::from(*length))).max().unwrap_or(0);
        let found = file.metadata().map_err(fail)?.len();
        if found < bytes {
            let reason = format!("it has {found} of {bytes} bytes");
            return Err(CheckpointError::Invalid { path: path.into(), reason });
        }
        file.set_len(bytes).map_err(fail)?;
        Ok(Self { file, path: path.into(), bytes, places, buffer: Vec::new() })
    }

    /// Where the summaries are, for the checkpoint.
    pub fn places(&self) -> &BTreeMap<u32, (u64, u32)> {
        &self.places
    }

    /// Adds the summary of a scan.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn append(&mut self, scan: u32, evidence: &ScanEvidence) -> Result<(), CheckpointError> {
        self.buffer.clear();
        evidence.write(&mut self.buffer);
        let fail = |source| CheckpointError::Io { path: self.path.clone(), source };
        self.file.write_all_at(&self.buffer, self.bytes).map_err(fail)?;
        self.places.insert(scan, (self.bytes, self.buffer.len() as u32));
        self.bytes += self.buffer.len() as u64;
        Ok(())
    }

    /// The summary of a scan; `None` when there is none.
    ///
    /// # Errors
    /// [`CheckpointError`] when it cannot be read or is damaged.
    pub fn read(&mut self, scan: u32) -> Result<Option<ScanEvidence>, CheckpointError> {
        let Some(&(at, length)) = self.places.get(&scan) else { return Ok(None) };
        self.buffer.resize(length as usize, 0);
        let fail = |source| CheckpointError::Io { path: self.path.clone(), source };
        self.file.read_exact_at(&mut self.buffer, at).map_err(fail)?;
        let invalid = |e: mirador_core::information_map::EvidenceBytesError| CheckpointError::Invalid {
            path: self.path.clone(),
            reason: format!("scan {scan}: {e}"),
        };
        ScanEvidence::read(&self.buffer).map(Some).map_err(invalid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mirador_core::analysis::PointScore;
    use mirador_core::geometry::Pose;
    use mirador_core::information_map::{Condenser, MapConfig};
    use mirador_core::scan::{Point, ScanView};

    fn evidence(points: usize) -> ScanEvidence {
        let points: Vec<_> = (0..points).map(|k| Point::new(k as f32, 0.0, 0.0)).collect();
        let scores = vec![PointScore { flags: PointScore::VALID, ..PointScore::NONE }; points.len()];
        let mut condenser = Condenser::new();
        let scan = ScanView::unordered(&points);
        condenser.condense(scan, &scores, &Pose::identity(), &MapConfig::default(), 1).unwrap().0.clone()
    }

    #[test]
    fn summaries_come_back_as_far_as_the_checkpoint_knows_and_others_follow_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state").join("x.scans");
        let mut file = ScanFile::create(&path).unwrap();
        file.append(0, &evidence(10)).unwrap();
        file.append(3, &evidence(20)).unwrap();
        let known = file.places().clone();
        file.append(4, &evidence(30)).unwrap();
        drop(file);
        let mut file = ScanFile::open(&path, known).unwrap();
        assert_eq!(file.read(3).unwrap(), Some(evidence(20)));
        assert_eq!(file.read(4).unwrap(), None);
        file.append(5, &evidence(7)).unwrap();
        assert_eq!((file.read(0).unwrap(), file.read(5).unwrap()), (Some(evidence(10)), Some(evidence(7))));
    }

    #[test]
    fn a_file_that_is_too_short_or_damaged_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.scans");
        let mut file = ScanFile::create(&path).unwrap();
        file.append(0, &evidence(10)).unwrap();
        let known = file.places().clone();
        let mut content = std::fs::read(&path).unwrap();
        let last = content.len() - 1;
        content[last] ^= 1;
        std::fs::write(&path, &content).unwrap();
        let error = ScanFile::open(&path, known.clone()).unwrap().read(0).unwrap_err().to_string();
        assert!(error.contains("x.scans") && error.contains("scan 0") && error.contains("damaged"), "{error}");
        std::fs::write(&path, &content[..last]).unwrap();
        let error = ScanFile::open(&path, known).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("x.scans") && error.contains("of"), "{error}");
    }
}
