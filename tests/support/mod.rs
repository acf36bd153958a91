//! What the process tests share: the program, a domain and a folder of its own for each test, and cleaning up.
//!
//! Process tests run one at a time: two graphs at once would compete for two cores and for memory.

#![allow(dead_code, reason = "every test target uses another part of it")]

pub mod answerer;
pub mod moving;
pub mod observer;
pub mod outputs;
pub mod page;
pub mod python;
pub mod viewer;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mirador_ipc_schema::{Domain, Participant};
use serde_json::Value;

/// The longest a run of a test may take before it counts as hanging.
const PATIENCE: Duration = Duration::from_secs(300);

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A place for one test: a folder, a domain, and the right to run processes. Dropping it ends what still runs and
/// removes both, also when the test has failed.
pub struct Stage {
    folder: tempfile::TempDir,
    domain: Domain,
    _turn: MutexGuard<'static, ()>,
}

impl Stage {
    pub fn new() -> Self {
        let turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        Self { folder: tempfile::tempdir().unwrap(), domain: new_domain(), _turn: turn }
    }

    /// A path in the test's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// The program in the test's folder and domain.
    pub fn mirador<S: AsRef<str>>(&self, arguments: &[S]) -> Command {
        self.mirador_in(&self.domain, arguments)
    }

    /// The program in another domain.
    pub fn mirador_in<S: AsRef<str>>(&self, domain: &Domain, arguments: &[S]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mirador"));
        command.args(arguments.iter().map(AsRef::as_ref)).args(["--domain", domain.name()]);
        command.current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    /// Runs the program to its end; panics with its output when it hangs.
    pub fn run<S: AsRef<str>>(&self, arguments: &[S]) -> Finished {
        finish(self.mirador(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    /// Runs the program and expects it to do what it was asked.
    pub fn run_well<S: AsRef<str>>(&self, arguments: &[S]) -> Finished {
        let finished = self.run(arguments);
        assert!(finished.status.success(), "{:?}\n{}\n{}", finished.status, finished.stdout, finished.stderr);
        self.assert_nothing_left();
        finished
    }

    /// Nobody of the domain is alive and nothing of it is in shared memory.
    pub fn assert_nothing_left(&self) {
        assert_nothing_left(&self.domain);
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        end_all(&self.domain);
    }
}

/// A domain that no other test has.
pub fn new_domain() -> Domain {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    Domain::new(&format!("t{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed))).unwrap()
}

pub fn assert_nothing_left(domain: &Domain) {
    assert_eq!(domain.segments(), Vec::<PathBuf>::new(), "left in shared memory");
    let alive: Vec<_> = living(domain);
    assert!(alive.is_empty(), "still alive: {alive:?}");
}

/// Name and process id of everyone alive in the domain.
pub fn living(domain: &Domain) -> Vec<(String, u32)> {
    let peers = Participant::peers(domain).unwrap_or_default();
    peers.into_iter().filter(|p| p.alive).map(|p| (p.name, p.pid)).collect()
}

/// Kills everyone alive in a domain and removes its files.
pub fn end_all(domain: &Domain) {
    for (_, pid) in living(domain) {
        signal(pid, "KILL");
    }
    let begin = Instant::now();
    while !living(domain).is_empty() && begin.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(10));
    }
    let _ = domain.remove_all();
}

/// Sends a signal by name.
pub fn signal(pid: u32, name: &str) {
    let _ = Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status();
}

/// A process that has ended, with what it said.
pub struct Finished {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
    pub took: Duration,
}

/// Waits for a process whose output is piped.
pub fn finish(mut child: Child) -> Finished {
    let begin = Instant::now();
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let read = |pipe: Option<Box<dyn std::io::Read + Send>>| {
        std::thread::spawn(move || {
            let mut text = Vec::new();
            if let Some(mut pipe) = pipe {
                let _ = pipe.read_to_end(&mut text);
            }
            String::from_utf8_lossy(&text).into_owned()
        })
    };
    let out = read(stdout.map(|p| Box::new(p) as Box<dyn std::io::Read + Send>));
    let err = read(stderr.map(|p| Box::new(p) as Box<dyn std::io::Read + Send>));
    let status = wait(&mut child);
    let took = begin.elapsed();
    let (stdout, stderr) = (out.join().unwrap(), err.join().unwrap());
    match status {
        Some(status) => Finished { status, stdout, stderr, took },
        None => panic!("it hangs\n{stdout}\n{stderr}"),
    }
}

/// The end of a process; `None` (and it is killed) when it does not come.
fn wait(child: &mut Child) -> Option<ExitStatus> {
    let begin = Instant::now();
    loop {
        if let Ok(Some(status)) = child.try_wait() {
            return Some(status);
        }
        if begin.elapsed() > PATIENCE {
            let _ = child.kill();
            let _ = child.wait();
            return None;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Waits until `condition` holds; panics with `what` when it never does.
pub fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(60), "never came true: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The summary of an output folder.
pub fn summary(out: &Path) -> Value {
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// Scan, inode and offset of every payload that a log of JSON lines tells of with this message.
pub fn places_of(log: &str, message: &str) -> Vec<(u64, u64, u64)> {
    let lines = log.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let told = lines.map(|line| line["fields"].clone()).filter(|fields| fields["message"] == message);
    told.map(|fields| {
        let number = |name: &str| fields[name].as_u64().unwrap_or_else(|| panic!("no {name}: {fields}"));
        (number("scan"), number("inode"), number("offset"))
    })
    .collect()
}

/// A folder of the shared data, or `None` with a plain word when it is absent. With `MIRADOR_DATA_REQUIRED=1` absence
/// is a failure.
pub fn data(test: &str, name: &str) -> Option<PathBuf> {
    let base = std::env::var_os("MIRADOR_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let path = base.join(name);
    if path.exists() {
        return Some(fs::canonicalize(path).unwrap());
    }
    assert!(std::env::var_os("MIRADOR_DATA_REQUIRED").is_none_or(|v| v != "1"), "no data at {}", path.display());
    say_skipped(test, &format!("no data at {}", path.display()));
    None
}

/// Says that a test is skipped: on standard error itself, since the test runner keeps what a passing test prints.
pub fn say_skipped(test: &str, why: &str) {
    let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: {why}");
}

/// The tour of the built-in scene with [`small_scanner`].
pub fn small_tour() -> Vec<String> {
    std::iter::once("tour".to_owned()).chain(small_scanner()).collect()
}

/// Settings of a scanner with few beams, so that a scan takes a millisecond: 72 sweeps of 136 beams every 2 degrees,
/// enough for registration in the scene `simple`.
pub fn small_scanner() -> Vec<String> {
    let settings = ["beams=136", "beam_step_deg=2.0", "sweeps=180"];
    settings.iter().flat_map(|s| ["--set".to_owned(), format!("acquisition.scanner.{s}")]).collect()
}
