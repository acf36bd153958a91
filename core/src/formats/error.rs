//! What can be wrong with a file, said so that it can be put right.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum At {
    /// Line of a text file, from 1.
    Line(u64),
    /// Byte offset in the (unpacked) file, from 0.
    Byte(u64),
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why scans or poses could not be read.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// There is nothing at the path.
    #[error("{path}: no such file or folder; check the spelling, relative paths start at the current folder")]
    Missing {
        /// The path asked for.
        path: PathBuf,
    },
    /// The system refused to read (permissions, a broken disk, a gzip stream with wrong bits).
    #[error("{path}: cannot be read: {source}; check that you may read it and that the copy is complete")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's own reason.
        source: io::Error,
    },
    /// The name's ending belongs to no cloud format.
    #[error("{path}: not a known cloud format; known endings are {known}, each also with .gz after it")]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// The endings that are known.
        known: &'static str,
    },
    /// The file is whole but holds no return.
    #[error("{path}: holds no point with a finite position; leave the file out or record it again")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file ends before what its header or its record size promises.
    #[error("{path}: ends too early at {at}: {expected}; the copy is incomplete or the count is wrong")]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Where it ends or where the promise is made.
        at: At,
        /// What should be there.
        expected: String,
    },
    /// A value is not what the format says.
    #[error("{path}, {at}: {field} is {found}; it should be {expected}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where.
        at: At,
        /// Which field.
        field: &'static str,
        /// What stands there.
        found: String,
        /// What would be right.
        expected: String,
    },
    /// The LAS or LAZ decoder refused the file.
    #[error(
        "{path}: not a readable LAS/LAZ file near point {point}: {reason}; rewrite it with a LAS tool or copy it again"
    )]
    Las {
        /// The file.
        path: PathBuf,
        /// How many points were read before.
        point: u64,
        /// The decoder's reason.
        reason: String,
    },
    /// A folder without clouds.
    #[error("{path}: no scans in this folder; expected files ending in {known}, each also with .gz after it")]
    NoScans {
        /// The folder.
        path: PathBuf,
        /// The endings that are known.
        known: &'static str,
    },
    /// A folder with clouds of two formats: which one is meant?
    #[error("{path}: scans of two formats, {first} and {second}; keep one format per folder")]
    TwoFormats {
        /// The folder.
        path: PathBuf,
        /// A file of the one format.
        first: String,
        /// A file of the other format.
        second: String,
    },
    /// The same scan twice, plain and packed.
    #[error("{path}: {first} and {second} would be the same scan twice; remove one of them")]
    SameScanTwice {
        /// The folder.
        path: PathBuf,
        /// The one file.
        first: String,
        /// The other file.
        second: String,
    },
    /// No pose in a pose file or folder.
    #[error("{path}: no poses; expected TUM lines (8 numbers), KITTI lines (12 numbers) or 3DTK .pose files")]
    NoPoses {
        /// The file or folder.
        path: PathBuf,
    },
}

impl FormatError {
    /// An input/output error with its file; a missing file gets its own variant, an early end of packed data too.
    pub(super) fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::NotFound => Self::Missing { path },
            _ => Self::Io { path, source },
        }
    }
}

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The system refused to write (permissions, a full disk).
    #[error("{path}: cannot be written: {source}; check the folder, your rights and the free space")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's own reason.
        source: io::Error,
    },
    /// The name's ending belongs to no format that can be written.
    #[error("{path}: not a format that can be written; known endings are {known}")]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// The endings that are known.
        known: &'static str,
    },
    /// The points do not fill the grid that was announced.
    #[error("{path}: {points} points do not fill a grid of {rows} x {cols} cells; give the grid the scan really has")]
    GridMismatch {
        /// The file.
        path: PathBuf,
        /// Points written.
        points: u64,
        /// Rows announced.
        rows: usize,
        /// Columns announced.
        cols: usize,
    },
    /// The LAS or LAZ encoder refused.
    #[error("{path}: LAS/LAZ encoder: {reason}; coordinates must lie within 200 km of the origin")]
    Las {
        /// The file.
        path: PathBuf,
        /// The encoder's reason.
        reason: String,
    },
}

impl WriteError {
    /// An input/output error with its file.
    pub(super) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }
}
