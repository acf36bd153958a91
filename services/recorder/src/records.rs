//! The few MCAP records that reading needs, parsed so that no byte of a damaged file can do harm.
//!
//! Layouts after the MCAP specification (mcap.dev/spec): a record is an opcode (u8), a length (u64) and its content;
//! integers are little endian; strings and arrays begin with their length in bytes (u32).

/// Bytes in front of the content of a record.
pub(crate) const RECORD_HEAD: u64 = 9;
/// Bytes in front of the data of a message: channel (u16), sequence (u32), log time (u64), publish time (u64).
pub(crate) const MESSAGE_HEAD: u64 = 22;
/// The longest record that is read as a whole although nothing vouches for its length.
pub(crate) const SMALL_RECORD: u64 = 1 << 20;

/// Opcodes.
pub(crate) mod op {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
}

/// Reads values from the front of a slice; every value that is not there is `None`.
pub(crate) struct Parser<'a>(pub(crate) &'a [u8]);

impl<'a> Parser<'a> {
    pub(crate) fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (front, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(front)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[b]| b)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn sized(&mut self) -> Option<&'a [u8]> {
        let n = self.u32()?;
        self.bytes(usize::try_from(n).ok()?)
    }

    pub(crate) fn string(&mut self) -> Option<String> {
        String::from_utf8(self.sized()?.to_vec()).ok()
    }
}

/// A schema record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Schema {
    pub(crate) id: u16,
    pub(crate) text: String,
}

impl Schema {
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut p = Parser(content);
        let id = p.u16()?;
        let (_name, _encoding) = (p.string()?, p.string()?);
        // Binary schemas (protobuf) are none of ours, so their text does not matter.
        Some(Self { id, text: String::from_utf8_lossy(p.sized()?).into_owned() })
    }
}

/// A channel record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Channel {
    pub(crate) id: u16,
    pub(crate) schema: u16,
    pub(crate) topic: String,
    pub(crate) encoding: String,
}

impl Channel {
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut p = Parser(content);
        Some(Self { id: p.u16()?, schema: p.u16()?, topic: p.string()?, encoding: p.string()? })
    }
}

/// How the records of a chunk are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    Plain,
    Lz4,
}

/// Where a chunk lies in the file, and what its header says of its content.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chunk {
    /// Offset of the packed records in the file.
    pub(crate) offset: u64,
    /// Bytes of the packed records.
    pub(crate) packed: u64,
    /// Bytes of the records.
    pub(crate) size: u64,
    /// CRC-32 of the records, 0 when there is none.
    pub(crate) crc: u32,
    pub(crate) packing: Packing,
}

/// Longest head of a chunk that is believed: the fixed fields and the name of the compression.
pub(crate) const CHUNK_HEAD: usize = 40 + 16;

impl Chunk {
    /// Parses the head of a chunk record whose content lies at `content_offset` and is `length` bytes long; `head` is
    /// its beginning.
    pub(crate) fn parse(head: &[u8], content_offset: u64, length: u64) -> Option<Self> {
        let mut p = Parser(head);
        let (_start, _end) = (p.u64()?, p.u64()?);
        let size = p.u64()?;
        let crc = p.u32()?;
        let packing = match p.string()?.as_str() {
            "" => Packing::Plain,
            "lz4" => Packing::Lz4,
            _ => return None,
        };
        let packed = p.u64()?;
        let head_bytes = (head.len() - p.0.len()) as u64;
        if head_bytes.checked_add(packed)? > length {
            return None;
        }
        // LZ4 expands at most 255 times, so a larger claim is damage and must not be allocated.
        let possible = match packing {
            Packing::Plain => size == packed,
            Packing::Lz4 => size / 256 <= packed,
        };
        possible.then_some(Self { offset: content_offset + head_bytes, packed, size, crc, packing })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_bytes_are_parsed_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
            let _ = (Schema::parse(&bytes), Channel::parse(&bytes));
            if let Some(chunk) = Chunk::parse(&bytes, 17, bytes.len() as u64) {
                prop_assert!(chunk.offset + chunk.packed <= 17 + bytes.len() as u64);
            }
        }
    }

    #[test]
    fn a_channel_record_is_read_field_by_field() {
        let record = [&[3, 0, 9, 0, 2, 0, 0, 0], &b"ab"[..], &[1, 0, 0, 0], b"c", &[0, 0, 0, 0]].concat();
        let expected = Channel { id: 3, schema: 9, topic: "ab".into(), encoding: "c".into() };
        assert_eq!(Channel::parse(&record), Some(expected));
    }
}
