//! `mirador` without a command: the built-in scene through the whole graph.

use std::path::PathBuf;

use anyhow::Result;
use mirador_acquisition::SourceKind;

use super::session::{Session, load_graph};
use crate::Registry;
use crate::cli::Common;

/// Scans the built-in scene `simple`, or what `--config` names instead.
pub fn demo(common: &Common, registry: &Registry) -> Result<u8> {
    let graph = load_graph(common, None, registry)?;
    let out = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    let title = match graph.acquisition.source {
        SourceKind::Scene => format!("Scene {}", graph.acquisition.scene),
        SourceKind::Replay => format!("Replay of {}", graph.acquisition.path.display()),
    };
    Session { common, graph, out, truth: None, title }.run()
}
