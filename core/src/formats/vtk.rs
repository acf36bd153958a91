//! Legacy VTK clouds: the POINTS of a POLYDATA or UNSTRUCTURED_GRID data set, ascii or binary (big-endian).

use super::{
    cloud_reader::{CountHint, Record, RecordReader},
    error::FormatError,
    scalar::{Endian, Scalar},
    source::{Source, quoted},
};

/// POINTS stands near the top; a file without it by then is something else.
const MOST_HEADER_LINES: usize = 1024;

/// Reads the points; attributes and cells after them are not looked at.
pub(super) struct VtkReader {
    source: Source,
    is_binary: bool,
    scalar: Scalar,
    left: usize,
    count: CountHint,
    /// Values of the current ascii line, which may hold any number of points, and how many of them are used.
    values: Vec<f64>,
    used: usize,
}

impl VtkReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let wrong =
            |source: &Source, field, expected: &str| Err(source.malformed_line(field, quoted(source.line()), expected));
        if !source.next_line()? || !source.line().starts_with(b"# vtk DataFile Version") {
            return wrong(&source, "the first line", "`# vtk DataFile Version N.N`");
        }
        // The second line is a title.
        if !source.next_line()? || !source.next_line()? {
            return Err(source.truncated("ASCII or BINARY in the third line".into()));
        }
        let is_binary = match source.line() {
            b"ASCII" => false,
            b"BINARY" => true,
            _ => return wrong(&source, "the third line", "ASCII or BINARY"),
        };
        for _ in 0..MOST_HEADER_LINES {
            if !source.next_line()? {
                return Err(source.truncated("a line `POINTS COUNT TYPE`".into()));
            }
            let line = source.line_text();
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["DATASET", "POLYDATA" | "UNSTRUCTURED_GRID"] => {}
                ["DATASET", ..] => return wrong(&source, "the data set", "POLYDATA or UNSTRUCTURED_GRID"),
                ["POINTS", count, kind] => {
                    let (Ok(count), Some(scalar)) = (count.parse(), scalar_of(kind)) else {
                        return wrong(&source, "POINTS", "`POINTS COUNT TYPE`, a whole number and float or double");
                    };
                    return Self::at_points(source, is_binary, scalar, count);
                }
                _ => {}
            }
        }
        wrong(&source, "the header", "a line `POINTS COUNT TYPE`")
    }

    fn at_points(source: Source, is_binary: bool, scalar: Scalar, left: usize) -> Result<Self, FormatError> {
        source.check_holds(left, if is_binary { 3 * scalar.size() } else { 6 }, "points")?;
        let count = if source.is_packed() { CountHint::AtMost(left) } else { CountHint::Exact(left) };
        Ok(Self { source, is_binary, scalar, left, count, values: Vec::new(), used: 0 })
    }

    fn next_binary(&mut self) -> Result<[f64; 3], FormatError> {
        let mut bytes = [0_u8; 24];
        let size = self.scalar.size();
        let bytes = bytes.get_mut(..3 * size).unwrap_or(&mut []);
        self.source.read_exact(bytes, "a point")?;
        Ok([0, 1, 2].map(|i| self.scalar.read(bytes.get(i * size..).unwrap_or(&[]), Endian::Big)))
    }

    fn next_ascii(&mut self) -> Result<[f64; 3], FormatError> {
        let mut position = [0.0; 3];
        for coordinate in &mut position {
            while self.used == self.values.len() {
                if !self.source.next_line()? {
                    return Err(self.source.truncated(format!("{} more points", self.left)));
                }
                self.values.clear();
                self.used = 0;
                for token in self.source.tokens() {
                    self.values.push(self.source.number(token, "a coordinate")?);
                }
            }
            *coordinate = self.values.get(self.used).copied().unwrap_or(f64::NAN);
            self.used += 1;
        }
        Ok(position)
    }
}

impl RecordReader for VtkReader {
    fn count(&self) -> CountHint {
        self.count
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        if self.left == 0 {
            return Ok(None);
        }
        let position = if self.is_binary { self.next_binary()? } else { self.next_ascii()? };
        self.left -= 1;
        Ok(Some(Record { position, intensity: 0 }))
    }
}

fn scalar_of(name: &str) -> Option<Scalar> {
    Some(match name {
        "float" => Scalar::F32,
        "double" => Scalar::F64,
        "char" => Scalar::I8,
        "unsigned_char" => Scalar::U8,
        "short" => Scalar::I16,
        "unsigned_short" => Scalar::U16,
        "int" => Scalar::I32,
        "unsigned_int" => Scalar::U32,
        _ => return None,
    })
}
