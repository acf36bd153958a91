//! Where tests find recorded scans.

use std::env;
use std::io::Write;
use std::path::PathBuf;

/// The folder `name` of the shared data, or `None` after saying that `test` is skipped: on standard error itself, since
/// the test runner keeps what a passing test prints to itself. With `MIRADOR_DATA_REQUIRED=1` absence is a failure.
pub(crate) fn data(test: &str, name: &str) -> Option<PathBuf> {
    let root = env::var_os("MIRADOR_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")), PathBuf::from);
    let folder = root.join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(env::var("MIRADOR_DATA_REQUIRED").as_deref() != Ok("1"), "{test}: no data at {}", folder.display());
    let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: no data at {}", folder.display());
    None
}
