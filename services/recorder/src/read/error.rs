//! Why a recording cannot be read.

use std::io;
use std::path::PathBuf;

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read the recording '{path}': {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file does not begin like an MCAP file.
    #[error("'{path}' is not an MCAP file")]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The file ends before its first chunk is complete, so nothing was recorded.
    #[error("the recording '{path}' holds nothing: it ends before its first chunk is complete")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// An MCAP file of another program.
    #[error(
        "'{path}' is an MCAP file (profile '{profile}') but not a recording of mirador: it has no channel 'mirador/...'. Its channels: {channels}"
    )]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// Profile in its header; `ros2` for a ROS 2 bag.
        profile: String,
        /// Its channels.
        channels: String,
    },
    /// A message was recorded by a build with another layout.
    #[error(
        "'{path}' was recorded with another layout of topic '{topic}'; read it with the version of mirador that wrote it.\n  recorded: {recorded}\n  this build: {current}"
    )]
    Layout {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Description in the file.
        recorded: String,
        /// Description of this build.
        current: String,
    },
    /// Bytes of the file have changed since they were written.
    #[error("the recording '{path}' is damaged at byte {offset}: {what}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        offset: u64,
        /// What does not fit.
        what: &'static str,
    },
    /// The recording has no such scan.
    #[error("'{path}' has no scan {scan}; it has {present}")]
    NoScan {
        /// The file.
        path: PathBuf,
        /// The scan asked for.
        scan: u32,
        /// Which scans it has, in words.
        present: String,
    },
}

impl ReadError {
    /// Whether there is no recording yet, or none with anything in it.
    #[must_use]
    pub fn is_nothing_recorded(&self) -> bool {
        match self {
            Self::Empty { .. } => true,
            Self::Io { source, .. } => source.kind() == io::ErrorKind::NotFound,
            _ => false,
        }
    }
}
