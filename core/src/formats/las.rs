//! LAS and LAZ clouds, through the `las` crate, which is given only headers that were checked first.

use super::{
    cloud_reader::{CHUNK_POINTS, CountHint, Record, RecordReader},
    error::FormatError,
    las_guard::{MOST_POINTS_PER_BYTE, SizeGuard, check_header},
    source::Source,
};
use las::{PointData, PointDataBuilder, Reader};
use std::{
    fs::File,
    io::{self, Seek},
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
};

/// Reads the points in the order of the file. The decoder needs random access: a gzipped file is unpacked to a
/// temporary file that has no name and is gone when the reader is.
pub(super) struct LasReader {
    path: PathBuf,
    /// `None` after an error: a decoder that failed half way is not asked again.
    reader: Option<Reader>,
    /// Decoded records, and how many of them have been given out.
    chunk: PointData,
    used: usize,
    count: usize,
    read: u64,
}

impl LasReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let path = source.path().to_path_buf();
        let mut file = if source.is_packed() { unpacked(&mut source)? } else { open(&source)? };
        drop(source);
        let room = check_header(&mut file).map_err(|e| refusal(&path, 0, &e.to_string()))?;
        let guard = SizeGuard::new(file);
        let limit = guard.limit();
        let reader = decoded(&path, 0, || Reader::new(guard))?;
        let header = reader.header();
        let points = header.number_of_points();
        let format = *header.point_format();
        let record = u64::from(format.len());
        // LAZ packs a point of a still surface into a few bits, but never a chunk of 50,000 into less than one record.
        let most = if format.is_compressed { room.saturating_mul(MOST_POINTS_PER_BYTE) } else { room / record.max(1) };
        let count = usize::try_from(points).ok().filter(|_| points <= most);
        let Some(count) = count else {
            let reason = format!("the header counts {points} points, the {room} bytes after it hold {most} at most");
            return Err(refusal(&path, 0, &reason));
        };
        limit.watch(&format, room);
        let chunk = PointDataBuilder::new().for_header(header).build();
        Ok(Self { path, reader: Some(reader), chunk, used: 0, count, read: 0 })
    }

    fn refill(&mut self) -> Result<(), FormatError> {
        self.used = 0;
        let Some(mut reader) = self.reader.take() else {
            return Err(refusal(&self.path, self.read, "reading stopped at an earlier error"));
        };
        let chunk = &mut self.chunk;
        decoded(&self.path, self.read, || reader.fill_points(CHUNK_POINTS as u64, chunk))?;
        self.reader = Some(reader);
        Ok(())
    }
}

impl RecordReader for LasReader {
    fn count(&self) -> CountHint {
        CountHint::Exact(self.count)
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        if self.used == self.chunk.len() {
            self.refill()?;
            if self.chunk.is_empty() {
                return Ok(None);
            }
        }
        // The first 14 bytes are the same in every point format: x, y, z as i32 and the intensity as u16.
        let start = self.used * self.chunk.record_len();
        let Some(&[a, b, c, d, e, f, g, h, i, j, k, l, m, n]) = self.chunk.raw_bytes().get(start..start + 14) else {
            return Err(refusal(&self.path, self.read, "a point record is shorter than 14 bytes"));
        };
        let t = self.chunk.transforms();
        let x = t.x.direct(i32::from_le_bytes([a, b, c, d]));
        let y = t.y.direct(i32::from_le_bytes([e, f, g, h]));
        let z = t.z.direct(i32::from_le_bytes([i, j, k, l]));
        self.used += 1;
        self.read += 1;
        Ok(Some(Record { position: [x, y, z], intensity: u16::from_le_bytes([m, n]) }))
    }
}

fn refusal(path: &std::path::Path, point: u64, reason: &str) -> FormatError {
    FormatError::Las { path: path.to_path_buf(), point, reason: reason.to_owned() }
}

/// The decoder's answer; a panic inside it on damaged data is an error like any other.
fn decoded<T>(path: &std::path::Path, point: u64, call: impl FnOnce() -> las::Result<T>) -> Result<T, FormatError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(e)) => Err(refusal(path, point, &e.to_string())),
        Err(_) => Err(refusal(path, point, "the data is damaged (the decoder lost its way)")),
    }
}

fn open(source: &Source) -> Result<File, FormatError> {
    File::open(source.path()).map_err(|e| FormatError::io(source.path(), e))
}

fn unpacked(source: &mut Source) -> Result<File, FormatError> {
    let path = source.path().to_path_buf();
    let mut file = tempfile::tempfile().map_err(|e| FormatError::io(&path, e))?;
    let mut piece = vec![0; 1 << 16];
    loop {
        let n = source.read_up_to(&mut piece)?;
        let Some(bytes) = piece.get(..n).filter(|bytes| !bytes.is_empty()) else { break };
        io::Write::write_all(&mut file, bytes).map_err(|e| FormatError::io(&path, e))?;
    }
    file.rewind().map_err(|e| FormatError::io(&path, e))?;
    Ok(file)
}
