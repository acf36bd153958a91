//! A file that gets its name when it is complete.

use super::super::error::WriteError;
use std::{
    fs::File,
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};
use tempfile::TempPath;

/// A buffered file under a temporary name beside `path`; dropped without [`TemporaryFile::publish`] it is deleted.
pub(in crate::formats) struct TemporaryFile {
    path: PathBuf,
    out: BufWriter<File>,
    name: TempPath,
}

impl TemporaryFile {
    pub(in crate::formats) fn create(path: &Path) -> Result<Self, WriteError> {
        let (file, name) = create_beside(path)?;
        Ok(Self { path: path.to_path_buf(), out: BufWriter::with_capacity(1 << 16, file), name })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(in crate::formats) fn write(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.out.write_all(bytes).map_err(|e| WriteError::io(&self.path, e))
    }

    /// Overwrites bytes that are already there.
    pub(super) fn patch(&mut self, offset: u64, bytes: &[u8]) -> Result<(), WriteError> {
        let mut patch = || {
            self.out.seek(SeekFrom::Start(offset))?;
            self.out.write_all(bytes)
        };
        patch().map_err(|e| WriteError::io(&self.path, e))
    }

    /// Brings everything to the disk and gives the file its name.
    pub(in crate::formats) fn publish(self) -> Result<(), WriteError> {
        let Self { path, out, name } = self;
        let file = out.into_inner().map_err(|e| WriteError::io(&path, e.into_error()))?;
        publish(&path, &file, name)
    }
}

/// An empty file beside `path`, with the rights that the user gives to new files.
pub(super) fn create_beside(path: &Path) -> Result<(File, TempPath), WriteError> {
    let fail = |e| WriteError::io(path, e);
    if path.is_dir() {
        return Err(fail(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder")));
    }
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".unfinished-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map(tempfile::NamedTempFile::into_parts).map_err(fail)
}

/// Gives a complete file its name; after a power cut there is the whole file or none.
pub(super) fn publish(path: &Path, file: &File, name: TempPath) -> Result<(), WriteError> {
    file.sync_data().map_err(|e| WriteError::io(path, e))?;
    name.persist(path).map_err(|e| WriteError::io(path, e.error))
}

/// A region of a header that keeps its length when the numbers in it change: `lead`, padding, a line break and `lines`.
/// The lead begins a comment of the format, so that readers pass over the padding.
pub(super) fn padded_region(lead: &str, lines: &str, length: usize) -> String {
    let padding = length.saturating_sub(lead.len() + 1 + lines.len());
    format!("{lead}{}\n{lines}", " ".repeat(padding))
}
