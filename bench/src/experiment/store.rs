//! The folder of an experiment: `settings.json`, and one file a finished run in `runs/`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{ExperimentError, Settings};

const SETTINGS: &str = "settings.json";

/// The folder of an experiment.
pub(super) struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens a folder that is empty or absent, or that holds an experiment of the same settings.
    pub fn open(folder: &Path, settings: &Settings) -> Result<Self, ExperimentError> {
        let store = Self { folder: folder.to_owned() };
        let kept: Option<Settings> = store.read(SETTINGS)?;
        match kept {
            Some(kept) => {
                if let Some(differences) = settings.differences(&kept) {
                    return Err(ExperimentError::OtherSettings { path: folder.to_owned(), differences });
                }
            }
            None => {
                let is_free = !folder.exists()
                    || folder.is_dir() && fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
                if !is_free {
                    return Err(ExperimentError::NotOurs { path: folder.to_owned() });
                }
                let runs = folder.join("runs");
                fs::create_dir_all(&runs).map_err(|e| failure(&runs, &e))?;
                store.write(SETTINGS, settings)?;
            }
        }
        Ok(store)
    }

    /// Reads a file of the folder; `None` when there is none.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, ExperimentError> {
        let path = self.folder.join(name);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            // A file where the folder should be holds no settings.
            Err(e) if e.kind() == std::io::ErrorKind::NotADirectory => return Ok(None),
            Err(e) => return Err(failure(&path, &e)),
        };
        let parsed = serde_json::from_str(&text);
        parsed.map(Some).map_err(|e| ExperimentError::File {
            path,
            reason: format!("cannot be understood ({e}); remove it to have it made again"),
        })
    }

    /// Reads a file as it is; `None` when there is none.
    pub fn bytes(&self, name: &str) -> Option<Vec<u8>> {
        fs::read(self.folder.join(name)).ok()
    }

    /// Writes a file as JSON; it is there as a whole, or not at all.
    pub fn write<T: Serialize>(&self, name: &str, value: &T) -> Result<(), ExperimentError> {
        let json = serde_json::to_vec(value).map_err(|e| failure(&self.folder.join(name), &e))?;
        self.write_bytes(name, &json)
    }

    /// Writes a file; it is there as a whole, or not at all.
    pub fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), ExperimentError> {
        let path = self.folder.join(name);
        let folder = path.parent().unwrap_or(&self.folder);
        let write = || -> std::io::Result<()> {
            let mut file = tempfile::Builder::new().prefix(".unfinished-").tempfile_in(folder)?;
            file.write_all(bytes)?;
            file.as_file().sync_all()?;
            // As readable as files usually are; a temporary one is its owner's alone.
            fs::set_permissions(file.path(), std::os::unix::fs::PermissionsExt::from_mode(0o644))?;
            file.persist(&path).map_err(|e| e.error)?;
            Ok(())
        };
        write().map_err(|e| failure(&path, &e))
    }
}

fn failure(path: &Path, error: &dyn std::fmt::Display) -> ExperimentError {
    ExperimentError::File { path: path.to_owned(), reason: error.to_string() }
}
