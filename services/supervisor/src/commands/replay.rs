//! `mirador replay`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use mirador_acquisition::SourceKind;

use super::session::{Session, load_graph};
use crate::cli::{Common, ReplayArgs};
use crate::graph::{Graph, GraphTable};
use crate::output_dir::MARK;
use crate::{Registry, UsageError};

/// Feeds recorded scans through the graph.
pub fn replay(common: &Common, args: &ReplayArgs, registry: &Registry) -> Result<u8> {
    let mut graph =
        if is_recording(args) { load_recorded(common, args, registry)? } else { load_graph(common, None, registry)? };
    let acquisition = &mut graph.acquisition;
    acquisition.source = SourceKind::Replay;
    acquisition.path = absolute(&args.path);
    if let Some(file) = &args.poses {
        acquisition.poses = Some(beside(&args.path, file));
    }
    if let Some(grid) = &args.grid {
        acquisition.grid = Some(grid.clone());
    }
    if let Some(range) = args.min_range {
        acquisition.range_min_m = range;
    }
    if let Some(range) = args.max_range {
        acquisition.range_max_m = range;
    }
    if let Some(speed) = args.speed {
        acquisition.speed = speed;
        graph.graph.lockstep = speed == 0.0;
    }
    if let Some(count) = args.max_scans {
        acquisition.max_scans = count;
    }
    let out = common.out.clone().unwrap_or_else(|| PathBuf::from("mirador-out"));
    let truth = args.truth.as_deref().map(|file| beside(&args.path, file));
    let title = format!("Replay of {}", name_of(&args.path));
    Session { common, graph, out, truth, title }.run()
}

fn is_recording(args: &ReplayArgs) -> bool {
    args.path.extension().is_some_and(|ending| ending == "mcap")
}

/// The graph for a recording: the configuration it was made with, which lies beside it in its output folder, so that
/// the same bits come out; `--config` and `--set` change it. Where and how fast that run ran is not taken over.
fn load_recorded(common: &Common, args: &ReplayArgs, registry: &Registry) -> Result<Graph> {
    refuse_for_recording(args)?;
    let saved = args.path.with_file_name(MARK);
    let mut graph = if common.config.is_none() && saved.is_file() {
        let place = GraphTable::default();
        let first = [
            format!("graph.domain=\"{}\"", place.domain),
            format!("graph.max_points={}", place.max_points),
            "graph.lockstep=true".to_owned(),
            "acquisition.speed=0.0".to_owned(),
        ];
        let set = first.into_iter().chain(common.set.iter().cloned()).collect();
        load_graph(&Common { set, ..common.clone() }, Some(&saved), registry)?
    } else {
        load_graph(common, None, registry)?
    };
    (graph.acquisition.poses, graph.acquisition.grid) = (None, None);
    // Whoever took the scans then is not asked again.
    let services = &mut graph.services;
    (services.simulator, services.localization, services.navigation) = (None, None, None);
    Ok(graph)
}

/// A recording is replayed bit for bit; what would change its scans is refused, not passed over.
fn refuse_for_recording(args: &ReplayArgs) -> Result<()> {
    let given = [
        ("--poses", args.poses.is_some()),
        ("--grid", args.grid.is_some()),
        ("--min-range", args.min_range.is_some()),
        ("--max-range", args.max_range.is_some()),
    ];
    match given.iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((option, _)) => Err(UsageError(format!(
            "{}: a recording has its own poses, grid and range limits; leave out {option}",
            args.path.display()
        ))
        .into()),
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// Services may run in another folder.
fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf())
}

/// A file named relative to the data: in the folder, or beside the file.
fn beside(data: &Path, file: &Path) -> PathBuf {
    let folder = if data.is_dir() { data } else { data.parent().unwrap_or(Path::new("")) };
    absolute(&folder.join(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_file_lies_in_the_folder_or_beside_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let scan = folder.path().join("a.ply");
        std::fs::write(&scan, "").unwrap();
        assert_eq!(beside(folder.path(), Path::new("p.tum")), folder.path().join("p.tum"));
        assert_eq!(beside(&scan, Path::new("p.tum")), folder.path().join("p.tum"));
        assert_eq!(beside(&scan, Path::new("/elsewhere/p.tum")), Path::new("/elsewhere/p.tum"));
    }
}
