//! `mirador up`.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::session::{Session, load_graph};
use crate::cli::Common;
use crate::{Registry, UsageError};

/// Launches a graph as written in its file.
pub fn up(common: &Common, file: &Path, registry: &Registry) -> Result<u8> {
    if common.config.is_some() {
        return Err(UsageError("`up` takes its graph file as argument; leave out --config".into()).into());
    }
    let graph = load_graph(common, Some(file), registry)?;
    let out = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    let title = file.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    Session { common, graph, out, truth: None, title }.run()
}
