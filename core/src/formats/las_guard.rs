//! What the LAS and LAZ decoder would take at its word, checked before it can allocate by it.

use las::point::Format;
use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

/// More points than this in a byte are not believed: a chunk of 50,000 points takes more than one.
pub(super) const MOST_POINTS_PER_BYTE: u64 = 50_000;

/// Layers up to this size [bytes] are let through whatever the file's size.
const HARMLESS: u64 = 1 << 24;

/// Checks the place and the number of the points, the extended records after them and the table of compressed chunks.
/// Leaves the file at its start and returns the bytes from the first point to the end.
pub(super) fn check_header(file: &mut File) -> las::Result<u64> {
    let size = file.metadata()?.len();
    let header = las::raw::Header::read_from(&mut *file)?;
    let start = u64::from(header.offset_to_point_data);
    if start > size {
        return Err(invalid(format!("the points begin at byte {start} of {size}")));
    }
    let large = header.large_file.map_or(0, |large| large.number_of_point_records);
    let counted = large.max(header.number_of_point_records.into());
    if counted > size.saturating_mul(MOST_POINTS_PER_BYTE) {
        return Err(invalid(format!("{counted} points in a file of {size} bytes")));
    }
    if let Some(evlr) = header.evlr {
        check_extended_records(file, size, evlr.start_of_first_evlr, evlr.number_of_evlrs)?;
    }
    // LAZ marks itself by the upper bits of the point format.
    if header.point_data_record_format & 0xC0 != 0 {
        check_chunk_table(file, size, start)?;
    }
    file.rewind()?;
    Ok(size - start)
}

fn invalid(what: String) -> las::Error {
    las::Error::from(io::Error::new(io::ErrorKind::InvalidData, what))
}

fn check_extended_records(file: &mut File, size: u64, first: u64, count: u32) -> las::Result<()> {
    let mut at = first;
    for _ in 0..count {
        // A head of 60 bytes with the length in bytes 20 to 28.
        file.seek(SeekFrom::Start(at.saturating_add(20).min(size)))?;
        let length = read_u64(file)?;
        at = at.saturating_add(60).saturating_add(length);
        if at > size {
            return Err(invalid(format!("an extended record ends at byte {at} of {size}")));
        }
    }
    Ok(())
}

/// The number of chunks stands in the table, whose place stands before the first point, or, when the writer could not
/// go back, in the last 8 bytes. A table that is out of reach is left to the decoder, which can do without.
fn check_chunk_table(file: &mut File, size: u64, start: u64) -> las::Result<()> {
    file.seek(SeekFrom::Start(start))?;
    let mut table = read_u64(file)?;
    if table as i64 <= start as i64 && size >= 8 {
        file.seek(SeekFrom::Start(size - 8))?;
        table = read_u64(file)?;
    }
    if table.saturating_add(8) > size {
        return Ok(());
    }
    file.seek(SeekFrom::Start(table))?;
    let chunks = read_u64(file)? >> 32;
    if chunks > size {
        return Err(invalid(format!("{chunks} compressed chunks in a file of {size} bytes")));
    }
    Ok(())
}

fn read_u64(file: &mut File) -> las::Result<u64> {
    let mut bytes = [0_u8; 8];
    file.read_exact(&mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}

/// The file under the decoder. In the layered compression of point formats 6 and above the decoder allocates each layer
/// by a size of 4 bytes from the file, and reads nothing else in fours: a size that the file cannot hold is refused here.
pub(super) struct SizeGuard {
    file: BufReader<File>,
    limit: Limit,
}

/// The largest size that is let through, shared with the reader that knows when it applies.
#[derive(Clone)]
pub(super) struct Limit(Arc<AtomicU64>);

impl Limit {
    /// From now on sizes are watched, if points of this format are read in layers. Four extra bytes a point would be
    /// read in fours too: such files are not watched.
    pub(super) fn watch(&self, format: &Format, room: u64) {
        if format.is_compressed && format.is_extended && format.extra_bytes != 4 {
            self.0.store(room.max(HARMLESS), Ordering::Relaxed);
        }
    }
}

impl SizeGuard {
    pub(super) fn new(file: File) -> Self {
        Self { file: BufReader::with_capacity(1 << 16, file), limit: Limit(Arc::new(AtomicU64::new(u64::MAX))) }
    }

    pub(super) fn limit(&self) -> Limit {
        self.limit.clone()
    }
}

impl Read for SizeGuard {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.read(buffer)
    }

    fn read_exact(&mut self, buffer: &mut [u8]) -> io::Result<()> {
        self.file.read_exact(buffer)?;
        if let [a, b, c, d] = *buffer {
            let size = u64::from(u32::from_le_bytes([a, b, c, d]));
            if size > self.limit.0.load(Ordering::Relaxed) {
                let what = format!("a layer of {size} bytes, more than the file holds");
                return Err(io::Error::new(io::ErrorKind::InvalidData, what));
            }
        }
        Ok(())
    }
}

impl Seek for SizeGuard {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
