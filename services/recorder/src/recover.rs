//! Going on with the recording of a process that was killed.

use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use mirador_ipc_schema::Header;
use mirador_ipc_schema::topics;
use mirador_viewers::View;

use crate::ledger::Ledger;
use crate::{CHANNEL_PREFIX, ReadError, RecorderConfig, RunReader, RunWriter, WriteError};

/// Why a recording cannot be gone on with.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The old file cannot be read.
    #[error("cannot go on with the recording: {0}")]
    Read(#[from] ReadError),
    /// The new file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The new file cannot take the place of the old one.
    #[error("cannot put the recovered recording in place of '{path}': {source}")]
    Replace {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Copies every complete chunk of `path` into a new file, puts that in its place and returns its writer, open for what
/// comes next. The messages are entered in `ledger`; `progress` is called after each.
///
/// # Errors
/// See [`RecoverError`]. A file without one complete chunk is replaced by an empty recording.
pub(crate) fn recover(
    path: &Path,
    config: &RecorderConfig,
    ledger: &mut Ledger,
    view: Option<&mut View>,
    progress: &mut dyn FnMut(),
) -> Result<RunWriter, RecoverError> {
    let mut old = match RunReader::open(path) {
        Ok(old) => old,
        Err(ReadError::Empty { .. } | ReadError::NotMcap { .. }) => {
            tracing::warn!(path = %path.display(), "the recording holds nothing yet; it begins anew");
            return Ok(RunWriter::create(path, config)?);
        }
        Err(error) => return Err(error.into()),
    };
    // Beside the old file until it is whole: if this process dies too, the next one finds the old file again.
    let fresh = path.with_extension("mcap.recovering");
    let mut writer = RunWriter::create(&fresh, config)?;
    let (mut copied, mut view) = (0_u64, view);
    let copying = old.for_each_record::<RecoverError>(|channel, stamps, data| {
        if let Some(topic) = channel.strip_prefix(CHANNEL_PREFIX) {
            enter(ledger, topic, data);
            if let Some(view) = &mut view {
                view.restore(topic, data);
            }
        }
        writer.copy(channel, stamps, data)?;
        copied += 1;
        progress();
        Ok(())
    });
    match copying {
        // After a power cut a chunk may be there in length but not in content.
        Err(RecoverError::Read(error @ ReadError::Damaged { .. })) => {
            tracing::warn!(%error, "the recording is gone on with from there");
        }
        other => other?,
    }
    writer.flush()?;
    writer.moved_to(path).map_err(|source| RecoverError::Replace { path: path.into(), source })?;
    tracing::info!(messages = copied, path = %path.display(), "went on with an earlier recording");
    Ok(writer)
}

/// Enters a recorded message in the ledger.
fn enter(ledger: &mut Ledger, topic: &str, data: &[u8]) {
    let mut header = Header::zeroed();
    let Some(front) = data.get(..size_of::<Header>()) else { return };
    bytemuck::bytes_of_mut(&mut header).copy_from_slice(front);
    if let Some(known) = topics::ALL.iter().find(|t| t.rules.name == topic) {
        ledger.admit(known.rules.name, &header);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{points, record_run, record_scan};

    fn small_chunks() -> RecorderConfig {
        RecorderConfig { chunk_bytes: 1 << 10, ..RecorderConfig::default() }
    }

    fn ledger() -> Ledger {
        Ledger::new(RecorderConfig::default().acknowledged())
    }

    #[test]
    fn a_recording_cut_off_anywhere_is_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let whole = folder.path().join("whole.mcap");
        record_run(&whole, &small_chunks(), 4, 60);
        let bytes = std::fs::read(&whole).unwrap();
        let path = folder.path().join("run.mcap");
        let mut most = 0;
        for end in (0..=bytes.len()).step_by(bytes.len() / 60) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            let mut ledger = ledger();
            let mut writer = recover(&path, &small_chunks(), &mut ledger, None, &mut || {}).unwrap();
            let finished = ledger.finished();
            assert!(finished >= most, "a longer file has more finished scans");
            most = finished;
            for scan in finished..5 {
                record_scan(&mut writer, scan, 60);
            }
            writer.finish().unwrap();
            let mut reader = RunReader::open(&path).unwrap();
            assert!(reader.is_complete());
            let mut seen = std::collections::BTreeSet::new();
            reader
                .for_each::<topics::Scan>(|meta, items| {
                    assert_eq!(items, points(meta.header.scan(), 60));
                    seen.insert(meta.header.scan());
                })
                .unwrap();
            assert_eq!(seen.into_iter().collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
            assert!(!path.with_extension("mcap.recovering").exists());
        }
        assert!(most >= 3, "the cuts reach into the last scans");
    }

    #[test]
    fn a_chunk_without_its_content_ends_what_is_recovered() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        record_run(&path, &RecorderConfig::default(), 3, 60);
        let mut bytes = std::fs::read(&path).unwrap();
        let point = points(2, 60)[7];
        let at = bytes.windows(16).position(|w| w == bytemuck::bytes_of(&point)).unwrap();
        for lost in [at..at + 64, at - 300..at + 600] {
            bytes[lost].fill(0);
            bytes.truncate(bytes.len() - 20);
            std::fs::write(&path, &bytes).unwrap();
            let mut ledger = ledger();
            let writer = recover(&path, &small_chunks(), &mut ledger, None, &mut || {}).unwrap();
            assert_eq!(ledger.finished(), 2);
            writer.finish().unwrap();
            assert_eq!(RunReader::open(&path).unwrap().scan_index(), [0, 1]);
        }
    }

    #[test]
    fn the_recording_of_another_program_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut bytes = Vec::new();
        let mut other = mcap::WriteOptions::new().compression(None).create(std::io::Cursor::new(&mut bytes)).unwrap();
        other.add_channel(0, "/status", "json", &std::collections::BTreeMap::new()).unwrap();
        other.finish().unwrap();
        drop(other);
        std::fs::write(&path, &bytes).unwrap();
        let result = recover(&path, &small_chunks(), &mut ledger(), None, &mut || {});
        assert!(matches!(result, Err(RecoverError::Read(ReadError::NotOurs { .. }))));
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn what_was_recovered_is_not_recorded_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        record_run(&path, &small_chunks(), 2, 10);
        let mut ledger = ledger();
        recover(&path, &small_chunks(), &mut ledger, None, &mut || {}).unwrap();
        assert_eq!(ledger.finished(), 2);
        assert!(!ledger.admit("scan", &crate::testing::header(1, 77)));
        assert!(ledger.admit("scan", &crate::testing::header(2, 78)));
    }
}
