//! Reading `run.mcap`.
//!
//! Opening walks over the heads of all records, never over points, and keeps where every message lies; reading takes
//! one chunk at a time, checks its CRC and copies the message into aligned buffers. So a recording of any length is
//! read in the memory of its largest chunk, and one that was cut off is read up to its last complete chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mirador_ipc_schema::ScanId;
use mirador_ipc_schema::messages::{Point, ScanMeta};
use mirador_ipc_schema::topics::{self, Topic, TopicInfo};

use crate::records::{
    CHUNK_HEAD, Channel, Chunk, MESSAGE_HEAD, Packing, Parser, RECORD_HEAD, SMALL_RECORD, Schema, op,
};
use crate::write::Stamps;
use crate::{CHANNEL_PREFIX, MESSAGE_ENCODING};

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read the recording '{path}': {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file does not begin like an MCAP file.
    #[error("'{path}' is not an MCAP file")]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The file ends before its first chunk is complete, so nothing was recorded.
    #[error("the recording '{path}' holds nothing: it ends before its first chunk is complete")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// An MCAP file of another program.
    #[error(
        "'{path}' is an MCAP file (profile '{profile}') but not a recording of mirador: it has no channel 'mirador/...'. Its channels: {channels}"
    )]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// Profile in its header; `ros2` for a ROS 2 bag.
        profile: String,
        /// Its channels.
        channels: String,
    },
    /// A message was recorded by a build with another layout.
    #[error(
        "'{path}' was recorded with another layout of topic '{topic}'; read it with the version of mirador that wrote it.\n  recorded: {recorded}\n  this build: {current}"
    )]
    Layout {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Description in the file.
        recorded: String,
        /// Description of this build.
        current: String,
    },
    /// Bytes of the file have changed since they were written.
    #[error("the recording '{path}' is damaged at byte {offset}: {what}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        offset: u64,
        /// What does not fit.
        what: &'static str,
    },
    /// The recording has no such scan.
    #[error("'{path}' has no scan {scan}; it has {present}")]
    NoScan {
        /// The file.
        path: PathBuf,
        /// The scan asked for.
        scan: u32,
        /// Which scans it has, in words.
        present: String,
    },
}

impl ReadError {
    /// Whether there is no recording yet, or none with anything in it.
    #[must_use]
    pub fn is_nothing_recorded(&self) -> bool {
        match self {
            Self::Empty { .. } => true,
            Self::Io { source, .. } => source.kind() == io::ErrorKind::NotFound,
            _ => false,
        }
    }
}

/// Where one message lies.
#[derive(Debug, Clone, Copy)]
struct Entry {
    channel: u16,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    /// The id of the message's header, 0 when it is too short for one.
    id: u64,
    chunk: usize,
    /// Offset of the data among the records of the chunk.
    offset: u64,
    /// Bytes of the data.
    length: u64,
}

/// A channel of the file.
struct Known {
    name: String,
    /// The topic of a raw record.
    topic: Option<&'static TopicInfo>,
}

/// An open recording.
pub struct RunReader {
    path: PathBuf,
    file: BufReader<File>,
    bytes: u64,
    complete: bool,
    profile: String,
    chunks: Vec<Chunk>,
    channels: BTreeMap<u16, Known>,
    entries: Vec<Entry>,
    /// The chunk whose records are in `records`.
    loaded: Option<usize>,
    records: Vec<u8>,
    packed: Vec<u8>,
}

impl RunReader {
    /// Opens a recording, checks that it is one of ours with the layouts of this build, and finds all its messages.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.into(), source };
        let file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut reader = Self {
            path: path.into(),
            file: BufReader::with_capacity(1 << 16, file),
            bytes,
            complete: false,
            profile: String::new(),
            chunks: Vec::new(),
            channels: BTreeMap::new(),
            entries: Vec::new(),
            loaded: None,
            records: Vec::new(),
            packed: Vec::new(),
        };
        let mut declared = Declared::default();
        reader.find_chunks(&mut declared)?;
        if reader.chunks.is_empty() {
            return Err(ReadError::Empty { path: path.into() });
        }
        for chunk in 0..reader.chunks.len() {
            reader.find_messages(chunk, &mut declared)?;
        }
        reader.check(declared)?;
        Ok(reader)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the recording was ended in order; one that was cut off is readable up to its last complete chunk.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Number of messages of a topic.
    #[must_use]
    pub fn count<T: Topic>(&self) -> usize {
        self.entries.iter().filter(|e| self.is_of::<T>(e)).count()
    }

    /// The scans of the run, in the order in which they were recorded.
    #[must_use]
    pub fn scan_index(&self) -> Vec<u32> {
        let scans = self.entries.iter().filter(|e| self.is_of::<topics::Scan>(e));
        scans.map(|e| ScanId::unpack(e.id).scan).collect()
    }

    /// Calls `visit` with every message of a topic, in the order in which they were recorded.
    ///
    /// # Errors
    /// [`ReadError::Damaged`] and [`ReadError::Io`].
    pub fn for_each<T: Topic>(&mut self, mut visit: impl FnMut(&T::Meta, &[T::Item])) -> Result<(), ReadError> {
        let mut items = Vec::new();
        for k in 0..self.entries.len() {
            let entry = self.entries[k];
            if self.is_of::<T>(&entry) {
                let meta = self.read::<T>(&entry, &mut items)?;
                visit(&meta, &items);
            }
        }
        Ok(())
    }

    /// Calls `visit` with the meta part of every message of a topic and its number of items, and reads nothing else
    /// where the chunks are not compressed. The CRC is not checked.
    ///
    /// # Errors
    /// [`ReadError::Damaged`] and [`ReadError::Io`].
    pub fn for_each_meta<T: Topic>(&mut self, mut visit: impl FnMut(&T::Meta, usize)) -> Result<(), ReadError> {
        for k in 0..self.entries.len() {
            let entry = self.entries[k];
            if self.is_of::<T>(&entry) {
                let items = self.item_count::<T>(&entry)?;
                let mut meta = T::Meta::default();
                self.peek(entry.chunk, entry.offset, bytemuck::bytes_of_mut(&mut meta))?;
                visit(&meta, items);
            }
        }
        Ok(())
    }

    /// Reads the last message of a topic about a scan into `items`; `None` when there is none.
    ///
    /// # Errors
    /// [`ReadError::Damaged`] and [`ReadError::Io`].
    pub fn read_about<T: Topic>(&mut self, scan: u32, items: &mut Vec<T::Item>) -> Result<Option<T::Meta>, ReadError> {
        let is_it = |e: &&Entry| ScanId::unpack(e.id).scan == scan && self.is_of::<T>(e);
        let Some(entry) = self.entries.iter().rev().find(is_it).copied() else { return Ok(None) };
        self.read::<T>(&entry, items).map(Some)
    }

    /// Calls `visit` with a scan.
    ///
    /// # Errors
    /// [`ReadError::NoScan`], [`ReadError::Damaged`] and [`ReadError::Io`].
    pub fn read_scan(&mut self, scan: u32, visit: &mut dyn FnMut(&ScanMeta, &[Point])) -> Result<(), ReadError> {
        let mut points = Vec::new();
        match self.read_about::<topics::Scan>(scan, &mut points)? {
            Some(meta) => visit(&meta, &points),
            None => return Err(self.no_scan(scan)),
        }
        Ok(())
    }

    /// The error for a scan that the recording does not have.
    #[must_use]
    pub fn no_scan(&self, scan: u32) -> ReadError {
        let index = self.scan_index();
        let present = match (index.iter().min(), index.iter().max()) {
            (Some(first), Some(last)) => format!("{} scans from {first} to {last}", index.len()),
            _ => "no scans at all".to_owned(),
        };
        ReadError::NoScan { path: self.path.clone(), scan, present }
    }

    /// Calls `visit` with the channel, the stamps and the bytes of every message, those of the view included.
    pub(crate) fn for_each_record<E: From<ReadError>>(
        &mut self,
        mut visit: impl FnMut(&str, Stamps, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        for k in 0..self.entries.len() {
            let entry = self.entries[k];
            self.load(entry.chunk)?;
            let data = self.data(&entry)?;
            let Some(channel) = self.channels.get(&entry.channel) else { continue };
            let Entry { sequence, log_time, publish_time, .. } = entry;
            visit(&channel.name, Stamps { sequence, log_time, publish_time }, data)?;
        }
        Ok(())
    }

    fn is_of<T: Topic>(&self, entry: &Entry) -> bool {
        let topic = self.channels.get(&entry.channel).and_then(|c| c.topic);
        topic.is_some_and(|t| t.rules.name == T::RULES.name)
    }

    fn read<T: Topic>(&mut self, entry: &Entry, items: &mut Vec<T::Item>) -> Result<T::Meta, ReadError> {
        let count = self.item_count::<T>(entry)?;
        self.load(entry.chunk)?;
        let data = self.data(entry)?;
        let (front, rest) = data.split_at(size_of::<T::Meta>());
        let mut meta = T::Meta::default();
        bytemuck::bytes_of_mut(&mut meta).copy_from_slice(front);
        items.resize(count, T::Item::default());
        bytemuck::cast_slice_mut(items).copy_from_slice(rest);
        Ok(meta)
    }

    /// Number of items of a message: what is behind the meta part must be whole items.
    fn item_count<T: Topic>(&self, entry: &Entry) -> Result<usize, ReadError> {
        let rest = entry.length.checked_sub(size_of::<T::Meta>() as u64);
        match rest {
            Some(rest) if rest % size_of::<T::Item>() as u64 == 0 => Ok((rest / size_of::<T::Item>() as u64) as usize),
            _ => Err(self.damaged(self.chunks[entry.chunk].offset + entry.offset, "a message has a wrong length")),
        }
    }

    /// The data of a message of the loaded chunk.
    fn data(&self, entry: &Entry) -> Result<&[u8], ReadError> {
        let range = entry.offset as usize..(entry.offset + entry.length) as usize;
        self.records.get(range).ok_or_else(|| self.damaged(self.chunks[entry.chunk].offset, "a chunk is too short"))
    }

    fn damaged(&self, offset: u64, what: &'static str) -> ReadError {
        ReadError::Damaged { path: self.path.clone(), offset, what }
    }

    fn read_at(&mut self, offset: u64, into: &mut [u8]) -> Result<(), ReadError> {
        let io = |source| ReadError::Io { path: self.path.clone(), source };
        let here = self.file.stream_position().map_err(io)?;
        // A relative seek keeps the buffer, an absolute one throws it away.
        match i64::try_from(i128::from(offset) - i128::from(here)) {
            Ok(step) => self.file.seek_relative(step).map_err(io)?,
            Err(_) => self.file.seek(SeekFrom::Start(offset)).map(drop).map_err(io)?,
        }
        self.file.read_exact(into).map_err(io)
    }

    /// Reads from the records of a chunk; where they are not packed, straight from the file.
    fn peek(&mut self, chunk: usize, offset: u64, into: &mut [u8]) -> Result<(), ReadError> {
        let place = self.chunks[chunk];
        if offset.checked_add(into.len() as u64).is_none_or(|end| end > place.size) {
            return Err(self.damaged(place.offset, "a record is longer than its chunk"));
        }
        if place.packing == Packing::Plain {
            return self.read_at(place.offset + offset, into);
        }
        self.load(chunk)?;
        let from = offset as usize;
        match self.records.get(from..from + into.len()) {
            Some(bytes) => into.copy_from_slice(bytes),
            None => return Err(self.damaged(place.offset, "a chunk is too short")),
        }
        Ok(())
    }

    /// Brings the records of a chunk into memory and checks them.
    fn load(&mut self, chunk: usize) -> Result<(), ReadError> {
        if self.loaded == Some(chunk) {
            return Ok(());
        }
        self.loaded = None;
        let place = self.chunks[chunk];
        let mut packed = std::mem::take(&mut self.packed);
        packed.resize(place.packed as usize, 0);
        self.read_at(place.offset, &mut packed)?;
        match place.packing {
            Packing::Plain => self.packed = std::mem::replace(&mut self.records, packed),
            Packing::Lz4 => {
                self.records.clear();
                let unpacked = lz4::Decoder::new(packed.as_slice())
                    .and_then(|d| d.take(place.size).read_to_end(&mut self.records));
                self.packed = packed;
                if unpacked.is_err() || self.records.len() as u64 != place.size {
                    return Err(self.damaged(place.offset, "a compressed chunk cannot be unpacked"));
                }
            }
        }
        if place.crc != 0 && crc32fast::hash(&self.records) != place.crc {
            return Err(self.damaged(place.offset, "the checksum of a chunk is wrong"));
        }
        self.loaded = Some(chunk);
        Ok(())
    }

    /// Walks over the records of the file and keeps its chunks. Stops where a record is cut off.
    fn find_chunks(&mut self, declared: &mut Declared) -> Result<(), ReadError> {
        let magic = mcap::MAGIC.len() as u64;
        let mut start = [0; 8];
        if self.bytes < magic || self.read_at(0, &mut start).is_err() || start != *mcap::MAGIC {
            return Err(ReadError::NotMcap { path: self.path.clone() });
        }
        let mut at = magic;
        while at + RECORD_HEAD <= self.bytes {
            let mut head = [0; RECORD_HEAD as usize];
            self.read_at(at, &mut head)?;
            let (opcode, length) = record_head(&head);
            let content = at + RECORD_HEAD;
            let Some(end) = content.checked_add(length).filter(|end| *end <= self.bytes) else { break };
            match opcode {
                op::CHUNK => match self.chunk_at(content, length)? {
                    Some(chunk) => self.chunks.push(chunk),
                    None => break,
                },
                op::HEADER if length <= SMALL_RECORD => {
                    let content = self.content(content, length)?;
                    self.profile = Parser(&content).string().unwrap_or_default();
                }
                op::SCHEMA | op::CHANNEL if length <= SMALL_RECORD => {
                    let content = self.content(content, length)?;
                    declared.add(opcode, &content);
                }
                op::FOOTER => {
                    self.complete = end + magic == self.bytes;
                    break;
                }
                0 => break,
                _ => {}
            }
            at = end;
        }
        Ok(())
    }

    fn content(&mut self, offset: u64, length: u64) -> Result<Vec<u8>, ReadError> {
        let mut content = vec![0; length as usize];
        self.read_at(offset, &mut content)?;
        Ok(content)
    }

    fn chunk_at(&mut self, content: u64, length: u64) -> Result<Option<Chunk>, ReadError> {
        let head = self.content(content, length.min(CHUNK_HEAD as u64))?;
        Ok(Chunk::parse(&head, content, length))
    }

    /// Walks over the records of a chunk and keeps its messages and declarations.
    fn find_messages(&mut self, chunk: usize, declared: &mut Declared) -> Result<(), ReadError> {
        let size = self.chunks[chunk].size;
        let mut at = 0;
        while at < size {
            let mut head = [0; RECORD_HEAD as usize];
            self.peek(chunk, at, &mut head)?;
            let (opcode, length) = record_head(&head);
            let content = at + RECORD_HEAD;
            let Some(end) = content.checked_add(length).filter(|end| *end <= size) else {
                return Err(self.damaged(self.chunks[chunk].offset + at, "a record is longer than its chunk"));
            };
            match opcode {
                op::MESSAGE if length >= MESSAGE_HEAD => self.find_message(chunk, content, length)?,
                op::SCHEMA | op::CHANNEL if length <= SMALL_RECORD => {
                    let mut bytes = vec![0; length as usize];
                    self.peek(chunk, content, &mut bytes)?;
                    declared.add(opcode, &bytes);
                }
                _ => {}
            }
            at = end;
        }
        Ok(())
    }

    fn find_message(&mut self, chunk: usize, content: u64, length: u64) -> Result<(), ReadError> {
        let mut head = [0; MESSAGE_HEAD as usize + 8];
        // Messages of other programs may be shorter than our header's id.
        let n = head.len().min(length as usize);
        self.peek(chunk, content, &mut head[..n])?;
        let mut p = Parser(&head);
        let parsed = (|| Some((p.u16()?, p.u32()?, p.u64()?, p.u64()?, p.u64()?)))();
        if let Some((channel, sequence, log_time, publish_time, id)) = parsed {
            let (offset, length) = (content + MESSAGE_HEAD, length - MESSAGE_HEAD);
            self.entries.push(Entry { channel, sequence, log_time, publish_time, id, chunk, offset, length });
        }
        Ok(())
    }

    /// Compares the declared channels with the topics of this build.
    fn check(&mut self, declared: Declared) -> Result<(), ReadError> {
        let ours = |c: &Channel| c.topic.starts_with(CHANNEL_PREFIX) && c.encoding == MESSAGE_ENCODING;
        if !declared.channels.values().any(ours) {
            let names: Vec<_> = declared.channels.values().map(|c| c.topic.as_str()).collect();
            let channels = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(ReadError::NotOurs { path: self.path.clone(), profile: self.profile.clone(), channels });
        }
        for (id, channel) in declared.channels {
            let mut topic = None;
            if let (true, Some(name)) = (ours(&channel), channel.topic.strip_prefix(CHANNEL_PREFIX)) {
                topic = topics::ALL.iter().find(|t| t.rules.name == name);
                let recorded = declared.schemas.get(&channel.schema).map_or("no schema", |s| s.text.as_str());
                let current = topic.map_or_else(|| "this topic does not exist".to_owned(), |t| (t.describe)());
                if recorded != current {
                    let (path, topic) = (self.path.clone(), name.to_owned());
                    return Err(ReadError::Layout { path, topic, recorded: recorded.to_owned(), current });
                }
            }
            self.channels.insert(id, Known { name: channel.topic, topic });
        }
        match self.entries.iter().find(|e| !self.channels.contains_key(&e.channel)) {
            Some(e) => Err(self.damaged(self.chunks[e.chunk].offset + e.offset, "a message of an undeclared channel")),
            None => Ok(()),
        }
    }
}

/// Opcode and length of a record.
fn record_head(head: &[u8; RECORD_HEAD as usize]) -> (u8, u64) {
    let mut p = Parser(head);
    (p.u8().unwrap_or(0), p.u64().unwrap_or(u64::MAX))
}

/// The schemas and channels met so far.
#[derive(Default)]
struct Declared {
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Channel>,
}

impl Declared {
    /// Keeps a schema or channel; one that does not parse leaves its messages without a declaration, which is noticed.
    fn add(&mut self, opcode: u8, content: &[u8]) {
        if opcode == op::SCHEMA {
            if let Some(schema) = Schema::parse(content) {
                self.schemas.insert(schema.id, schema);
            }
        } else if let Some(channel) = Channel::parse(content) {
            self.channels.insert(channel.id, channel);
        }
    }
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
