//! `mirador tour`: a world scanned from the poses its file lists.

use std::path::PathBuf;

use anyhow::Result;
use mirador_acquisition::SourceKind;

use super::session::{Session, load_graph};
use crate::cli::Common;
use crate::{Registry, UsageError};

/// Scans a world through the standard graph, or through what `--config` names instead.
pub fn tour(common: &Common, world: Option<String>, registry: &Registry) -> Result<u8> {
    let mut graph = load_graph(common, None, registry)?;
    if let Some(world) = world {
        graph.acquisition.scene = world;
        graph.acquisition.source = SourceKind::Scene;
    }
    let title = match graph.acquisition.source {
        SourceKind::Scene => format!("Scene {}", graph.acquisition.scene),
        SourceKind::Replay => format!("Replay of {}", graph.acquisition.path.display()),
        SourceKind::Robot => {
            return Err(UsageError("a robot drives in this graph: launch it with `mirador up`".into()).into());
        }
    };
    let out = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    Session { common, graph, out, truth: None, title }.run()
}
