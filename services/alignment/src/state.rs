//! What is written down so that a restarted service goes on where it stopped.
//!
//! Two files: the journal, to which is added what changed the map, and the checkpoint, replaced in one step, which holds
//! what does not grow: the aligner's own state, the last messages, and how much of the journal counts. In continuous mode
//! there is a third, now and then: the odometry's local map, bounded as that is. Two files of it take turns, so that the
//! one that the checkpoint names is always whole.

use std::path::{Path, PathBuf};

use mirador_core::slam6d::AlignerState;
use mirador_core::slam6d::continuous::ContinuousState;
use mirador_core::slam6d::global::Journalled;
use mirador_ipc_schema::messages::Header;
use mirador_ipc_schema::service::ServiceSetup;
use mirador_service_common::{CheckpointError, checkpoint};
use serde::{Deserialize, Serialize};

use crate::journal::Journal;

/// A scan whose correction is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Waiting {
    /// The scan.
    pub id: u64,
    /// The time of its sensor [ns] ...
    pub stamp_ns: i64,
    /// ... and the clock of that.
    pub clock_id: u32,
}

impl Waiting {
    /// The scan of a header.
    pub fn new(header: &Header) -> Self {
        Self { id: header.id, stamp_ns: header.stamp_ns, clock_id: header.clock_id }
    }

    /// The header of a message about it.
    pub fn header(&self, began_ns: u64) -> Header {
        let about = Header { id: self.id, stamp_ns: self.stamp_ns, clock_id: self.clock_id, ..Header::default() };
        Header::about(&about, began_ns)
    }
}

/// The last messages. Readers that were not there when they were sent get them from the topic's history, which dies
/// with the process.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct LastMessages {
    /// See [`crate::messages::to_bytes`].
    pub alignment: Vec<u8>,
    pub loop_closing: Vec<u8>,
    /// The pose corrections that go with it.
    pub corrections: Vec<u8>,
}

/// The state of the way of aligning that is used; the other's is as at the start.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct AlignerStates {
    pub scan: AlignerState,
    pub continuous: ContinuousState,
}

/// What does not grow.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Checkpoint {
    aligned_scans: u32,
    finished_scans: u32,
    waiting: Vec<Waiting>,
    aligner: AlignerStates,
    journal_bytes: u64,
    /// Number of the snapshot of the odometry, from 1; 0 while there is none.
    snapshot: u64,
    /// Lengths of the last messages, which stand behind this.
    messages: [usize; 3],
}

/// What an earlier incarnation has left.
#[derive(Default)]
pub(crate) struct Saved {
    pub aligned_scans: u32,
    pub finished_scans: u32,
    pub waiting: Vec<Waiting>,
    pub aligner: AlignerStates,
    pub snapshot: Option<Vec<u8>>,
    pub journal: Vec<Journalled>,
    pub last: LastMessages,
}

/// Counters and queues to be written down.
pub(crate) struct Progress<'a> {
    pub aligned_scans: u32,
    pub finished_scans: u32,
    pub waiting: Vec<Waiting>,
    pub aligner: AlignerStates,
    /// The odometry as it is now, if it is to be written down.
    pub snapshot: Option<Vec<u8>>,
    pub last: &'a LastMessages,
}

/// The files.
pub(crate) struct Store {
    checkpoint: PathBuf,
    journal: Journal,
    /// Number of the last snapshot.
    snapshot: u64,
}

impl Store {
    /// Opens the files; what an earlier incarnation of this run has left is read.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn open(setup: &ServiceSetup) -> Result<(Self, Saved), CheckpointError> {
        let path = setup.state_file();
        let journal_path = path.with_extension("journal");
        let content = if setup.incarnation == 0 { None } else { checkpoint::load(&path)? };
        let Some(content) = content else {
            let journal = Journal::create(&journal_path)?;
            return Ok((Self { checkpoint: path, journal, snapshot: 0 }, Saved::default()));
        };
        let invalid = |reason: String| CheckpointError::Invalid { path: path.clone(), reason };
        let (length, rest) = content.split_first_chunk::<4>().ok_or_else(|| invalid("it is empty".into()))?;
        let split = rest.split_at_checked(u32::from_le_bytes(*length) as usize);
        let (head, tail) = split.ok_or_else(|| invalid("it is torn".into()))?;
        let saved: Checkpoint = serde_json::from_slice(head).map_err(|e| invalid(e.to_string()))?;
        let last = messages(tail, saved.messages).ok_or_else(|| invalid("its messages are torn".into()))?;
        let (journal, entries) = Journal::open(&journal_path, saved.journal_bytes)?;
        let Checkpoint { aligned_scans, finished_scans, waiting, aligner, snapshot: number, .. } = saved;
        let snapshot = match number {
            0 => None,
            number => Some(load_snapshot(&snapshot_path(&path, number))?),
        };
        let saved = Saved { aligned_scans, finished_scans, waiting, aligner, snapshot, journal: entries, last };
        Ok((Self { checkpoint: path, journal, snapshot: number }, saved))
    }

    /// Writes down what happened since the last time, and where the service is now.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn save(&mut self, entries: &[Journalled], progress: Progress<'_>) -> Result<(), CheckpointError> {
        if let Some(snapshot) = &progress.snapshot {
            checkpoint::save(&snapshot_path(&self.checkpoint, self.snapshot + 1), snapshot)?;
            self.snapshot += 1;
        }
        self.journal.append(entries)?;
        let last = [&progress.last.alignment, &progress.last.loop_closing, &progress.last.corrections];
        let head = Checkpoint {
            aligned_scans: progress.aligned_scans,
            finished_scans: progress.finished_scans,
            waiting: progress.waiting,
            aligner: progress.aligner,
            snapshot: self.snapshot,
            journal_bytes: self.journal.bytes(),
            messages: last.map(Vec::len),
        };
        let head = serde_json::to_vec(&head)
            .map_err(|e| CheckpointError::Invalid { path: self.checkpoint.clone(), reason: e.to_string() })?;
        let mut content = (head.len() as u32).to_le_bytes().to_vec();
        content.extend_from_slice(&head);
        last.iter().for_each(|message| content.extend_from_slice(message));
        checkpoint::save(&self.checkpoint, &content)
    }
}

/// The two files of the odometry take turns.
fn snapshot_path(checkpoint: &Path, number: u64) -> PathBuf {
    checkpoint.with_extension(format!("odometry{}", number % 2))
}

fn load_snapshot(path: &Path) -> Result<Vec<u8>, CheckpointError> {
    let missing = || CheckpointError::Invalid { path: path.into(), reason: "it is missing".into() };
    checkpoint::load(path)?.ok_or_else(missing)
}

fn messages(tail: &[u8], [alignment, loop_closing, corrections]: [usize; 3]) -> Option<LastMessages> {
    let (first, rest) = tail.split_at_checked(alignment)?;
    let (second, third) = rest.split_at_checked(loop_closing)?;
    (third.len() == corrections).then(|| LastMessages {
        alignment: first.to_vec(),
        loop_closing: second.to_vec(),
        corrections: third.to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use mirador_ipc_schema::{Domain, Sizes, StopSignal, Wake};

    use super::*;

    fn setup(folder: &Path, incarnation: u32) -> ServiceSetup {
        ServiceSetup {
            name: "alignment".into(),
            domain: Domain::new("never-joined").unwrap(),
            incarnation,
            sizes: Sizes { scan_points: 1 },
            wake: Wake::Event,
            run_dir: folder.into(),
            run: 0,
            threads: 1,
            stop: StopSignal::default(),
        }
    }

    fn save(store: &mut Store, aligned_scans: u32, snapshot: Option<&[u8]>) {
        let last = LastMessages::default();
        let snapshot = snapshot.map(<[u8]>::to_vec);
        let aligner = AlignerStates::default();
        let progress =
            Progress { aligned_scans, finished_scans: 0, waiting: Vec::new(), aligner, snapshot, last: &last };
        store.save(&[], progress).unwrap();
    }

    fn reopen(folder: &Path) -> (Store, u32, Option<Vec<u8>>) {
        let (store, saved) = Store::open(&setup(folder, 1)).unwrap();
        (store, saved.aligned_scans, saved.snapshot)
    }

    #[test]
    fn the_snapshot_that_the_checkpoint_names_is_there_also_when_the_next_was_written_just_before_a_death() {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(&setup(folder.path(), 0)).unwrap();
        save(&mut store, 1, None);
        assert_eq!(reopen(folder.path()).2, None);
        save(&mut store, 2, Some(b"two"));
        save(&mut store, 3, None);
        let (mut store, scans, snapshot) = reopen(folder.path());
        assert_eq!((scans, snapshot.as_deref()), (3, Some(&b"two"[..])));
        save(&mut store, 4, Some(b"four"));
        // The next one, without the checkpoint that would name it.
        checkpoint::save(&snapshot_path(&store.checkpoint, store.snapshot + 1), b"five").unwrap();
        let (mut store, scans, snapshot) = reopen(folder.path());
        assert_eq!((scans, snapshot.as_deref()), (4, Some(&b"four"[..])));
        save(&mut store, 5, Some(b"five again"));
        assert_eq!(reopen(folder.path()).2.as_deref(), Some(&b"five again"[..]));
        std::fs::remove_file(snapshot_path(&store.checkpoint, store.snapshot)).unwrap();
        let error = Store::open(&setup(folder.path(), 1)).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("odometry") && error.contains("missing"), "{error}");
    }
}
