//! The command line of `bench`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What `bench` measures.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// One-way latency between two processes, beside bare iceoryx2, a Unix socket and a pipe.
    Ipc(BenchIpcArgs),
    /// Speed and error of every registration method, beside small_gicp, KISS-ICP and GTSAM from PyPI.
    Registration(BenchRegistrationArgs),
    /// From the last beam to the plan through the real processes: every stage, the waiting between them, and the graph's
    /// own share. Scans a scene with the source's scanner; takes --set, --config and --out like a run.
    Pipeline(BenchPipelineArgs),
    /// Time of a plan, and what strategies achieve in whole explorations.
    Planning(BenchPlanningArgs),
    /// Surface, scores and map by themselves, with one thread and with two.
    Stages {
        /// Write the figures to this file.
        #[arg(long, value_name = "FILE")]
        json: Option<PathBuf>,
        /// Worker threads, rows for each.
        #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [1, 2])]
        threads: Vec<usize>,
        /// Runs over the tour of fifteen scans, apart from one for warming up.
        #[arg(long, value_name = "N", default_value_t = 10)]
        repetitions: usize,
    },
    /// What became slower, and what faster, from one report to another, by a statistical test. The exit code is 1 when
    /// anything became slower, 2 when the reports cannot be compared.
    Compare(BenchCompareArgs),
    /// Rays a second, time of a scan and of a step of the physics in every built-in world.
    Simulator {
        /// Write the figures to this file.
        #[arg(long, value_name = "FILE")]
        json: Option<PathBuf>,
        /// Runs of every case, apart from one for warming up.
        #[arg(long, value_name = "N", default_value_t = 11)]
        repetitions: usize,
    },
}

/// Arguments of `bench ipc`.
#[derive(Debug, Clone, Args)]
pub struct BenchIpcArgs {
    /// Write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Messages per case [default: 1000, fewer of large ones].
    #[arg(long, value_name = "N")]
    pub messages: Option<u64>,
    /// Bytes of the payloads, multiples of 16, for example 64,6232320,64000000 [default: 64, 4096, 262144, and a scan].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub payloads: Vec<usize>,
    /// Numbers of subscribers, 1 to 8, rows for each; they share the second core.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [1])]
    pub subscribers: Vec<usize>,
    /// Measure on busy cores too: a thread on each of the two cores goes through memory all the time.
    #[arg(long)]
    pub loaded: bool,
    /// Pause between messages [ms].
    #[arg(long, value_name = "MS")]
    pub pace_ms: Option<f64>,
}

/// Arguments of `bench compare`.
#[derive(Debug, Clone, Args)]
pub struct BenchCompareArgs {
    /// The earlier report, written by `bench WHAT --json FILE`.
    #[arg(value_name = "OLD.json")]
    pub old: PathBuf,
    /// The later one.
    #[arg(value_name = "NEW.json")]
    pub new: PathBuf,
    /// Changes up to this share are none: 0.05 is 5 %.
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, allow_hyphen_values = true)]
    pub threshold: f64,
    /// The largest chance that noise alone makes anything a regression.
    #[arg(long, value_name = "CHANCE", default_value_t = 0.01, allow_hyphen_values = true)]
    pub alpha: f64,
    /// Write the comparison to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `bench pipeline`.
#[derive(Debug, Clone, Args)]
pub struct BenchPipelineArgs {
    /// Write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Scans that are measured.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub scans: u32,
    /// Scans that are in the map before the first one that is measured.
    #[arg(long, value_name = "N", default_value_t = 40)]
    pub after: u32,
    /// Write what every process did when to this file, as Chrome trace events for ui.perfetto.dev.
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
}

/// Arguments of `bench planning`.
#[derive(Debug, Clone, Args)]
pub struct BenchPlanningArgs {
    /// Write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Plans timed for each row, 1 to 39 [default: 15].
    #[arg(long, value_name = "N")]
    pub repetitions: Option<usize>,
    /// What to measure: evaluate, growth, exploration [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub cases: Vec<String>,
    /// Strategies to measure, for example multi_criteria,coverage_tour [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub strategies: Vec<String>,
    /// Scans of the drive of `growth` [default: 4000].
    #[arg(long, value_name = "N")]
    pub growth_scans: Option<usize>,
    /// Explorations of each strategy in each world [default: 3].
    #[arg(long, value_name = "N")]
    pub seeds: Option<u64>,
    /// Explorations scan with steps this much coarser than 0.5 deg, 1 to 10 [default: 4].
    #[arg(long, value_name = "N")]
    pub coarser: Option<usize>,
}

/// Arguments of `bench registration`.
#[derive(Debug, Clone, Args)]
pub struct BenchRegistrationArgs {
    /// Write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Runs of every method on every pair, apart from one for warming up [default: 11]; sequences run a quarter as often.
    #[arg(long, value_name = "N")]
    pub repetitions: Option<usize>,
    /// Our methods to measure, for example point_to_plane,gicp [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub methods: Vec<String>,
    /// What to measure: pair, sequence, relaxation, loop, growth [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub cases: Vec<String>,
    /// Scans of the drive of `growth` [default: 4000].
    #[arg(long, value_name = "N")]
    pub growth_scans: Option<usize>,
    /// A folder of scans, all pairs of which are aligned; or the folder of the known data sets, or of one pair (target.*,
    /// source.*, target_from_source.txt) [default: MIRADOR_DATA, else ../shared/data beside the project].
    #[arg(long, value_name = "PATH")]
    pub data: Option<PathBuf>,
    /// Of a folder of scans, what is asked of its pairs.
    #[command(flatten)]
    pub pairs: AllPairsArgs,
    /// Leave the peers out.
    #[arg(long)]
    pub no_peers: bool,
    /// Python in which the peers are installed [default: MIRADOR_PYTHON, else python3].
    #[arg(long, value_name = "PROGRAM")]
    pub python: Option<PathBuf>,
}

/// Arguments of `bench registration --data FOLDER` for a folder of scans.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = "For a folder of scans (--data)")]
pub struct AllPairsArgs {
    /// True poses (TUM, KITTI), relative to the folder [default: its truth.tum, poses.tum, groundtruth.txt, poses.txt, or the
    /// .pose files beside .3d scans].
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Prior poses, relative to the folder, from whose motions every alignment starts [default: from the identity].
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Write a page with tables and plots to this file.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Scans farther apart than this make no pair [m] [default: 4].
    #[arg(long, value_name = "M")]
    pub max_distance: Option<f64>,
    /// The largest translation error of a success [m] [default: 0.1].
    #[arg(long, value_name = "M")]
    pub success_m: Option<f64>,
    /// The largest rotation error of a success [deg] [default: 1].
    #[arg(long, value_name = "DEG")]
    pub success_deg: Option<f64>,
    /// Worker threads of every method [default: 2].
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}
