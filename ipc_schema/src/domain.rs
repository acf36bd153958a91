//! Which files and shared-memory segments belong to one graph.
//!
//! Several graphs run side by side on one host, each in its own domain: its own prefix under `/dev/shm` and its own
//! root folder for iceoryx2's files. Both are the current user's only: the root lies in a 0700 folder of our own.

use iceoryx2::prelude::{Config, FileName, Path as IoxPath, SemanticString};
use std::fs;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// The most characters of a domain's name and the user's number: the path of a Unix socket holds 108 bytes, both stand in it
/// twice, and iceoryx2 needs the rest (measured: with one more it opens no listener).
const MAX_NAME_AND_USER: usize = 23;

/// A domain: one graph's share of the host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    name: String,
    uid: u32,
}

/// Why a domain cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DomainError {
    /// The name has characters that cannot stand in a file name, or is too long.
    #[error("domain '{name}' is not a valid name: use 1 to {longest} of a-z, 0-9, '-' and '_'")]
    BadName {
        /// The name as given.
        name: String,
        /// The most characters it may have.
        longest: usize,
    },
    /// The folder for the domain's files exists but is open to other users, or belongs to one.
    #[error("{path} is not private to user {uid} (owner {owner}, mode {mode:o}); remove it, or give it mode 700")]
    NotPrivate {
        /// The folder.
        path: PathBuf,
        /// The current user.
        uid: u32,
        /// Its owner.
        owner: u32,
        /// Its permissions.
        mode: u32,
    },
    /// A folder or file could not be made, read or removed.
    #[error("{path}: {source}")]
    Io {
        /// What was touched.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// iceoryx2 does not accept the path.
    #[error("{path} cannot be the root of a domain: iceoryx2 refuses it ({reason})")]
    BadPath {
        /// The path.
        path: PathBuf,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// What a clean-up removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CleanupReport {
    /// Files in `/dev/shm`.
    pub segments: usize,
    /// Bytes they took.
    pub bytes: u64,
}

impl Domain {
    /// The domain of this name, for the current user.
    ///
    /// # Errors
    /// [`DomainError::BadName`].
    pub fn new(name: &str) -> Result<Self, DomainError> {
        let uid = rustix::process::getuid().as_raw();
        let longest = MAX_NAME_AND_USER - uid.to_string().len();
        let valid = (1..=longest).contains(&name.len())
            && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-' || b == b'_');
        if !valid {
            return Err(DomainError::BadName { name: name.into(), longest });
        }
        Ok(Self { name: name.into(), uid })
    }

    /// The name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Begins the name of every shared-memory file of the domain. It ends in a character no name may contain, so that
    /// no domain's prefix begins another's.
    #[must_use]
    pub fn prefix(&self) -> String {
        format!("mirador.{}.{}.", self.uid, self.name)
    }

    /// The folder that holds the domains of this user.
    #[must_use]
    pub fn parent(&self) -> PathBuf {
        PathBuf::from(format!("/tmp/mirador-{}", self.uid))
    }

    /// The folder for iceoryx2's files of this domain.
    #[must_use]
    pub fn root(&self) -> PathBuf {
        self.parent().join(&self.name)
    }

    /// Makes the folders and returns the iceoryx2 configuration of the domain. It never reads a global iceoryx2
    /// configuration file.
    ///
    /// # Errors
    /// When the folders cannot be made or are not private.
    pub fn config(&self) -> Result<Config, DomainError> {
        let parent = self.parent();
        match fs::DirBuilder::new().mode(0o700).create(&parent) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(DomainError::Io { path: parent, source: error });
            }
            _ => {}
        }
        let meta = fs::symlink_metadata(&parent).map_err(|source| io(&parent, source))?;
        let mode = meta.permissions().mode() & 0o777;
        if !meta.is_dir() || meta.uid() != self.uid || mode & 0o077 != 0 {
            return Err(DomainError::NotPrivate { path: parent, uid: self.uid, owner: meta.uid(), mode });
        }
        let root = self.root();
        fs::create_dir_all(&root).map_err(|source| io(&root, source))?;
        self.config_of_existing()
    }

    /// As [`Domain::config`], but makes nothing: for those who only look.
    ///
    /// # Errors
    /// [`DomainError::BadPath`].
    pub(crate) fn config_of_existing(&self) -> Result<Config, DomainError> {
        let root = self.root();
        let mut config = Config::default();
        let bad = |reason: String| DomainError::BadPath { path: root.clone(), reason };
        config.global.prefix = FileName::new(self.prefix().as_bytes()).map_err(|e| bad(format!("{e:?}")))?;
        let root_path = format!("{}/", root.display());
        config.global.set_root_path(&IoxPath::new(root_path.as_bytes()).map_err(|e| bad(format!("{e:?}")))?);
        Ok(config)
    }

    /// The domain's files in `/dev/shm`.
    #[must_use]
    pub fn segments(&self) -> Vec<PathBuf> {
        let prefix = self.prefix();
        let Ok(entries) = fs::read_dir(SHM) else { return Vec::new() };
        let mut files: Vec<PathBuf> = entries
            .flatten()
            .filter(|e| e.file_name().to_string_lossy().starts_with(&prefix))
            .map(|e| e.path())
            .collect();
        files.sort();
        files
    }

    /// Removes every file of the domain. Only for a domain in which nobody is alive.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub fn remove_all(&self) -> Result<CleanupReport, DomainError> {
        let mut report = CleanupReport::default();
        for path in self.segments() {
            let bytes = fs::metadata(&path).map_or(0, |m| m.blocks() * 512);
            match fs::remove_file(&path) {
                Ok(()) => {
                    report.segments += 1;
                    report.bytes += bytes;
                }
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(source) => return Err(DomainError::Io { path, source }),
            }
        }
        let root = self.root();
        match fs::remove_dir_all(&root) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(&root, error)),
            _ => Ok(report),
        }
    }

    /// The domains of the current user that have left files, dead or alive.
    #[must_use]
    pub fn existing() -> Vec<Self> {
        let uid = rustix::process::getuid().as_raw();
        let begin = format!("mirador.{uid}.");
        let mut names = std::collections::BTreeSet::new();
        for entry in fs::read_dir(SHM).into_iter().flatten().flatten() {
            let file = entry.file_name().to_string_lossy().into_owned();
            if let Some(name) = file.strip_prefix(&begin).and_then(|rest| rest.split('.').next()) {
                names.insert(name.to_owned());
            }
        }
        for entry in fs::read_dir(format!("/tmp/mirador-{uid}")).into_iter().flatten().flatten() {
            if entry.path().is_dir() {
                names.insert(entry.file_name().to_string_lossy().into_owned());
            }
        }
        names.iter().filter_map(|name| Self::new(name).ok()).collect()
    }
}

/// Where the system keeps shared memory.
pub(crate) const SHM: &str = "/dev/shm";

fn io(path: &Path, source: std::io::Error) -> DomainError {
    DomainError::Io { path: path.into(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_could_leave_its_folder_is_refused() {
        for name in ["", "a/b", "..", "A", "a.b", "a b", "0123456789012345678901234"] {
            assert!(Domain::new(name).is_err(), "{name}");
        }
        assert!(Domain::new("run-1_b").is_ok());
    }

    #[test]
    fn no_prefix_begins_another() {
        let a = Domain::new("a").unwrap().prefix();
        assert!(!Domain::new("ab").unwrap().prefix().starts_with(&a));
    }
}
