//! On what machine, and of what commit, a report was measured.

use std::path::Path;
use std::process::Command;

use serde::{Deserialize, Serialize};

/// The machine and the build behind a report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Model name of the processor.
    pub cpu: String,
    /// Cores this process may use.
    pub cores: usize,
    /// Operating system and its release.
    pub os: String,
    /// Commit of the build, "unknown" where nothing tells it.
    pub commit: String,
}

impl Machine {
    /// This machine. The commit is that of the build (`MIRADOR_COMMIT` in its environment), else that of the source
    /// tree in the current folder.
    #[must_use]
    pub fn here() -> Self {
        Self {
            cpu: cpu_model().unwrap_or_else(|| "unknown".into()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            os: os_release().unwrap_or_else(|| std::env::consts::OS.into()),
            commit: option_env!("MIRADOR_COMMIT")
                .map(str::to_owned)
                .or_else(commit)
                .unwrap_or_else(|| "unknown".into()),
        }
    }
}

fn cpu_model() -> Option<String> {
    let info = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':')).map(|(_, name)| name.trim().into())
}

fn os_release() -> Option<String> {
    let read = |file| std::fs::read_to_string(Path::new("/proc/sys/kernel").join(file)).ok();
    Some(format!("{} {}", read("ostype")?.trim(), read("osrelease")?.trim()))
}

/// The commit of the source tree around the current folder, if it is one of mirador.
fn commit() -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let top = git(&["rev-parse", "--show-toplevel"])?;
    // The benchmark may be run inside any other repository, whose commit would say nothing.
    Path::new(&top).join("ipc_schema/Cargo.toml").is_file().then(|| git(&["rev-parse", "--short=12", "HEAD"]))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_has_a_processor_and_a_system() {
        let machine = Machine::here();
        assert!(machine.cores >= 1 && machine.os.starts_with("Linux "), "{machine:?}");
        assert!(!machine.cpu.is_empty() && !machine.commit.is_empty());
    }
}
