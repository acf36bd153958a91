//! The folder of a run.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::UsageError;

/// By this file a folder is known to be an earlier output of ours.
pub const MARK: &str = "config.toml";

/// Makes an empty output folder. A folder that exists is refused unless it is empty or an earlier output of ours, which
/// is then kept aside under a number.
pub fn prepare(path: &Path) -> Result<PathBuf> {
    if path.exists() {
        let is_empty = path.is_dir() && fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        if !is_empty {
            keep_aside(path)?;
        }
    }
    fs::create_dir_all(path.join("logs")).with_context(|| format!("{}: cannot be made", path.display()))?;
    fs::create_dir_all(path.join("state")).with_context(|| format!("{}: cannot be made", path.display()))?;
    fs::canonicalize(path).with_context(|| format!("{}: cannot be made", path.display()))
}

fn keep_aside(path: &Path) -> Result<()> {
    if !path.is_dir() || !path.join(MARK).is_file() {
        return Err(UsageError(format!(
            "{}: exists and is not an output of mirador; give another --out, or remove it",
            path.display()
        ))
        .into());
    }
    let name = path.file_name().map_or_else(|| "mirador-out".to_owned(), |n| n.to_string_lossy().into_owned());
    let aside = (1..).map(|n| path.with_file_name(format!("{name}.{n}"))).find(|p| !p.exists());
    let Some(aside) = aside else { return Ok(()) };
    fs::rename(path, &aside).with_context(|| format!("{}: cannot be kept aside", path.display()))?;
    tracing::info!(from = %path.display(), to = %aside.display(), "the earlier output is kept aside");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_earlier_output_is_kept_aside() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("run");
        prepare(&out).unwrap();
        fs::write(out.join(MARK), "old").unwrap();
        prepare(&out).unwrap();
        assert_eq!(fs::read_to_string(folder.path().join("run.1").join(MARK)).unwrap(), "old");
        assert!(!out.join(MARK).exists());
    }

    #[test]
    fn a_folder_of_somebody_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = prepare(folder.path()).unwrap_err();
        assert!(error.is::<UsageError>() && error.to_string().contains("--out"), "{error}");
        assert!(folder.path().join("thesis.tex").exists());
    }

    #[test]
    fn an_empty_folder_is_used() {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path()).unwrap();
        assert!(folder.path().join("logs").is_dir());
    }
}
