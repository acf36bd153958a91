//! The scans a robot has taken, in the run directory: whoever missed one asks for it again.

use std::fs;
use std::path::PathBuf;

use mirador_ipc_schema::messages::{Point, PoseEstimate, SCAN_HAS_PRIOR, ScanMeta};
use mirador_ipc_schema::service::ServiceSetup;
use mirador_service_common::{CheckpointError, checkpoint};

/// What a file begins with.
const MAGIC: &[u8; 8] = b"mirscan1";

/// A scan as it was sent.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredScan {
    pub meta: ScanMeta,
    /// Its prior, if there was one.
    pub prior: Option<PoseEstimate>,
    pub points: Vec<Point>,
}

/// One file a scan.
pub(crate) struct ScanStore {
    folder: PathBuf,
    content: Vec<u8>,
}

impl ScanStore {
    pub fn new(setup: &ServiceSetup) -> Self {
        Self { folder: setup.run_dir.join("state").join("scans"), content: Vec::new() }
    }

    fn path(&self, scan: u32) -> PathBuf {
        self.folder.join(format!("{scan:06}.scan"))
    }

    /// Copies a scan that is about to be sent, to be written once it is.
    pub fn hold(&mut self, meta: &ScanMeta, prior: Option<&PoseEstimate>, points: &[Point]) {
        self.content.clear();
        self.content.extend_from_slice(MAGIC);
        self.content.extend_from_slice(bytemuck::bytes_of(meta));
        self.content.extend_from_slice(bytemuck::bytes_of(&prior.copied().unwrap_or_default()));
        self.content.extend_from_slice(bytemuck::cast_slice(points));
    }

    /// Writes the scan that is held.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn write(&self, scan: u32) -> Result<(), CheckpointError> {
        checkpoint::save(&self.path(scan), &self.content)
    }

    /// Reads a scan; `None` when it has not been taken.
    ///
    /// # Errors
    /// [`CheckpointError`] when the file is damaged.
    pub fn read(&self, scan: u32) -> Result<Option<StoredScan>, CheckpointError> {
        let path = self.path(scan);
        let Some(content) = checkpoint::load(&path)? else { return Ok(None) };
        let (meta_end, prior_end) =
            (MAGIC.len() + size_of::<ScanMeta>(), MAGIC.len() + size_of::<ScanMeta>() + size_of::<PoseEstimate>());
        let parts = || {
            let points = content.get(prior_end..)?;
            let meta: ScanMeta = bytemuck::pod_read_unaligned(content.get(MAGIC.len()..meta_end)?);
            let prior: PoseEstimate = bytemuck::pod_read_unaligned(content.get(meta_end..prior_end)?);
            let cells = (meta.rows as usize).checked_mul(meta.cols as usize)?;
            let is_whole = content.starts_with(MAGIC) && Some(points.len()) == cells.checked_mul(size_of::<Point>());
            let points = || points.chunks_exact(size_of::<Point>()).map(bytemuck::pod_read_unaligned).collect();
            let prior = (meta.flags & SCAN_HAS_PRIOR != 0).then_some(prior);
            is_whole.then(|| StoredScan { meta, prior, points: points() })
        };
        let damaged = || CheckpointError::Invalid { path, reason: "it is not one whole scan".into() };
        parts().map(Some).ok_or_else(damaged)
    }

    /// How many scans there are: one more than the highest number.
    pub fn count(&self) -> u32 {
        let Ok(entries) = fs::read_dir(&self.folder) else { return 0 };
        let number = |name: &str| name.strip_suffix(".scan").and_then(|number| number.parse::<u32>().ok());
        let numbers = entries.flatten().filter_map(|entry| number(entry.file_name().to_str()?));
        numbers.max().map_or(0, |newest| newest.saturating_add(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store(folder: &std::path::Path) -> ScanStore {
        ScanStore { folder: folder.into(), content: Vec::new() }
    }

    #[test]
    fn a_scan_comes_back_as_it_was_and_the_newest_gives_the_count() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = store(folder.path());
        assert_eq!((store.count(), store.read(0).unwrap()), (0, None));
        let meta = ScanMeta { rows: 2, cols: 3, flags: SCAN_HAS_PRIOR, ..ScanMeta::default() };
        let prior = PoseEstimate { source: 1, ..PoseEstimate::default() };
        let points: Vec<_> = (0..6_u8).map(|x| Point { x: f32::from(x), ..Point::default() }).collect();
        store.hold(&meta, Some(&prior), &points);
        store.write(4).unwrap();
        assert_eq!(store.read(4).unwrap().unwrap(), StoredScan { meta, prior: Some(prior), points });
        assert_eq!(store.count(), 5);
    }

    #[test]
    fn a_damaged_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = store(folder.path());
        store.hold(&ScanMeta { rows: 2, cols: 3, ..ScanMeta::default() }, None, &[Point::default(); 5]);
        store.write(0).unwrap();
        let message = store.read(0).unwrap_err().to_string();
        assert!(message.contains("000000.scan") && message.contains("whole scan"), "{message}");
    }
}
