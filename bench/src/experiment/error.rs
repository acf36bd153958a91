//! Why an experiment cannot be carried out.

use std::path::PathBuf;

use crate::exploration::ExplorationError;

/// Why an experiment cannot be carried out.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// An option is wrong.
    #[error("--{option}: {reason}")]
    BadOption {
        /// Its name on the command line.
        option: &'static str,
        /// What would be right.
        reason: String,
    },
    /// The folder holds an experiment with other settings.
    #[error(
        "{}: holds an experiment with other settings ({differences}); give these again to go on with it, or another \
         --out",
        path.display()
    )]
    OtherSettings {
        /// The folder.
        path: PathBuf,
        /// Field by field: what it was, what is asked for now.
        differences: String,
    },
    /// The folder holds something else.
    #[error("{}: exists and is not an experiment of mirador; give another --out", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
    },
    /// A file cannot be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// An exploration cannot be carried out.
    #[error("{run}: {source}")]
    Exploration {
        /// Which.
        run: String,
        /// Why.
        source: ExplorationError,
    },
    /// A curve or a picture cannot be drawn.
    #[error("{what} cannot be drawn: {reason}")]
    Draw {
        /// What.
        what: String,
        /// Why.
        reason: String,
    },
}

impl ExperimentError {
    /// Whether the user gave something wrong, rather than something failing on the way.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::BadOption { .. } | Self::OtherSettings { .. } | Self::NotOurs { .. })
    }
}
