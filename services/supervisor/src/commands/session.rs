//! From a graph to finished outputs: what `replay`, `up` and the demonstration have in common.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use mirador_acquisition::{AcquisitionConfig, SourceKind, open_source, scene_of, true_poses};
use mirador_core::formats::read_poses;
use mirador_core::geometry::Pose;
use mirador_core::simulation::{CompiledScene, ReachConfig, reachable_cells};
use mirador_core::view_planning::WorkArea;
use mirador_ipc_schema::StopSignal;
use mirador_recorder::{RUN_FILE, RunReader};

use super::robot_world;
use crate::cli::Common;
use crate::graph::{self, Graph};
use crate::output_dir::{self, MARK};
use crate::outputs::{self, OutputError, RunData, RunFacts, Summary};
use crate::supervise::{Ended, RunOutcome, RunPlan, Seat, check_slots, run};
use crate::{EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, Registry, UsageError};

/// Loads the graph of a command: the named file, else `--config`, else the standard one; then the overrides.
pub fn load_graph(common: &Common, file: Option<&Path>, registry: &Registry) -> Result<Graph> {
    load(common, file, graph::STANDARD, registry)
}

/// Loads the graph of a command that has one of its own, unless `--config` names another; then the overrides.
pub fn load_graph_or(common: &Common, own: &str, registry: &Registry) -> Result<Graph> {
    load(common, None, own, registry)
}

fn load(common: &Common, file: Option<&Path>, built_in: &str, registry: &Registry) -> Result<Graph> {
    let mut settings = common.set.clone();
    if let Some(domain) = &common.domain {
        settings.push(format!("graph.domain=\"{domain}\""));
    }
    if common.live {
        settings.push("services.gateway.threads=1".to_owned());
    }
    let loaded = match file.or(common.config.as_deref()) {
        Some(path) => graph::load(path, &settings, registry),
        None => graph::load_text(built_in, "the built-in graph", &settings, registry),
    };
    loaded.map_err(|e| UsageError(e.to_string()).into())
}

/// One run from start to outputs.
pub struct Session<'a> {
    /// Options of the command line.
    pub common: &'a Common,
    /// The graph.
    pub graph: Graph,
    /// The output folder.
    pub out: PathBuf,
    /// A file with the true poses.
    pub truth: Option<PathBuf>,
    /// Heading of the report.
    pub title: String,
}

/// What is known before the first scan.
#[derive(Default)]
struct Known {
    truth: Option<BTreeMap<u32, Pose>>,
    truth_cells: Option<Vec<[f64; 2]>>,
    scene: Option<Arc<CompiledScene>>,
    robot_from_scanner: Option<Pose>,
}

impl Session<'_> {
    /// Runs the graph and writes the outputs.
    pub fn run(mut self) -> Result<u8> {
        let known = self.prepare()?;
        let (run_dir, config, outcome) = self.go()?;
        self.finish(&run_dir, config, known, &outcome)
    }

    /// Runs the graph and reads what was recorded, without any outputs.
    pub fn record(mut self) -> Result<RunData> {
        self.prepare()?;
        let (run_dir, _, outcome) = self.go()?;
        match outcome.ended {
            Ended::InputEnded => Ok(RunData::read(&mut RunReader::open(&run_dir.join(RUN_FILE))?)?),
            Ended::Interrupted => bail!("interrupted"),
            Ended::Fault(reason) => bail!("{reason}"),
        }
    }

    /// Runs the prepared graph; gives the run's folder and the configuration in effect, too.
    fn go(&self) -> Result<(PathBuf, String, RunOutcome)> {
        let stop = StopSignal::from_terminal().context("signals cannot be handled")?;
        // Before the output folder: an earlier output, perhaps of a graph that runs, stays where it is when this fails.
        let seat = Seat::take(&self.graph, &stop)?;
        let run_dir = output_dir::prepare(&self.out)?;
        let config = self.save_config(&run_dir)?;
        let plan = RunPlan {
            graph: self.graph.clone(),
            common: self.service_arguments(&run_dir),
            run_dir: run_dir.clone(),
            quiet: self.common.quiet,
            stop,
        };
        let outcome = run(&plan, seat)?;
        Ok((run_dir, config, outcome))
    }

    /// Everything that can be found wrong before a process is started: the source, its size, the truth.
    fn prepare(&mut self) -> Result<Known> {
        let usage = |e: &dyn std::fmt::Display| UsageError(e.to_string());
        if self.graph.services.entries().is_empty() && self.graph.programs.is_empty() {
            let message = "the graph runs nothing: write a table for every service, for example [services.acquisition]";
            return Err(usage(&message).into());
        }
        if self.graph.alignment.is_external()
            && let Some(entry) = self.graph.programs.get_mut(&self.graph.alignment.external.program)
        {
            // Without it alignment goes on by its fallback method.
            entry.optional = true;
        }
        if let Some(gateway) = &mut self.graph.services.gateway {
            gateway.optional = true;
        }
        let known = match self.graph.acquisition.source {
            SourceKind::Robot => self.prepare_robot()?,
            SourceKind::Scene | SourceKind::Replay => self.prepare_source()?,
        };
        let services = self.graph.services.entries();
        // The robot's own services go by its time, not by scans; and nobody waits for viewers.
        let by_scan =
            |name: &&str| !["simulator", "acquisition", "localization", "navigation", "gateway"].contains(name);
        let names = services.iter().map(|(name, _)| *name).filter(by_scan);
        self.graph.acquisition.lockstep_with = names.map(str::to_owned).collect();
        if self.graph.graph.lockstep && self.graph.acquisition.speed > 0.0 {
            return Err(
                UsageError("graph.lockstep and acquisition.speed exclude each other: set one of them".into()).into()
            );
        }
        if !self.graph.graph.lockstep && self.graph.acquisition.speed == 0.0 {
            self.graph.acquisition.speed = 1.0;
        }
        if !self.graph.graph.lockstep {
            self.graph.planning.corrections.before_next_scan = false;
        }
        if self.graph.services.planning.is_none() {
            self.graph.recorder.acknowledge_after.retain(|topic| topic != "view_plan");
            self.graph.alignment.correct_after_plan = false;
        }
        if self.graph.services.alignment.as_ref().is_none_or(|entry| !entry.command.is_empty()) {
            // An alignment of the user's own need not close loops, and if it does, need not tell.
            self.graph.recorder.acknowledge_after.retain(|topic| topic != "loop_closing");
            self.graph.planning.corrections.awaited = false;
            self.graph.navigation.await_corrections = false;
        }
        Ok(known)
    }

    /// A source that knows its scans before the first one.
    fn prepare_source(&mut self) -> Result<Known> {
        let usage = |e: &dyn std::fmt::Display| UsageError(e.to_string());
        self.fill_in_from_scene()?;
        let config = &self.graph.acquisition;
        let source = open_source(config, 1).map_err(|e| usage(&e))?;
        let (scans, largest) = (source.scans(), source.largest_scan());
        self.size_slots(largest)?;
        let config = &self.graph.acquisition;
        match (&self.truth, config.source) {
            (Some(file), _) => Ok(Known { truth: Some(truth_from(file, scans, config)?), ..Known::default() }),
            (None, SourceKind::Scene) => truth_of_scene(config).map_err(|e| usage(&e).into()),
            (None, _) => Ok(Known::default()),
        }
    }

    /// A robot takes scans as it goes. Of a simulated one the world is known.
    fn prepare_robot(&mut self) -> Result<Known> {
        if self.graph.services.simulator.is_none() {
            let scanner = &self.graph.acquisition.scanner;
            self.size_slots(scanner.beams * scanner.sweeps)?;
            return Ok(Known::default());
        }
        if !self.graph.graph.lockstep && self.graph.simulator.speed == 0.0 {
            self.graph.simulator.speed = 1.0;
        }
        self.graph.navigation.is_lockstep = self.graph.graph.lockstep;
        let awaited = ["acquisition", "localization", "navigation"];
        let services = self.graph.services.entries();
        let others = services.iter().map(|(name, _)| *name).filter(|name| awaited.contains(name));
        self.graph.simulator.lockstep_with = others.map(str::to_owned).collect();
        let world = robot_world::fill_in(&mut self.graph)?;
        self.size_slots(world.scan_cells)?;
        let robot_from_scanner = Some(world.robot_from_scanner);
        Ok(Known { truth: None, truth_cells: Some(world.reachable), scene: Some(world.scene), robot_from_scanner })
    }

    fn size_slots(&mut self, largest_scan: usize) -> Result<()> {
        if self.graph.graph.max_points == 0 {
            self.graph.graph.max_points = largest_scan;
        }
        check_slots(largest_scan, self.graph.graph.max_points)
    }

    /// In a scene the scanner's mount and the work area are known.
    fn fill_in_from_scene(&mut self) -> Result<()> {
        let config = &self.graph.acquisition;
        if config.source != SourceKind::Scene {
            return Ok(());
        }
        let scene = scene_of(config).map_err(|e| UsageError(e.to_string()))?;
        self.graph.analysis.scores.scanner_height_m.get_or_insert(config.scanner.height_m);
        let (x, y) = (scene.area.x_m, scene.area.y_m);
        self.graph.planning.view.work_area.get_or_insert(WorkArea { min: [x[0], y[0]], max: [x[1], y[1]] });
        Ok(())
    }

    /// Prints the configuration in effect and keeps it with the outputs.
    fn save_config(&self, run_dir: &Path) -> Result<String> {
        let text = toml::to_string(&self.graph).context("the configuration cannot be written as TOML")?;
        let path = run_dir.join(MARK);
        fs::write(&path, &text).with_context(|| format!("{}: cannot be written", path.display()))?;
        if !self.common.quiet {
            println!("# configuration in effect, saved as {}\n{text}", path.display());
            if self.graph.services.gateway.is_some() {
                println!("live at ws://127.0.0.1:{}: open it in Foxglove", self.graph.gateway.port);
            }
        }
        Ok(text)
    }

    fn service_arguments(&self, run_dir: &Path) -> Vec<String> {
        let path = |p: PathBuf| p.to_string_lossy().into_owned();
        [
            "--config",
            &path(run_dir.join(MARK)),
            "--out",
            &path(run_dir.to_path_buf()),
            "--log-level",
            &self.common.log_level,
            "--log-format",
            self.common.log_format.word(),
        ]
        .map(str::to_owned)
        .to_vec()
    }

    fn finish(&self, run_dir: &Path, config: String, known: Known, outcome: &RunOutcome) -> Result<u8> {
        let facts = RunFacts {
            title: self.title.clone(),
            truth: known.truth,
            truth_cells: known.truth_cells,
            scene: known.scene,
            robot_from_scanner: known.robot_from_scanner,
            restarts: outcome.restarts,
            registration: outcome.registration.clone(),
            services: outcome.services.clone(),
            interrupted: outcome.ended == Ended::Interrupted,
            fault: match &outcome.ended {
                Ended::Fault(reason) => Some(reason.clone()),
                Ended::InputEnded | Ended::Interrupted => None,
            },
            wall_time: outcome.wall,
            config,
        };
        let written = match self.graph.services.recorder {
            None => None,
            Some(_) => match outputs::write_all(run_dir, &facts) {
                // Stopped before anything was recorded: that is what the user wanted, not an error.
                Err(OutputError::Read(error)) if facts.interrupted && error.is_nothing_recorded() => None,
                written => Some(written.context("the outputs cannot be written")),
            },
        };
        // A fault of the graph is the cause; outputs that then cannot be made are only its consequence.
        if let Ended::Fault(reason) = &outcome.ended {
            eprintln!("error: {reason}");
            match written {
                Some(Err(error)) => tracing::warn!("{error:#}"),
                _ => eprintln!("what was received before is in {}", run_dir.display()),
            }
            return Ok(EXIT_FAILED);
        }
        if let Some(summary) = written.transpose()?
            && !self.common.quiet
        {
            print_summary(&summary, run_dir, outcome);
        }
        Ok(if outcome.ended == Ended::Interrupted { EXIT_INTERRUPTED } else { EXIT_DONE })
    }
}

/// True poses from a file, one per scan of the source.
fn truth_from(file: &Path, scans: usize, config: &AcquisitionConfig) -> Result<BTreeMap<u32, Pose>> {
    let poses = read_poses(file).map_err(|e| UsageError(e.to_string()))?;
    let limited = config.max_scans > 0;
    if poses.len() != scans && !(limited && poses.len() > scans) {
        let message =
            format!("{}: {} true poses for {scans} scans; it needs one line per scan", file.display(), poses.len());
        return Err(UsageError(message).into());
    }
    Ok((0..).zip(poses.iter().take(scans).map(|p| p.map_from_scanner)).collect())
}

/// The true poses of a scene's tour, and the cells the robot can reach in it.
fn truth_of_scene(config: &AcquisitionConfig) -> Result<Known> {
    let poses = true_poses(config)?;
    let scene = CompiledScene::new(scene_of(config)?)?;
    let start = scene.scene().start;
    let cells = reachable_cells(&scene, &ReachConfig::default(), &start)?;
    let indices = cells.reachable.iter().enumerate().filter(|(_, reachable)| **reachable);
    let truth_cells = Some(indices.map(|(index, _)| cells.centre(index)).collect());
    let truth = Some((0..).zip(poses).collect());
    Ok(Known { truth, truth_cells, scene: Some(Arc::new(scene)), robot_from_scanner: None })
}

fn print_summary(summary: &Summary, run_dir: &Path, outcome: &RunOutcome) {
    println!(
        "{} scans, {} aligned, {} not aligned, {} points, {:.1} s",
        summary.scans,
        summary.aligned,
        summary.unaligned,
        summary.points,
        outcome.wall.as_secs_f64()
    );
    if let Some(errors) = &summary.errors {
        println!("error against the truth: {:.3} m, {:.3} deg rmse", errors.ate_rmse_m, errors.ate_rmse_deg);
    }
    if let Some(registration) = &summary.registration {
        println!("{registration}");
    }
    println!("results: {} (open report.html)", run_dir.display());
}
