//! A Python with the packages of the examples, in an environment of the tests' own.

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use super::page::target;
use super::say_skipped;

/// What the examples need.
const PACKAGES: [&str; 3] = ["iceoryx2==0.10.0", "small-gicp==1.0.1", "numpy"];

/// The folder of a virtual environment with the packages, made under the build folder when it is not there; `None`, after
/// saying so, when there is no Python or the packages cannot be had. With `MIRADOR_DATA_REQUIRED=1` that is a failure.
pub fn environment(test: &str) -> Option<PathBuf> {
    static MADE: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match MADE.get_or_init(make) {
        Ok(folder) => Some(folder.clone()),
        Err(why) => {
            assert!(std::env::var_os("MIRADOR_DATA_REQUIRED").is_none_or(|v| v != "1"), "{test}: {why}");
            say_skipped(test, why);
            None
        }
    }
}

fn make() -> Result<PathBuf, String> {
    let folder = target().join("python-packages");
    let stamp = folder.join("installed");
    if fs::read_to_string(&stamp).is_ok_and(|packages| packages == PACKAGES.join(" ")) {
        return Ok(folder);
    }
    let place = folder.display().to_string();
    run("python3", &["-m", "venv", &place])?;
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    run(&format!("{place}/bin/python"), &[&install[..], &PACKAGES].concat())?;
    fs::write(&stamp, PACKAGES.join(" ")).map_err(|e| format!("{}: {e}", stamp.display()))?;
    Ok(folder)
}

fn run(program: &str, arguments: &[&str]) -> Result<(), String> {
    let told =
        |why: String| format!("no Python with {}: {program} {}: {why}", PACKAGES.join(", "), arguments.join(" "));
    let output = Command::new(program).args(arguments).output().map_err(|e| told(e.to_string()))?;
    if output.status.success() { Ok(()) } else { Err(told(String::from_utf8_lossy(&output.stderr).trim().to_owned())) }
}
