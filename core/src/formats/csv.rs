//! CSV clouds: columns named x, y, z and perhaps intensity in a first line, or x, y, z without one.

use super::{
    cloud_reader::{CountHint, Record, RecordReader},
    error::FormatError,
    scalar::{RecordBuilder, Role},
    source::{Source, parse_number, quoted},
    tdtk::text_lines_at_most,
};

/// What stands between the values.
#[derive(Debug, Clone, Copy)]
enum Separator {
    Byte(u8),
    Blanks,
}

impl Separator {
    /// The first of comma, semicolon and tab that is in the line, else blanks.
    fn of_line(line: &[u8]) -> Self {
        [b',', b';', b'\t'].into_iter().find(|s| line.contains(s)).map_or(Self::Blanks, Self::Byte)
    }

    fn split(self, line: &[u8]) -> impl Iterator<Item = &[u8]> {
        line.split(move |byte| match self {
            Self::Byte(separator) => *byte == separator,
            Self::Blanks => byte.is_ascii_whitespace(),
        })
        .filter(move |value| matches!(self, Self::Byte(_)) || !value.is_empty())
        .map(<[u8]>::trim_ascii)
    }
}

/// Reads one point a line. Columns that are not named, and all after the third without a header (unless there are just
/// four: then the fourth is intensity), are left out.
pub(super) struct CsvReader {
    source: Source,
    separator: Separator,
    /// What each column means.
    columns: Vec<Role>,
    /// The first line was taken to look for a header and is a point.
    line_waits: bool,
    at_most: usize,
}

impl CsvReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let at_most = text_lines_at_most(&source);
        loop {
            if !source.next_line()? {
                let (separator, columns) = (Separator::Blanks, Vec::new());
                return Ok(Self { source, separator, columns, line_waits: false, at_most });
            }
            let whole = source.line();
            let is_comment = whole.starts_with(b"#");
            let line = whole.strip_prefix(b"#").or(whole.strip_prefix(b"//")).unwrap_or(whole);
            let separator = Separator::of_line(line);
            let first = separator.split(line).next().unwrap_or(b"");
            if whole.is_empty() || (is_comment && parse_number(first).is_some()) {
                continue;
            }
            if parse_number(first).is_some() {
                let columns = columns_without_header(separator.split(line).count());
                return Ok(Self { source, separator, columns, line_waits: true, at_most });
            }
            let columns: Vec<Role> =
                separator.split(line).map(|name| Role::of_name(&String::from_utf8_lossy(name))).collect();
            if [Role::X, Role::Y, Role::Z].iter().all(|role| columns.iter().filter(|c| *c == role).count() == 1) {
                return Ok(Self { source, separator, columns, line_waits: false, at_most });
            }
            if !is_comment {
                let expected = "column names with x, y and z once each (and intensity), or numbers";
                return Err(source.malformed_line("the header", quoted(line), expected));
            }
        }
    }

    /// Whether the file has the beginning of a cloud: a header, or a first line of at least three columns.
    pub(super) fn has_points(&self) -> bool {
        self.columns.len() >= 3
    }

    fn parse_line(&self) -> Result<Record, FormatError> {
        let line = self.source.line();
        let found = self.separator.split(line).count();
        if found != self.columns.len() || found < 3 {
            let expected = format!("{} as in the first line, and at least 3", self.columns.len());
            return Err(self.source.malformed_line("the number of columns", found.to_string(), &expected));
        }
        let mut record = RecordBuilder::new();
        for (&role, token) in self.columns.iter().zip(self.separator.split(line)) {
            let field = match role {
                Role::X => "x",
                Role::Y => "y",
                Role::Z => "z",
                Role::Intensity => "intensity",
                Role::Other => continue,
            };
            record.set(role, self.source.number(token, field)?);
        }
        Ok(record.build())
    }
}

fn columns_without_header(count: usize) -> Vec<Role> {
    let fourth = if count == 4 { Role::Intensity } else { Role::Other };
    let named = [Role::X, Role::Y, Role::Z, fourth];
    (0..count).map(|i| named.get(i).copied().unwrap_or(Role::Other)).collect()
}

impl RecordReader for CsvReader {
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
