//! One process of the graph: started, reaped, started again.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use rustix::process::{Pid, Signal, kill_process_group};

use crate::graph::{RestartPolicy, ServiceEntry};

/// Restarts are counted over this time.
const WINDOW: Duration = Duration::from_secs(60);

/// How a process of the graph is started.
#[derive(Debug, Clone)]
pub struct Launch {
    /// The name in the graph.
    pub name: String,
    /// Whether it is one of mirador's own services.
    pub built_in: bool,
    /// How it is run.
    pub entry: ServiceEntry,
    /// Arguments common to all services: configuration, domain, output, logging.
    pub common: Vec<String>,
    /// Number of the run.
    pub run: u32,
    /// The run directory.
    pub run_dir: PathBuf,
    /// The graph's domain.
    pub domain: String,
    /// Points of the largest scan.
    pub max_points: usize,
}

impl Launch {
    fn command(&self, incarnation: u32) -> Result<Command> {
        let own = std::env::current_exe().context("the path of this program is not known")?;
        let parent = std::process::id().to_string();
        let mut command = Command::new(own);
        if self.entry.command.is_empty() {
            command.args(["run", &self.name, "--parent", &parent]);
            command.args(["--incarnation", &incarnation.to_string(), "--run", &self.run.to_string()]);
            command.args(&self.common);
        } else {
            command.args(["exec-child", "--parent", &parent]);
            if !self.entry.cores.is_empty() {
                let cores: Vec<String> = self.entry.cores.iter().map(usize::to_string).collect();
                command.args(["--cores", &cores.join(",")]);
            }
            command.arg("--").args(&self.entry.command);
            command.env("MIRADOR_INCARNATION", incarnation.to_string());
            command.env("MIRADOR_RUN_DIR", &self.run_dir);
            command.env("MIRADOR_NAME", &self.name);
            command.env("MIRADOR_DOMAIN", &self.domain);
            command.env("MIRADOR_RUN", self.run.to_string());
            command.env("MIRADOR_MAX_POINTS", self.max_points.to_string());
            command.env("MIRADOR_THREADS", self.entry.threads.to_string());
        }
        // A group of its own: Ctrl-C in the terminal reaches the supervisor, which ends the others in order.
        command.process_group(0).stdin(Stdio::null()).stdout(Stdio::null()).stderr(self.log()?);
        Ok(command)
    }

    /// Where the process's standard error goes.
    pub fn log_path(&self) -> PathBuf {
        self.run_dir.join("logs").join(format!("{}.log", self.name))
    }

    fn log(&self) -> Result<File> {
        let path = self.log_path();
        let open = OpenOptions::new().create(true).append(true).open(&path);
        open.with_context(|| format!("{}: cannot be opened", path.display()))
    }
}

/// What became of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It runs.
    Running,
    /// It was started again after it had died.
    Restarted,
    /// It waits to be started again.
    Waiting,
    /// It ended and stays ended.
    Ended,
    /// It failed and may not be started again.
    GaveUp,
}

/// A process of the graph over all its incarnations.
pub struct Supervised {
    /// How it is started.
    pub launch: Launch,
    child: Option<Child>,
    incarnation: u32,
    deaths: VecDeque<Instant>,
    start_at: Option<Instant>,
    last_status: Option<ExitStatus>,
}

impl Supervised {
    /// Starts the process for the first time.
    pub fn start(launch: Launch) -> Result<Self> {
        let mut this =
            Self { launch, child: None, incarnation: 0, deaths: VecDeque::new(), start_at: None, last_status: None };
        this.spawn()?;
        Ok(this)
    }

    fn spawn(&mut self) -> Result<()> {
        let child = self
            .launch
            .command(self.incarnation)?
            .spawn()
            .with_context(|| format!("{} cannot be started", self.launch.name))?;
        tracing::info!(service = self.launch.name, pid = child.id(), incarnation = self.incarnation, "started");
        self.child = Some(child);
        self.start_at = None;
        Ok(())
    }

    /// Times it was started again.
    pub fn restarts(&self) -> u32 {
        self.incarnation
    }

    /// How it last ended, in words.
    pub fn last_end(&self) -> String {
        match self.last_status {
            None => "runs".into(),
            Some(status) => match (status.code(), status.signal()) {
                (Some(code), _) => format!("exit code {code}"),
                (None, Some(signal)) => format!("signal {signal}"),
                (None, None) => "unknown end".into(),
            },
        }
    }

    /// Looks after it: reaps it when it has died and starts it again when its rule says so. `clean` frees what the dead
    /// process has left in shared memory and is called before the new one starts.
    pub fn look_after(&mut self, clean: &dyn Fn()) -> Result<Fate> {
        if self.child.is_some() {
            let Some(status) = self.reap().context("a child cannot be waited for")? else {
                return Ok(Fate::Running);
            };
            clean();
            if !self.should_restart(status) {
                return Ok(if status.success() { Fate::Ended } else { Fate::GaveUp });
            }
            tracing::warn!(service = self.launch.name, end = self.last_end(), "died; it is started again");
            self.start_at = Some(Instant::now() + self.pause());
        }
        match self.start_at {
            Some(time) if Instant::now() >= time => {
                self.incarnation += 1;
                self.spawn()?;
                Ok(Fate::Restarted)
            }
            Some(_) => Ok(Fate::Waiting),
            None => Ok(Fate::Ended),
        }
    }

    /// The end of the process, if it has come. What it has started ends with it.
    fn reap(&mut self) -> std::io::Result<Option<ExitStatus>> {
        let Some(child) = &mut self.child else { return Ok(None) };
        let status = child.try_wait()?;
        if status.is_some() {
            self.signal(Signal::KILL);
            self.child = None;
            self.last_status = status;
        }
        Ok(status)
    }

    fn should_restart(&mut self, status: ExitStatus) -> bool {
        // A wrong configuration does not become right by another try.
        let usage = status.code() == Some(i32::from(crate::EXIT_USAGE));
        let wanted = match self.launch.entry.restart {
            RestartPolicy::Never => false,
            RestartPolicy::OnFailure => !status.success() && !usage,
            RestartPolicy::Always => !usage,
        };
        let now = Instant::now();
        self.deaths.push_back(now);
        self.deaths.retain(|death| now.duration_since(*death) < WINDOW);
        wanted && self.deaths.len() <= self.launch.entry.max_restarts as usize
    }

    /// The first restart comes at once; the next ones wait longer and longer, so that a service that cannot live does
    /// not take the machine with it.
    fn pause(&self) -> Duration {
        let recent = u32::try_from(self.deaths.len()).unwrap_or(u32::MAX);
        match recent {
            0 | 1 => Duration::ZERO,
            n => Duration::from_millis(100) * 2_u32.saturating_pow((n - 2).min(5)),
        }
    }

    /// Whether the process is alive.
    pub fn is_alive(&mut self) -> bool {
        self.child.is_some() && matches!(self.reap(), Ok(None))
    }

    /// Sends a signal to the process and its descendants.
    pub fn signal(&self, signal: Signal) {
        let pid = self.child.as_ref().and_then(|c| i32::try_from(c.id()).ok()).and_then(Pid::from_raw);
        if let Some(pid) = pid {
            // It may have ended in this moment, which is what is wanted.
            let _ = kill_process_group(pid, signal);
        }
    }
}

impl Drop for Supervised {
    fn drop(&mut self) {
        // Whatever happens to the supervisor's own code, no child is left behind.
        if self.is_alive() {
            self.signal(Signal::KILL);
        }
        if let Some(child) = &mut self.child {
            let _ = child.wait();
        }
    }
}

/// The last line of a log that is not empty: what a service said before it failed.
pub fn last_line(path: &Path) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    text.lines().rev().map(str::trim).find(|line| !line.is_empty()).map(|l| l.trim_start_matches("error: ").to_owned())
}
