//! PCD clouds: ascii, binary (little-endian) and binary_compressed. VIEWPOINT is not applied.

use super::{
    cloud_reader::{CountHint, Record, RecordReader},
    error::FormatError,
    lzf,
    scalar::{Endian, FieldAt, RecordBuilder, Role, Scalar, record_from_bytes},
    source::{Source, quoted},
};
use crate::scan::Grid;

/// A record or a header beyond these is damage.
const MOST_RECORD_BYTES: usize = 1 << 16;
const MOST_HEADER_LINES: usize = 256;

/// One entry of FIELDS with its SIZE, TYPE and COUNT.
#[derive(Debug, Clone, Copy)]
struct Field {
    role: Role,
    scalar: Scalar,
    count: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Data {
    Ascii,
    Binary,
    BinaryCompressed,
}

#[derive(Default)]
struct RawHeader {
    names: Vec<String>,
    sizes: Vec<String>,
    types: Vec<String>,
    counts: Vec<String>,
    width: Option<usize>,
    height: Option<usize>,
    points: Option<usize>,
}

/// Reads the points in the order of the file; HEIGHT above 1 makes them a grid of HEIGHT rows and WIDTH columns.
pub(super) struct PcdReader {
    source: Source,
    data: Data,
    fields: Vec<Field>,
    /// Where x, y, z and intensity are: in a record, or (compressed) where their planes begin.
    places: Vec<FieldAt>,
    /// One record, or (compressed) all planes.
    buffer: Vec<u8>,
    points: usize,
    read: usize,
    grid: Option<Grid>,
}

impl PcdReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let (header, data) = read_header(&mut source)?;
        let fields = fields_from(&source, &header)?;
        let (points, grid) = size_from(&source, &header)?;
        let record_bytes: usize = fields.iter().map(|f| f.scalar.size() * f.count).sum();
        let mut buffer = Vec::new();
        match data {
            Data::Ascii => {
                let columns: usize = fields.iter().map(|f| f.count).sum();
                source.check_holds(points, 2 * columns, "points")?;
            }
            Data::Binary => {
                source.check_holds(points, record_bytes, "points")?;
                buffer = vec![0; record_bytes];
            }
            Data::BinaryCompressed => buffer = read_compressed(&mut source, points, record_bytes)?,
        }
        // In a record each field follows the one before; in a compressed block each field's plane does.
        let stride = if data == Data::BinaryCompressed { points } else { 1 };
        let mut offset = 0;
        let mut places = Vec::new();
        for field in &fields {
            if field.role != Role::Other {
                places.push(FieldAt { role: field.role, scalar: field.scalar, offset });
            }
            offset += field.scalar.size() * field.count * stride;
        }
        Ok(Self { source, data, fields, places, buffer, points, read: 0, grid })
    }

    fn next_ascii(&mut self) -> Result<Record, FormatError> {
        if !self.source.next_data_line()? {
            let missing = self.points - self.read;
            return Err(self.source.truncated(format!("{missing} more points, one a line, as POINTS says")));
        }
        let source = &self.source;
        let mut tokens = source.tokens();
        let mut record = RecordBuilder::new();
        let wrong =
            || source.malformed_line("the point", quoted(source.line()), "one value for each of FIELDS and COUNT");
        for field in &self.fields {
            for i in 0..field.count {
                let token = tokens.next().ok_or_else(wrong)?;
                if field.role != Role::Other && i == 0 {
                    record.set(field.role, source.number(token, "a field of the point")?);
                }
            }
        }
        if tokens.next().is_some() {
            return Err(wrong());
        }
        Ok(record.build())
    }

    /// The next point out of the planes of a compressed block.
    fn next_unpacked(&self) -> Record {
        let mut record = RecordBuilder::new();
        for place in &self.places {
            let at = place.offset + place.scalar.size() * self.read;
            record.set(place.role, place.scalar.read(self.buffer.get(at..).unwrap_or(&[]), Endian::Little));
        }
        record.build()
    }
}

impl RecordReader for PcdReader {
    fn count(&self) -> CountHint {
        let is_checked = !self.source.is_packed() || self.data == Data::BinaryCompressed;
        if is_checked { CountHint::Exact(self.points) } else { CountHint::AtMost(self.points) }
    }

    fn grid(&self) -> Option<Grid> {
        self.grid
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        if self.read == self.points {
            if self.data == Data::Ascii && self.source.next_data_line()? {
                let expected = format!("the end of the file after the {} points of the header", self.points);
                return Err(self.source.malformed_line("the line", quoted(self.source.line()), &expected));
            }
            return Ok(None);
        }
        let record = match self.data {
            Data::Ascii => self.next_ascii()?,
            Data::Binary => {
                self.source.read_exact(&mut self.buffer, "a point")?;
                record_from_bytes(&self.places, &self.buffer, Endian::Little)
            }
            Data::BinaryCompressed => self.next_unpacked(),
        };
        self.read += 1;
        Ok(Some(record))
    }
}

/// The header up to and with its DATA line, so that errors about it name that line.
fn read_header(source: &mut Source) -> Result<(RawHeader, Data), FormatError> {
    let mut header = RawHeader::default();
    for _ in 0..MOST_HEADER_LINES {
        if !source.next_data_line()? {
            return Err(source.truncated("a header up to its DATA line".into()));
        }
        let line = source.line_text();
        let mut words = line.split_ascii_whitespace();
        let key = words.next().unwrap_or("").to_uppercase();
        let values: Vec<String> = words.map(str::to_owned).collect();
        let whole = || {
            let number = values.first().and_then(|v| v.parse().ok());
            number.ok_or_else(|| {
                source.malformed_line("the header", quoted(source.line()), "a whole number after the key")
            })
        };
        match key.as_str() {
            "VERSION" | "VIEWPOINT" => {}
            "FIELDS" | "COLUMNS" => header.names = values,
            "SIZE" => header.sizes = values,
            "TYPE" => header.types = values,
            "COUNT" => header.counts = values,
            "WIDTH" => header.width = Some(whole()?),
            "HEIGHT" => header.height = Some(whole()?),
            "POINTS" => header.points = Some(whole()?),
            "DATA" => {
                let data = match values.first().map(String::as_str) {
                    Some("ascii") => Data::Ascii,
                    Some("binary") => Data::Binary,
                    Some("binary_compressed") => Data::BinaryCompressed,
                    _ => {
                        let expected = "ascii, binary or binary_compressed";
                        return Err(source.malformed_line("DATA", quoted(source.line()), expected));
                    }
                };
                return Ok((header, data));
            }
            _ => {
                let expected = "VERSION, FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS or DATA";
                return Err(source.malformed_line("the header", quoted(source.line()), expected));
            }
        }
    }
    Err(source.malformed_line("the header", format!("longer than {MOST_HEADER_LINES} lines"), "a PCD header"))
}

fn fields_from(source: &Source, header: &RawHeader) -> Result<Vec<Field>, FormatError> {
    let n = header.names.len();
    let wrong = |field, found: String, expected: &str| source.malformed_line(field, found, expected);
    if header.sizes.len() != n || header.types.len() != n || !(header.counts.is_empty() || header.counts.len() == n) {
        return Err(wrong("SIZE, TYPE or COUNT", "of another length than FIELDS".into(), "one entry a field"));
    }
    let mut fields = Vec::with_capacity(n);
    let mut bytes = 0_usize;
    for (i, (name, (size, kind))) in header.names.iter().zip(header.sizes.iter().zip(&header.types)).enumerate() {
        let scalar = match (kind.as_str(), size.as_str()) {
            ("F", "4") => Scalar::F32,
            ("F", "8") => Scalar::F64,
            ("I", "1") => Scalar::I8,
            ("I", "2") => Scalar::I16,
            ("I", "4") => Scalar::I32,
            ("I", "8") => Scalar::I64,
            ("U", "1") => Scalar::U8,
            ("U", "2") => Scalar::U16,
            ("U", "4") => Scalar::U32,
            ("U", "8") => Scalar::U64,
            _ => return Err(wrong("TYPE and SIZE", format!("{kind} {size}"), "F 4|8, I 1|2|4|8 or U 1|2|4|8")),
        };
        let count = match header.counts.get(i) {
            None => 1,
            Some(text) => text.parse().map_err(|_| wrong("COUNT", text.clone(), "whole numbers"))?,
        };
        bytes = bytes.saturating_add(scalar.size().saturating_mul(count));
        if bytes > MOST_RECORD_BYTES {
            return Err(wrong("COUNT", format!("{bytes} bytes a point"), "at most 64 KiB a point"));
        }
        let role = if count == 0 { Role::Other } else { Role::of_name(name) };
        fields.push(Field { role, scalar, count });
    }
    for role in [Role::X, Role::Y, Role::Z] {
        if fields.iter().filter(|f| f.role == role).count() != 1 {
            return Err(wrong("FIELDS", header.names.join(" "), "x, y and z, once each"));
        }
    }
    Ok(fields)
}

fn size_from(source: &Source, header: &RawHeader) -> Result<(usize, Option<Grid>), FormatError> {
    let wrong = |found: String| {
        source.malformed_line("WIDTH, HEIGHT, POINTS", found, "POINTS = WIDTH x HEIGHT (one of them may be missing)")
    };
    let (rows, cols) = match (header.width, header.height, header.points) {
        (Some(width), height, points) => {
            let rows = height.unwrap_or(1);
            let cells = rows.checked_mul(width).filter(|cells| points.is_none_or(|p| p == *cells));
            cells.ok_or_else(|| wrong(format!("{width}, {rows}, {points:?}")))?;
            (rows, width)
        }
        (None, None | Some(1), Some(points)) => (1, points),
        (None, height, points) => return Err(wrong(format!("missing, {height:?}, {points:?}"))),
    };
    Ok((rows * cols, (rows > 1).then_some(Grid { rows, cols })))
}

/// The unpacked planes of a compressed block; sizes in it are checked before memory is taken.
fn read_compressed(source: &mut Source, points: usize, record_bytes: usize) -> Result<Vec<u8>, FormatError> {
    let mut sizes = [0_u8; 8];
    source.read_exact(&mut sizes, "the sizes of the compressed block")?;
    let [a, b, c, d, e, f, g, h] = sizes;
    let packed_size = u32::from_le_bytes([a, b, c, d]) as usize;
    let size = u32::from_le_bytes([e, f, g, h]) as usize;
    let wrong = |source: &Source, field, found: String, expected: String| FormatError::Malformed {
        path: source.path().to_path_buf(),
        at: super::error::At::Byte(source.consumed()),
        field,
        found,
        expected,
    };
    let promised = points.saturating_mul(record_bytes);
    if size != promised || size as u64 > (packed_size as u64).saturating_mul(lzf::MOST_EXPANSION) {
        let expected = format!("{promised} bytes, {points} points of {record_bytes}");
        return Err(wrong(source, "the unpacked size", format!("{size} bytes in {packed_size}"), expected));
    }
    source.check_holds(packed_size, 1, "packed bytes")?;
    let mut packed = Vec::new();
    // Taken in pieces: in a gzipped file the bound on what is there is a weak one.
    while packed.len() < packed_size {
        let start = packed.len();
        packed.resize(packed_size.min(start + (1 << 20)), 0);
        source.read_exact(packed.get_mut(start..).unwrap_or(&mut []), "the compressed block")?;
    }
    lzf::unpack(&packed, size).ok_or_else(|| {
        wrong(source, "the compressed block", "damaged".into(), "an LZF block of the stated size".into())
    })
}
