//! What a service keeps so that it goes on after a restart where it stopped.
//!
//! A checkpoint is one file, replaced in one step: after a kill it holds the state after one whole scan, never a mix.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Why a checkpoint cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file cannot be written or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The content is not a checkpoint of this version.
    #[error("{path}: not a checkpoint of this version ({reason}); remove it to start over")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Replaces the checkpoint.
///
/// # Errors
/// [`CheckpointError::Io`].
pub fn save(path: &Path, content: &[u8]) -> Result<(), CheckpointError> {
    let fail = |source| CheckpointError::Io { path: path.into(), source };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(fail)?;
    }
    let temporary = path.with_extension("new");
    fs::write(&temporary, content).map_err(fail)?;
    fs::rename(&temporary, path).map_err(fail)
}

/// Reads the checkpoint; `None` when there is none yet.
///
/// # Errors
/// [`CheckpointError::Io`].
pub fn load(path: &Path) -> Result<Option<Vec<u8>>, CheckpointError> {
    match fs::read(path) {
        Ok(content) => Ok(Some(content)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(source) => Err(CheckpointError::Io { path: path.into(), source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_comes_back_and_its_absence_is_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state").join("x.state");
        assert!(load(&path).unwrap().is_none());
        save(&path, b"one").unwrap();
        save(&path, b"two").unwrap();
        assert_eq!(load(&path).unwrap().unwrap(), b"two");
    }
}
