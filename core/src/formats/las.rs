//! LAS and LAZ clouds, through the `las` crate, which is given only headers that were checked first.

use super::{
    cloud_reader::{CHUNK_POINTS, CountHint, Record, RecordReader},
    error::FormatError,
    source::Source,
};
use las::{PointData, PointDataBuilder, Reader};
use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
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
        let reader = decoded(&path, 0, || Reader::new(BufReader::with_capacity(1 << 16, file)))?;
        let header = reader.header();
        let points = header.number_of_points();
        let format = *header.point_format();
        let record = u64::from(format.len());
        // LAZ packs a point of a still surface into a few bits, but never a chunk of 50,000 into less than one record.
        let most = if format.is_compressed { room.saturating_mul(50_000) } else { room / record.max(1) };
        let count = usize::try_from(points).ok().filter(|_| points <= most);
        let Some(count) = count else {
            let reason = format!("the header counts {points} points, the {room} bytes after it hold {most} at most");
            return Err(refusal(&path, 0, &reason));
        };
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

/// Checks what the decoder would take at its word: the place of the points, and the extended records after them, whose
/// lengths it allocates. Leaves the file at its start and returns the bytes from the first point to the end.
fn check_header(file: &mut File) -> las::Result<u64> {
    let size = file.metadata()?.len();
    let invalid = |what: String| las::Error::from(io::Error::new(io::ErrorKind::InvalidData, what));
    let header = las::raw::Header::read_from(&mut *file)?;
    let start = u64::from(header.offset_to_point_data);
    if start > size {
        return Err(invalid(format!("the points begin at byte {start} of {size}")));
    }
    // An early point count bounds the arithmetic inside the decoder as well as the memory.
    let counted =
        u64::from(header.number_of_point_records).max(header.large_file.map_or(0, |l| l.number_of_point_records));
    if counted > size.saturating_mul(50_000) {
        return Err(invalid(format!("{counted} points in a file of {size} bytes")));
    }
    if let Some(evlr) = header.evlr {
        let mut at = evlr.start_of_first_evlr;
        for _ in 0..evlr.number_of_evlrs {
            // 60 bytes of head, the length in bytes 20 to 28.
            file.seek(SeekFrom::Start(at))?;
            let mut head = [0_u8; 60];
            file.read_exact(&mut head)?;
            let mut length = [0_u8; 8];
            length.copy_from_slice(head.get(20..28).unwrap_or(&[0; 8]));
            let length = u64::from_le_bytes(length);
            at = at.saturating_add(60).saturating_add(length);
            if at > size {
                return Err(invalid(format!("an extended record ends at byte {at} of {size}")));
            }
        }
    }
    file.rewind()?;
    Ok(size - start)
}
