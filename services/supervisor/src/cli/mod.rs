//! The command line.

mod bench;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use tracing_subscriber::EnvFilter;

pub use bench::{
    AllPairsArgs, BenchCommand, BenchCompareArgs, BenchIpcArgs, BenchPipelineArgs, BenchPlanningArgs,
    BenchRegistrationArgs,
};

/// From raw 3D laser scans to where the robot should look next.
///
/// Without a command a simulated robot explores the built-in world `simple` through the whole process graph, until the model
/// is complete; results go to ./mirador-out/.
#[derive(Debug, Parser)]
#[command(name = "mirador", version, max_term_width = 110)]
pub struct Cli {
    /// Options of every command.
    #[command(flatten)]
    pub common: Common,
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

impl Cli {
    /// Parses the command line.
    ///
    /// # Errors
    /// clap's, and one of ours: of `--set` before and behind a command clap keeps only those behind it.
    pub fn read<I: IntoIterator<Item = OsString>>(arguments: I) -> Result<Self, clap::Error> {
        let arguments: Vec<OsString> = arguments.into_iter().collect();
        let cli = Self::try_parse_from(&arguments)?;
        let given = arguments.iter().filter_map(|argument| argument.to_str());
        let given = given.take_while(|argument| *argument != "--").filter(|a| *a == "--set" || a.starts_with("--set="));
        if given.count() > cli.common.set.len() {
            let message = "--set stands before the command and behind it: write all of them behind the command\n";
            return Err(Self::command().error(clap::error::ErrorKind::ArgumentConflict, message));
        }
        Ok(cli)
    }
}

/// Options of every command.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Folder for the results [default: mirador-out]; an earlier output of ours is kept aside.
    #[arg(long, global = true, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Graph file to use instead of the built-in one.
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Overrides one key of the graph file, for example alignment.registration=point_to_point.
    #[arg(long, global = true, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Name of the graph on this host; graphs of different domains do not see each other.
    #[arg(long, global = true, value_name = "NAME")]
    pub domain: Option<String>,
    /// Show the run live in viewers while it goes on: Foxglove at ws://127.0.0.1:8765 (gateway.port).
    #[arg(long, global = true)]
    pub live: bool,
    /// Processor cores the graph may use, for example 0,1 [default: all].
    #[arg(long, global = true, value_name = "LIST", value_delimiter = ',')]
    pub cores: Vec<usize>,
    /// How much is logged: error, warn, info, debug or trace, or a filter such as `warn,mirador_alignment=debug`.
    #[arg(long, global = true, value_name = "LEVEL", default_value = "warn")]
    pub log_level: String,
    /// How it is logged.
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
    /// Print neither the configuration nor progress.
    #[arg(long, short, global = true)]
    pub quiet: bool,
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

impl LogFormat {
    /// The word on the command line.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Json => "json",
        }
    }
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Explore a simulated world: the robot decides, drives and scans until the model is complete.
    Explore(ExploreArgs),
    /// Scan a world from the poses that its file lists, without a robot that drives there.
    Tour {
        /// Name of a built-in world, or a world file [default: that of acquisition.scene].
        world: Option<String>,
    },
    /// Feed recorded scans through the graph: a folder or file of scans, or a run.mcap of ours.
    Replay(ReplayArgs),
    /// Launch a process graph as written in a file.
    Up {
        /// The graph file.
        #[arg(value_name = "GRAPH.toml")]
        graph: PathBuf,
    },
    /// Run one service in the foreground.
    Run(RunArgs),
    /// Live table of the services of a graph: state, restarts, memory, progress.
    Top {
        /// Print the table once and end.
        #[arg(long)]
        once: bool,
        /// Print JSON instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Ask a running graph to decide again on the map it has: with other weights, or by another strategy. The plan goes
    /// out to everyone as after a scan, and is printed here.
    Replan(ReplanArgs),
    /// Measure.
    Bench {
        /// What to measure.
        #[command(subcommand)]
        what: BenchCommand,
    },
    /// Say why each decision of a run was taken.
    Explain {
        /// Output folder of the run.
        dir: PathBuf,
        /// Only this scan.
        scan: Option<u32>,
    },
    /// Convert between file formats, streaming.
    Convert {
        /// A cloud (.3d .pcd .ply .las .laz .bin .xyz32.bin .csv .vtk, each also .gz) or a pose file (.tum, .txt).
        input: PathBuf,
        /// A cloud (.ply .las .laz .pcd .xyz32.bin) or a pose file (.tum).
        output: PathBuf,
        /// Order of the points, for example 226x360.
        #[arg(long, value_name = "ROWSxCOLS")]
        grid: Option<String>,
    },
    /// What on this machine would get in the way.
    Doctor {
        /// Remove what dead processes have left.
        #[arg(long)]
        fix: bool,
    },
    /// The source's simulated experiments and every strategy over several seeds, in one process and in jumps (the kinematic
    /// mode): tables, curves and maps in --out [default: mirador-experiment]. Interrupted, it goes on when started again.
    Experiment(ExperimentArgs),
    /// Run another program as a child of the graph (used by the supervisor).
    #[command(hide = true)]
    ExecChild {
        /// Process id of the supervisor.
        #[arg(long)]
        parent: i32,
        /// The program and its arguments.
        #[arg(trailing_var_arg = true, required = true)]
        command: Vec<String>,
    },
    /// The other end of `bench ipc` (used by the bench).
    #[command(hide = true)]
    BenchPeer {
        /// Arguments of the peer.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        args: Vec<String>,
    },
}

/// Arguments of `explore`.
#[derive(Debug, Clone, Default, Args)]
pub struct ExploreArgs {
    /// Name of a built-in world (simple, structured, unstructured, field), or a world file [default: simple].
    pub world: Option<String>,
    /// Strategy that chooses the views, for example coverage_tour [default: multi_criteria].
    #[arg(long, value_name = "NAME")]
    pub strategy: Option<String>,
    /// Weights of information, quality, zones and travel cost [default: 0.43,0.35,0.22,0.09].
    #[arg(long, value_name = "A,Q,O,C", value_delimiter = ',', allow_hyphen_values = true)]
    pub weights: Vec<f64>,
    /// What all chance is drawn from [default: 1].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Stop after this many scans.
    #[arg(long, value_name = "N")]
    pub max_scans: Option<u32>,
    /// Let the robot's time pass at this multiple of real time, instead of as fast as the machine allows.
    #[arg(long, value_name = "X")]
    pub speed: Option<f64>,
}

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
pub struct ReplayArgs {
    /// A scan file, a folder of scans of one format, or a run.mcap.
    pub path: PathBuf,
    /// Prior poses (TUM, KITTI), relative to PATH [default: none, or the .pose files beside .3d scans].
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// True poses for the errors in the summary, relative to PATH.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Order of the points in a file without one, for example 226x360.
    #[arg(long, value_name = "ROWSxCOLS")]
    pub grid: Option<String>,
    /// Returns nearer than this are dropped [m].
    #[arg(long, value_name = "M")]
    pub min_range: Option<f32>,
    /// Returns farther than this are dropped [m].
    #[arg(long, value_name = "M")]
    pub max_range: Option<f32>,
    /// Release scans by their time stamps at this multiple of real time, instead of in lockstep.
    #[arg(long, value_name = "X")]
    pub speed: Option<f64>,
    /// Stop after this many scans.
    #[arg(long, value_name = "N")]
    pub max_scans: Option<u32>,
}

/// Arguments of `replan`.
#[derive(Debug, Clone, Args)]
pub struct ReplanArgs {
    /// Strategy to decide by [default: that of the graph].
    #[arg(long, value_name = "NAME")]
    pub strategy: Option<String>,
    /// Weights of information, quality, zones and travel cost, for example 0.65,0.25,0.1,0.09 [default: those of the
    /// graph].
    #[arg(long, value_name = "A,Q,O,C", value_delimiter = ',')]
    pub weights: Vec<f64>,
}

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// The service.
    pub service: String,
    /// How often the service was started before in this run (set by the supervisor).
    #[arg(long, default_value_t = 0, hide = true)]
    pub incarnation: u32,
    /// Number of the run (set by the supervisor).
    #[arg(long, default_value_t = 0, hide = true)]
    pub run: u32,
    /// Process id of the supervisor; the service ends with it.
    #[arg(long, hide = true)]
    pub parent: Option<i32>,
}

/// Arguments of `experiment`.
#[derive(Debug, Clone, Args)]
pub struct ExperimentArgs {
    /// Worlds [default: simple,structured,unstructured].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub worlds: Vec<String>,
    /// Experiments of the source, for example simple_ii, and strategies by name [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub experiments: Vec<String>,
    /// Runs of each [default: 10].
    #[arg(long, value_name = "N")]
    pub seeds: Option<u64>,
    /// The first seed [default: 1].
    #[arg(long, value_name = "N")]
    pub first_seed: Option<u64>,
    /// Scan with steps this much coarser than 0.5 deg, 1 to 10 [default: 1].
    #[arg(long, value_name = "N")]
    pub coarser: Option<usize>,
    /// A run that does not end is cut off after so many scans [default: 120].
    #[arg(long, value_name = "N")]
    pub max_scans: Option<usize>,
    /// d_max of the source's stop rule [m] [default: 30].
    #[arg(long, value_name = "M")]
    pub farthest: Option<f64>,
    /// Runs side by side; with more than one, times are those of a busy machine.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub jobs: usize,
}

/// Sends log lines to standard error.
pub fn init_logging(common: &Common) {
    let filter = EnvFilter::try_new(&common.log_level).unwrap_or_else(|_| {
        eprintln!("warning: --log-level '{}' is not a log filter; using 'warn'", common.log_level);
        EnvFilter::new("warn")
    });
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    match common.log_format {
        LogFormat::Text => builder.with_ansi(false).init(),
        LogFormat::Json => builder.json().init(),
    }
}
