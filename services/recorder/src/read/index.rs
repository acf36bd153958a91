//! Finding the chunks, messages and declarations of a recording by the heads of its records.

use std::collections::BTreeMap;

use mirador_ipc_schema::topics;

use super::{Entry, Known, ReadError, RunReader};
use crate::records::{CHUNK_HEAD, Channel, Chunk, MESSAGE_HEAD, Parser, RECORD_HEAD, SMALL_RECORD, Schema, op};
use crate::{CHANNEL_PREFIX, MESSAGE_ENCODING};

impl RunReader {
    /// Walks over the records of the file and keeps its chunks. Stops where a record is cut off.
    pub(super) fn find_chunks(&mut self, declared: &mut Declared) -> Result<(), ReadError> {
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
    pub(super) fn find_messages(&mut self, chunk: usize, declared: &mut Declared) -> Result<(), ReadError> {
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
    pub(super) fn check(&mut self, declared: Declared) -> Result<(), ReadError> {
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
pub(super) struct Declared {
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
