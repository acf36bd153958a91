//! 3DTK `.3d` clouds: text, centimetres, left-handed (x right, y up, z ahead), optionally with intensity.

use super::{
    cloud_reader::{CountHint, Record, RecordReader, intensity_from},
    error::FormatError,
    source::{Source, parse_number, quoted},
};

/// Right-handed metres from 3DTK's left-handed centimetres: x ahead = z, y left = -x, z up = y.
#[must_use]
pub(super) fn metres_from_tdtk([x, y, z]: [f64; 3]) -> [f64; 3] {
    [z / 100.0, -x / 100.0, y / 100.0]
}

/// Reads `x y z` or `x y z intensity` a line, after a header line that may be missing.
pub(super) struct TdtkReader {
    source: Source,
    /// 3 or 4, the same on every line; 0 when there is no line.
    columns: usize,
    /// The first line was taken to look for a header and is a point.
    line_waits: bool,
    at_most: usize,
}

impl TdtkReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let at_most = text_lines_at_most(&source);
        let mut line_waits = source.next_data_line()?;
        if line_waits && is_header(&source) {
            line_waits = source.next_data_line()?;
        }
        let columns = if line_waits { source.tokens().count() } else { 0 };
        Ok(Self { source, columns, line_waits, at_most })
    }

    fn parse_line(&self) -> Result<Record, FormatError> {
        let found = self.source.tokens().count();
        if found != self.columns || !(3..=4).contains(&found) {
            let expected = "3 (x y z [cm]) or 4 (with intensity), the same on every line";
            return Err(self.source.malformed_line("the number of columns", found.to_string(), expected));
        }
        let mut values = [0.0; 4];
        for ((value, token), field) in values.iter_mut().zip(self.source.tokens()).zip(["x", "y", "z", "intensity"]) {
            *value = self.source.number(token, field)?;
        }
        let [x, y, z, intensity] = values;
        Ok(Record { position: metres_from_tdtk([x, y, z]), intensity: intensity_from(intensity) })
    }
}

/// A first line is a header unless it has the columns of a point and begins with a number: then a wrong value in it is
/// a mistake, not a header.
fn is_header(source: &Source) -> bool {
    let starts_with_number = source.tokens().next().is_some_and(|token| parse_number(token).is_some());
    !(starts_with_number && (3..=4).contains(&source.tokens().count()))
}

impl RecordReader for TdtkReader {
    fn count(&self) -> CountHint {
        CountHint::AtMost(self.at_most)
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        if !std::mem::take(&mut self.line_waits) && !self.source.next_data_line()? {
            return Ok(None);
        }
        self.parse_line().map(Some)
    }

    fn count_rest(&mut self) -> Result<usize, FormatError> {
        Ok(usize::from(std::mem::take(&mut self.line_waits)) + self.source.count_data_lines()?)
    }
}

/// The most lines of three numbers that the rest of a text file can hold: the shortest is "0 0 0" and its end.
pub(super) fn text_lines_at_most(source: &Source) -> usize {
    usize::try_from(source.remaining_at_most() / 6 + 1).unwrap_or(usize::MAX)
}

/// The numbers of the line taken last, which must be exactly `N`.
pub(super) fn numbers<const N: usize>(
    source: &Source,
    field: &'static str,
    expected: &str,
) -> Result<[f64; N], FormatError> {
    let found = source.tokens().count();
    if found != N {
        return Err(source.malformed_line(field, quoted(source.line()), expected));
    }
    let mut values = [0.0; N];
    for (value, token) in values.iter_mut().zip(source.tokens()) {
        *value = source.number(token, field)?;
    }
    Ok(values)
}
