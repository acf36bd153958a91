//! What can be wrong with a mesh file.

use std::fmt;

use thiserror::Error;

/// A place in a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line of a text file, from 1.
    Line(usize),
    /// Byte of a binary file, from 0.
    Byte(usize),
    /// The file as a whole.
    File,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, ", line {line}"),
            Self::Byte(byte) => write!(f, ", byte {byte}"),
            Self::File => Ok(()),
        }
    }
}

/// Why a mesh cannot be had from a file.
#[derive(Debug, Error)]
pub enum ModelError {
    /// The file is missing or not readable.
    #[error("{file}: cannot read the mesh: {source}")]
    Read {
        /// The file.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The name's ending belongs to no mesh format.
    #[error("{file}: not a known mesh format; known endings are {known}")]
    UnknownFormat {
        /// The file.
        file: String,
        /// The endings that are known.
        known: &'static str,
    },
    /// The file is not what its format says.
    #[error("{file}{at}: {reason}")]
    Malformed {
        /// The file.
        file: String,
        /// Where.
        at: Place,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The file is sound but has no face.
    #[error("{file}: has no faces; a model needs triangles or polygons")]
    Empty {
        /// The file.
        file: String,
    },
    /// A coordinate is NaN or infinite.
    #[error("{file}: vertex {vertex} (from 0) has a coordinate that is not finite")]
    NotFinite {
        /// The file.
        file: String,
        /// The first such vertex.
        vertex: usize,
    },
    /// Faces whose corners lie on a line.
    #[error("{file}: {count} of its triangles have no area, the first is triangle {first} (from 0); repair the mesh")]
    Degenerate {
        /// The file.
        file: String,
        /// How many.
        count: usize,
        /// The first of them.
        first: usize,
    },
}

/// What a reader found wrong; the file's name is added by its caller.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) at: Place,
    pub(super) reason: String,
}

impl Fault {
    pub(super) fn new(at: Place, reason: impl Into<String>) -> Self {
        Self { at, reason: reason.into() }
    }
}
