//! The map's history on disk: what the aligner needs after a restart, each entry written once, behind the others.
//!
//! The checkpoint says how much of the journal belongs to it. What lies behind, written just before a death, is cut off.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mirador_core::slam6d::global::{JournalEntry, Journalled};
use mirador_service_common::CheckpointError;

/// Begins every entry; the last byte is the version.
const MARK: [u8; 4] = *b"MAJ\x01";
/// Mark, length of the entry, length of the keyframe, checksum of the entry.
const HEAD: usize = 4 + 4 + 4 + 8;

/// The journal of a run, open for what comes next.
pub(crate) struct Journal {
    file: File,
    path: PathBuf,
    bytes: u64,
}

impl Journal {
    /// An empty journal.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn create(path: &Path) -> Result<Self, CheckpointError> {
        let fail = |source| CheckpointError::Io { path: path.into(), source };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(fail)?;
        }
        let file = File::create(path).map_err(fail)?;
        Ok(Self { file, path: path.into(), bytes: 0 })
    }

    /// Goes on with a journal of which the first `bytes` belong to the checkpoint; its entries so far.
    ///
    /// # Errors
    /// [`CheckpointError`] when it is shorter, or damaged.
    pub fn open(path: &Path, bytes: u64) -> Result<(Self, Vec<Journalled>), CheckpointError> {
        let fail = |source| CheckpointError::Io { path: path.into(), source };
        let mut file = OpenOptions::new().read(true).write(true).open(path).map_err(fail)?;
        let mut content = Vec::new();
        (&mut file).take(bytes).read_to_end(&mut content).map_err(fail)?;
        let invalid = |reason: String| CheckpointError::Invalid { path: path.into(), reason };
        if content.len() as u64 != bytes {
            return Err(invalid(format!("it has {} of {bytes} bytes", content.len())));
        }
        let entries = entries(&content).map_err(invalid)?;
        file.set_len(bytes).map_err(fail)?;
        file.seek(SeekFrom::Start(bytes)).map_err(fail)?;
        Ok((Self { file, path: path.into(), bytes }, entries))
    }

    /// Length so far, for the checkpoint [bytes].
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Writes entries behind the others.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn append(&mut self, entries: &[Journalled]) -> Result<(), CheckpointError> {
        let fail = |source| CheckpointError::Io { path: self.path.clone(), source };
        let mut content = Vec::new();
        for Journalled { entry, keyframe } in entries {
            let entry = serde_json::to_vec(entry).map_err(|e| fail(io::Error::other(e)))?;
            let keyframe = keyframe.as_deref().unwrap_or_default();
            content.extend_from_slice(&MARK);
            content.extend_from_slice(&(entry.len() as u32).to_le_bytes());
            content.extend_from_slice(&(keyframe.len() as u32).to_le_bytes());
            content.extend_from_slice(&checksum(&entry).to_le_bytes());
            content.extend_from_slice(&entry);
            content.extend_from_slice(keyframe);
        }
        self.file.write_all(&content).map_err(fail)?;
        self.bytes += content.len() as u64;
        Ok(())
    }
}

/// Takes the entries apart.
fn entries(mut content: &[u8]) -> Result<Vec<Journalled>, String> {
    let mut entries = Vec::new();
    while !content.is_empty() {
        let number = entries.len();
        let torn = || format!("entry {number} is torn");
        let (head, rest) = content.split_at_checked(HEAD).ok_or_else(torn)?;
        let word =
            |at: usize| -> usize { u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize };
        if head[..4] != MARK {
            return Err(format!("entry {number} does not begin as one of this version"));
        }
        let (entry, rest) = rest.split_at_checked(word(4)).ok_or_else(torn)?;
        let (keyframe, rest) = rest.split_at_checked(word(8)).ok_or_else(torn)?;
        if checksum(entry).to_le_bytes() != head[12..] {
            return Err(format!("entry {number} is damaged: its checksum is another"));
        }
        let entry: JournalEntry = serde_json::from_slice(entry).map_err(|e| format!("entry {number}: {e}"))?;
        entries.push(Journalled { entry, keyframe: (!keyframe.is_empty()).then(|| keyframe.to_vec()) });
        content = rest;
    }
    Ok(entries)
}

/// FNV-1a.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use mirador_core::geometry::Pose;
    use mirador_core::slam6d::global::CorrectionEntry;

    use super::*;

    fn entry(scan_id: u64) -> Journalled {
        let pose = Pose::translation(0.1 * scan_id as f64, 1.0 / 3.0, -0.0);
        let entry = CorrectionEntry { scan_id, pairs: Vec::new(), switched: vec![(3, true)], poses: vec![(1, pose)] };
        Journalled {
            entry: JournalEntry::Correction(entry),
            keyframe: (!scan_id.is_multiple_of(2)).then(|| vec![7; 100]),
        }
    }

    #[test]
    fn entries_come_back_as_far_as_the_checkpoint_says_and_others_follow_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state").join("x.journal");
        let mut journal = Journal::create(&path).unwrap();
        journal.append(&[entry(0), entry(1)]).unwrap();
        let known = journal.bytes();
        journal.append(&[entry(2)]).unwrap();
        drop(journal);
        let (mut journal, entries) = Journal::open(&path, known).unwrap();
        assert_eq!(entries, [entry(0), entry(1)]);
        journal.append(&[entry(3)]).unwrap();
        let all = journal.bytes();
        drop(journal);
        assert_eq!(Journal::open(&path, all).unwrap().1, [entry(0), entry(1), entry(3)]);
    }

    #[test]
    fn a_journal_that_is_too_short_or_damaged_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.journal");
        let mut journal = Journal::create(&path).unwrap();
        journal.append(&[entry(1)]).unwrap();
        let bytes = journal.bytes();
        assert!(Journal::open(&path, bytes + 1).is_err());
        assert!(Journal::open(&path, bytes - 1).is_err());
        let mut content = std::fs::read(&path).unwrap();
        content[HEAD + 5] ^= 1;
        std::fs::write(&path, content).unwrap();
        let error = Journal::open(&path, bytes).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("entry 0 is damaged"), "{error}");
    }
}
