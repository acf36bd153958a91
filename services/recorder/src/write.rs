//! Writing `run.mcap`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use foxglove::Encode;
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};
use mirador_ipc_schema::messages::Meta;
use mirador_ipc_schema::topics::{self, Topic};
use mirador_viewers::{CHANNELS, Sink, Stamps};

use crate::{CHANNEL_PREFIX, Compression, MESSAGE_ENCODING, RecorderConfig, SCHEMA_ENCODING};

/// Why the recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file cannot be made.
    #[error("cannot create the recording '{path}': {source}")]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The disk is full.
    #[error(
        "cannot write the recording '{path}': the disk is full. Free some space, or choose another folder with --out"
    )]
    DiskFull {
        /// The file.
        path: PathBuf,
    },
    /// Writing failed for another reason.
    #[error("cannot write the recording '{path}': {reason}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system or the MCAP library said.
        reason: String,
    },
}

/// What a finished recording holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunStatistics {
    /// Messages, those of the view included.
    pub messages: u64,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Writes a run: raw records of every topic, and the view for viewers.
pub struct RunWriter {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<File>>,
    /// Channels of the raw records, under the topic's name.
    raw: BTreeMap<&'static str, u16>,
    /// Channels of the view.
    view: BTreeMap<&'static str, u16>,
    /// A message as one piece, as the MCAP library wants it; reused.
    scratch: Vec<u8>,
    messages: u64,
}

impl RunWriter {
    /// Makes the file and declares every channel in it, so that a recording can be checked from its first chunk on.
    ///
    /// # Errors
    /// See [`WriteError`].
    pub fn create(path: &Path, config: &RecorderConfig) -> Result<Self, WriteError> {
        let file = File::create(path).map_err(|source| WriteError::Create { path: path.into(), source })?;
        let compression = match config.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
        };
        let writer = WriteOptions::new()
            .profile("mirador")
            .library(concat!("mirador ", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            .chunk_size(Some(config.chunk_bytes))
            .create(BufWriter::with_capacity(1 << 18, file))
            .map_err(|e| failure(path, &e))?;
        let mut run = Self {
            path: path.into(),
            writer,
            raw: BTreeMap::new(),
            view: BTreeMap::new(),
            scratch: Vec::new(),
            messages: 0,
        };
        run.declare(config.foxglove).map_err(|e| failure(path, &e))?;
        run.flush()?;
        Ok(run)
    }

    fn declare(&mut self, view: bool) -> Result<(), McapError> {
        let no_metadata = BTreeMap::new();
        for topic in topics::ALL {
            let name = format!("{CHANNEL_PREFIX}{}", topic.rules.name);
            let schema = self.writer.add_schema(&name, SCHEMA_ENCODING, (topic.describe)().as_bytes())?;
            let channel = self.writer.add_channel(schema, &name, MESSAGE_ENCODING, &no_metadata)?;
            self.raw.insert(topic.rules.name, channel);
        }
        if view {
            for channel in CHANNELS {
                let (schema, encoding) = (channel.declaration)();
                let id = self.writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
                let id = self.writer.add_channel(id, channel.topic, &encoding, &no_metadata)?;
                self.view.insert(channel.topic, id);
            }
        }
        Ok(())
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves the file to `path`; writing goes on.
    pub(crate) fn moved_to(&mut self, path: &Path) -> io::Result<()> {
        std::fs::rename(&self.path, path)?;
        self.path = path.into();
        Ok(())
    }

    /// Records a message: the bytes of `meta`, then the bytes of `items`, as they are.
    ///
    /// # Errors
    /// See [`WriteError`].
    pub fn record<T: Topic>(&mut self, meta: &T::Meta, items: &[T::Item]) -> Result<(), WriteError> {
        let header = meta.header();
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        scratch.extend_from_slice(bytemuck::bytes_of(meta));
        scratch.extend_from_slice(bytemuck::cast_slice(items));
        // MCAP counts in 32 bits; the header inside the record keeps all 64.
        let stamps = Stamps {
            sequence: header.sequence as u32,
            log_time: header.sent_ns,
            publish_time: u64::try_from(header.stamp_ns).unwrap_or(0),
        };
        let written = self.write(self.raw.get(T::RULES.name).copied(), stamps, &scratch);
        self.scratch = scratch;
        written
    }

    /// Copies a message of another recording; channels that this build or this configuration does not have are left
    /// out.
    pub(crate) fn copy(&mut self, channel: &str, stamps: Stamps, data: &[u8]) -> Result<(), WriteError> {
        let id = match channel.strip_prefix(CHANNEL_PREFIX) {
            Some(topic) => self.raw.get(topic),
            None => self.view.get(channel),
        };
        self.write(id.copied(), stamps, data)
    }

    fn write(&mut self, channel: Option<u16>, stamps: Stamps, data: &[u8]) -> Result<(), WriteError> {
        let Some(channel_id) = channel else { return Ok(()) };
        let Stamps { sequence, log_time, publish_time } = stamps;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        self.writer.write_to_known_channel(&header, data).map_err(|e| failure(&self.path, &e))?;
        self.messages += 1;
        Ok(())
    }

    /// Closes the chunk: what was written so far survives the death of this process.
    ///
    /// # Errors
    /// See [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.writer.flush().map_err(|e| failure(&self.path, &e))
    }

    /// Writes the index and ends the file.
    ///
    /// # Errors
    /// See [`WriteError`].
    pub fn finish(mut self) -> Result<RunStatistics, WriteError> {
        self.writer.finish().map_err(|e| failure(&self.path, &e))?;
        let mut file = self.writer.into_inner();
        let system = |e: io::Error| failure(&self.path, &McapError::Io(e));
        file.flush().map_err(system)?;
        file.get_ref().sync_all().map_err(system)?;
        let bytes = file.get_ref().metadata().map_err(system)?.len();
        Ok(RunStatistics { messages: self.messages, bytes })
    }
}

impl Sink for RunWriter {
    type Error = WriteError;

    fn wants(&self, channel: &'static str) -> bool {
        self.view.contains_key(channel)
    }

    fn draw<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M) -> Result<(), WriteError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        let encoded = message
            .encode(&mut scratch)
            .map_err(|e| WriteError::Write { path: self.path.clone(), reason: format!("view {channel}: {e}") });
        let written = encoded.and_then(|()| self.write(self.view.get(channel).copied(), stamps, &scratch));
        self.scratch = scratch;
        written
    }
}

fn failure(path: &Path, error: &McapError) -> WriteError {
    match error {
        McapError::Io(e) if e.kind() == io::ErrorKind::StorageFull => WriteError::DiskFull { path: path.into() },
        McapError::Io(e) => WriteError::Write { path: path.into(), reason: e.to_string() },
        e => WriteError::Write { path: path.into(), reason: e.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mirador_ipc_schema::messages::{Point, ScanMeta};

    #[test]
    fn a_full_disk_is_an_error_that_names_the_file() {
        let path = Path::new("/dev/full");
        let Err(error) = RunWriter::create(path, &RecorderConfig::default()) else {
            panic!("a full disk took the file")
        };
        assert!(matches!(error, WriteError::DiskFull { .. }), "{error}");
        assert!(error.to_string().contains("/dev/full"));
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing").join("run.mcap");
        let Err(error) = RunWriter::create(&path, &RecorderConfig::default()) else { panic!("no error") };
        assert!(error.to_string().contains("missing/run.mcap"), "{error}");
    }

    #[test]
    fn the_record_of_a_message_is_its_meta_then_its_items() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut meta = ScanMeta { rows: 7, ..ScanMeta::default() };
        meta.header.sent_ns = 99;
        meta.header.stamp_ns = 12;
        meta.header.sequence = 5;
        let items = [Point { x: 1.5, y: 2.5, z: 3.5, intensity: 9, time: 8 }; 3];
        let mut writer = RunWriter::create(&path, &RecorderConfig::default()).unwrap();
        writer.record::<topics::Scan>(&meta, &items).unwrap();
        let statistics = writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!((statistics.messages, statistics.bytes), (1, bytes.len() as u64));
        let message = mcap::MessageStream::new(&bytes).unwrap().next().unwrap().unwrap();
        assert_eq!(message.channel.topic, "mirador/scan");
        assert_eq!(message.channel.message_encoding, "mirador");
        let schema = message.channel.schema.clone().unwrap();
        assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("mirador/scan", "mirador-json"));
        assert_eq!(schema.data.as_ref(), topics::describe::<topics::Scan>().as_bytes());
        assert_eq!((message.log_time, message.publish_time, message.sequence), (99, 12, 5));
        let expected = [bytemuck::bytes_of(&meta), bytemuck::cast_slice(&items)].concat();
        assert_eq!(message.data.as_ref(), expected);
    }
}
