//! Why the registration benchmark could not be run.

use std::path::PathBuf;

use mirador_core::formats::{FormatError, WriteError};
use mirador_core::registration::{ConfigError, RegistryError};
use mirador_core::simulation::{CompileError, ScanError, ScannerConfigError};
use mirador_core::slam6d::pose_graph::{EdgeError, OptimiseError};
use mirador_core::slam6d::relaxation::RelaxationError;

/// Why the registration benchmark could not be run. Peers that are absent or fail are no error: they are reported and
/// left out.
#[derive(Debug, thiserror::Error)]
pub enum RegistrationBenchError {
    /// The user has stopped it.
    #[error("stopped before everything was measured")]
    Interrupted,
    /// An option is outside its range.
    #[error("option {field}: {reason}")]
    BadOption {
        /// Name of the option.
        field: &'static str,
        /// What would be right.
        reason: String,
    },
    /// A method is not known, or its settings are out of range.
    #[error(transparent)]
    Registry(#[from] RegistryError),
    /// The settings of an aligner are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A scan or pose of the data cannot be read.
    #[error(transparent)]
    Data(#[from] FormatError),
    /// A file beside the scans is not as it should be.
    #[error("{path}: {reason}")]
    BadFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A pose graph cannot be built.
    #[error(transparent)]
    Edge(#[from] EdgeError),
    /// A pose graph cannot be optimised.
    #[error(transparent)]
    Optimise(#[from] OptimiseError),
    /// Scans cannot be relaxed.
    #[error(transparent)]
    Relaxation(#[from] RelaxationError),
    /// A file for a peer cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A temporary folder cannot be made.
    #[error("a temporary folder: {reason}")]
    Temporary {
        /// What the system says.
        reason: String,
    },
    /// The simulated scene cannot be built.
    #[error(transparent)]
    Scene(#[from] CompileError),
    /// The simulated scanner cannot be built.
    #[error(transparent)]
    Scanner(#[from] ScannerConfigError),
    /// A simulated scan cannot be taken.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A plot of the page cannot be drawn.
    #[error("the plot '{what}' cannot be drawn: {reason}")]
    Draw {
        /// Which plot.
        what: String,
        /// What the library said.
        reason: String,
    },
    /// There was nothing to measure.
    #[error("nothing was measured: {reason}")]
    NothingMeasured {
        /// Why not.
        reason: String,
    },
}

impl RegistrationBenchError {
    pub(super) fn temporary(error: &std::io::Error) -> Self {
        Self::Temporary { reason: error.to_string() }
    }
}
