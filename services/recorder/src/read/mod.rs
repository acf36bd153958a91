//! Reading `run.mcap`.
//!
//! Opening walks over the heads of all records, never over points, and keeps where every message lies; reading takes
//! one chunk at a time, checks its CRC and copies the message into aligned buffers. So a recording of any length is
//! read in the memory of its largest chunk, and one that was cut off is read up to its last complete chunk.

mod error;
mod index;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mirador_ipc_schema::ScanId;
use mirador_ipc_schema::messages::{Point, ScanMeta};
use mirador_ipc_schema::topics::{self, Topic, TopicInfo};
use mirador_viewers::Stamps;

use crate::CHANNEL_PREFIX;
use crate::records::{Chunk, Packing};

use index::Declared;

pub use error::ReadError;

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
            match reader.find_messages(chunk, &mut declared) {
                // Of a recording that was cut off, the end may be there in length but not in content.
                Err(ReadError::Damaged { .. }) if !reader.complete && chunk > 0 => {
                    reader.entries.retain(|e| e.chunk < chunk);
                    break;
                }
                found => found?,
            }
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

    /// Calls `visit` with the topic and the bytes (meta part, then items) of every message, in the order of the recording.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn for_each_message(&mut self, mut visit: impl FnMut(&str, &[u8])) -> Result<(), ReadError> {
        self.for_each_record(|channel, _, data| {
            channel.strip_prefix(CHANNEL_PREFIX).into_iter().for_each(|topic| visit(topic, data));
            Ok(())
        })
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
}

#[cfg(test)]
mod tests;
