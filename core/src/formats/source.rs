//! Bytes of a plain or gzipped file, counted, and cut into lines for the text formats.

use super::{
    cloud_format::file_name,
    error::{At, FormatError},
};
use flate2::bufread::MultiGzDecoder;
use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

/// The longest line of a text format; a longer one means that the file is not text.
const LONGEST_LINE: usize = 1 << 20;

/// Deflate packs at most 1032 bytes into one (258 bytes by a code of two bits).
const DEFLATE_LIMIT: u64 = 1032;

/// A file being read from front to back.
pub(super) struct Source {
    path: PathBuf,
    input: Box<dyn BufRead + Send>,
    /// Bytes taken so far, after unpacking.
    consumed: u64,
    /// What the whole file can hold at most, after unpacking; exact for plain files.
    capacity: u64,
    packed: bool,
    line: Vec<u8>,
    line_number: u64,
}

impl Source {
    /// Opens a file; one that ends in `.gz` is unpacked on the way.
    pub(super) fn open(path: &Path) -> Result<Self, FormatError> {
        let fail = |e| FormatError::io(path, e);
        let file = File::open(path).map_err(fail)?;
        let metadata = file.metadata().map_err(fail)?;
        if metadata.is_dir() {
            return Err(fail(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder, not a file")));
        }
        let packed = file_name(path).ends_with(".gz");
        let plain = BufReader::with_capacity(1 << 16, file);
        let (input, capacity): (Box<dyn BufRead + Send>, u64) = if packed {
            let unpacked = BufReader::with_capacity(1 << 16, MultiGzDecoder::new(plain));
            (Box::new(unpacked), metadata.len().saturating_mul(DEFLATE_LIMIT))
        } else {
            (Box::new(plain), metadata.len())
        };
        Ok(Self { path: path.to_path_buf(), input, consumed: 0, capacity, packed, line: Vec::new(), line_number: 0 })
    }

    /// The file's path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file is gzipped, so that its size is only bounded.
    pub(super) fn is_packed(&self) -> bool {
        self.packed
    }

    /// Bytes taken so far.
    pub(super) fn consumed(&self) -> u64 {
        self.consumed
    }

    /// What is still to come: exact for a plain file, an upper bound for a gzipped one.
    pub(super) fn remaining_at_most(&self) -> u64 {
        self.capacity.saturating_sub(self.consumed)
    }

    /// Refuses a count from a header that the rest of the file cannot hold at `bytes_each` or more.
    pub(super) fn check_holds(&self, count: usize, bytes_each: usize, what: &str) -> Result<(), FormatError> {
        // The last record of a text file needs no end of line, hence the one byte more.
        let needed = (count as u128) * (bytes_each as u128);
        let room = u128::from(self.remaining_at_most()) + 1;
        if needed > room {
            let expected =
                format!("{count} {what} need {needed} bytes after the header, at most {} are there", room - 1);
            return Err(self.truncated(expected));
        }
        Ok(())
    }

    /// Fills as much of `buffer` as the file has and returns how much that is.
    pub(super) fn read_up_to(&mut self, buffer: &mut [u8]) -> Result<usize, FormatError> {
        let mut filled = 0;
        while let Some(rest) = buffer.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            match self.input.read(rest) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.broken(e)),
            }
        }
        self.consumed += filled as u64;
        Ok(filled)
    }

    /// Fills `buffer`; an early end is an error that says what should be there.
    pub(super) fn read_exact(&mut self, buffer: &mut [u8], what: &str) -> Result<(), FormatError> {
        let filled = self.read_up_to(buffer)?;
        if filled < buffer.len() {
            return Err(self.truncated(format!("{what} takes {} bytes, {filled} are left", buffer.len())));
        }
        Ok(())
    }

    /// Passes over `count` bytes without keeping them.
    pub(super) fn skip(&mut self, count: u64, what: &str) -> Result<(), FormatError> {
        let skipped = match io::copy(&mut self.input.by_ref().take(count), &mut io::sink()) {
            Ok(skipped) => skipped,
            Err(e) => return Err(self.broken(e)),
        };
        self.consumed += skipped;
        if skipped < count {
            return Err(self.truncated(format!("{what} takes {count} bytes, {skipped} are left")));
        }
        Ok(())
    }

    /// Takes the next line, without its end, into [`Source::line`]; `false` at the end of the file.
    pub(super) fn next_line(&mut self) -> Result<bool, FormatError> {
        self.line.clear();
        let mut limited = self.input.by_ref().take(LONGEST_LINE as u64);
        let taken = match limited.read_until(b'\n', &mut self.line) {
            Ok(taken) => taken,
            Err(e) => return Err(self.broken(e)),
        };
        if taken == 0 {
            return Ok(false);
        }
        self.consumed += taken as u64;
        self.line_number += 1;
        if taken == LONGEST_LINE && self.line.last() != Some(&b'\n') {
            return Err(self.malformed_line("the line", "longer than a mebibyte".into(), "a short line of text"));
        }
        while matches!(self.line.last(), Some(b'\n' | b'\r')) {
            self.line.pop();
        }
        Ok(true)
    }

    /// Takes the next line that is neither blank nor a comment (`#`).
    pub(super) fn next_data_line(&mut self) -> Result<bool, FormatError> {
        while self.next_line()? {
            let text = self.line.trim_ascii();
            if !text.is_empty() && !text.starts_with(b"#") {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The number of the line taken last, from 1.
    pub(super) fn line_number(&self) -> u64 {
        self.line_number
    }

    /// The line taken last, without leading and trailing blanks.
    pub(super) fn line(&self) -> &[u8] {
        self.line.trim_ascii()
    }

    /// The line taken last, as text; bytes that are not UTF-8 are replaced (only headers are read this way).
    pub(super) fn line_text(&self) -> String {
        String::from_utf8_lossy(self.line()).into_owned()
    }

    /// The values of the line taken last, separated by blanks.
    pub(super) fn tokens(&self) -> impl Iterator<Item = &[u8]> {
        self.line.split(u8::is_ascii_whitespace).filter(|token| !token.is_empty())
    }

    /// The number of lines still to come that are neither blank nor a comment.
    pub(super) fn count_data_lines(&mut self) -> Result<usize, FormatError> {
        let mut lines = 0;
        while self.next_data_line()? {
            lines += 1;
        }
        Ok(lines)
    }

    /// A value of the line taken last as a number.
    pub(super) fn number(&self, token: &[u8], field: &'static str) -> Result<f64, FormatError> {
        parse_number(token).ok_or_else(|| self.malformed_line(field, quoted(token), "a number"))
    }

    /// An error about the line taken last.
    pub(super) fn malformed_line(&self, field: &'static str, found: String, expected: &str) -> FormatError {
        let at = At::Line(self.line_number);
        FormatError::Malformed { path: self.path.clone(), at, field, found, expected: expected.into() }
    }

    /// An early end, here.
    pub(super) fn truncated(&self, expected: String) -> FormatError {
        FormatError::Truncated { path: self.path.clone(), at: At::Byte(self.consumed), expected }
    }

    fn broken(&self, error: io::Error) -> FormatError {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => self.truncated("the gzip stream is not finished".into()),
            _ => FormatError::io(&self.path, error),
        }
    }
}

/// A number in text, `nan` and `inf` among them.
pub(super) fn parse_number(token: &[u8]) -> Option<f64> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// A piece of a file for an error message: quoted, cut short, control characters escaped.
pub(super) fn quoted(bytes: &[u8]) -> String {
    let shown = bytes.get(..40).unwrap_or(bytes);
    let cut = if shown.len() < bytes.len() { "..." } else { "" };
    format!("\"{}{cut}\"", String::from_utf8_lossy(shown).escape_debug())
}
