//! A page of the documentation that begins with commands and ends with what they print: the commands are run, and what
//! they print is compared.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use super::{Finished, Stage, finish};

/// The top of the source tree.
pub fn root() -> PathBuf {
    fs::canonicalize(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")).unwrap()
}

/// Where cargo builds.
pub fn target() -> PathBuf {
    Path::new(env!("CARGO_BIN_EXE_mirador")).ancestors().nth(2).unwrap().to_owned()
}

/// Runs the commands of a page from the top of the source tree and expects what its last block says, in this order;
/// `...` stands for anything. `my-NAME` is a folder of the user's: one of the test's, unless `folders` says which.
pub fn run(stage: &Stage, page: &str, folders: &[(&str, &Path)]) {
    let text = fs::read_to_string(root().join("docs").join(page)).unwrap();
    let commands = block(&text, "```sh\n", false);
    let expected = block(&text, "```text\n", true);
    assert!(text.find("```").unwrap() == text.find("```sh").unwrap(), "{page} begins with its commands");
    assert!(text.trim_end().ends_with("```"), "{page} ends with what they print");
    let finished = shell(stage, &script(stage, commands, folders));
    assert!(finished.status.success(), "{page}\n{}\n{}", finished.stdout, finished.stderr);
    let mut lines = finished.stdout.lines();
    for line in expected.lines() {
        let found = lines.any(|said| matches(said, line));
        assert!(found, "{page}: no line `{line}` where it should be in\n{}\n{}", finished.stdout, finished.stderr);
    }
    stage.assert_nothing_left();
}

fn block<'a>(text: &'a str, fence: &str, last: bool) -> &'a str {
    let begin = if last { text.rfind(fence) } else { text.find(fence) }.unwrap() + fence.len();
    text[begin..].split("```").next().unwrap()
}

/// The commands with the test's folders and domain.
fn script(stage: &Stage, commands: &str, folders: &[(&str, &Path)]) -> String {
    let mut script = commands.replace("\\\n", " ");
    for (name, folder) in folders {
        script = script.replace(name, &folder.display().to_string());
    }
    let own = format!("{}/my-", stage.path("").display());
    script = script.replace(" my-", &format!(" {own}"));
    let runs = |line: &str| line.starts_with("mirador ") || line.contains(" -- ");
    let domain = format!(" --domain {}", stage.domain().name());
    let lines = script.lines().map(|line| match line.strip_suffix(" &") {
        Some(behind) if runs(line) => format!("{behind}{domain} &"),
        None if runs(line) => format!("{line}{domain}"),
        _ => line.to_owned(),
    });
    // Nothing that was left running behind outlives the test.
    let ending = "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n".to_owned();
    ending + &lines.collect::<Vec<String>>().join("\n")
}

fn shell(stage: &Stage, script: &str) -> Finished {
    let own = Path::new(env!("CARGO_BIN_EXE_mirador")).parent().unwrap();
    let path = format!("{}:{}", own.display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new("bash");
    command.args(["-euo", "pipefail", "-c", script]).current_dir(root()).env("PATH", path).stdin(Stdio::null());
    command.env("CARGO_TARGET_DIR", target()).env("CARGO_NET_OFFLINE", "true").env("TMPDIR", stage.path(""));
    finish(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
}

/// Whether a line is what was expected, `...` standing for anything.
pub fn matches(said: &str, expected: &str) -> bool {
    let mut parts: Vec<&str> = expected.split("...").collect();
    let (first, last) = (parts.remove(0), parts.pop());
    let Some(last) = last else { return said.trim_end() == first };
    let rest = said.trim_end().strip_prefix(first);
    let rest = parts.iter().fold(rest, |rest, part| Some(rest?.split_once(part)?.1));
    rest.is_some_and(|rest| rest.ends_with(last))
}

/// Builds the examples, which are a workspace of their own, and their tests; what they have in common with mirador's is
/// taken from its build folder where it is the same.
pub fn build_examples() {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let manifest = root().join("examples/Cargo.toml");
        for what in [&["build"][..], &["test", "--no-run"]] {
            let mut command = Command::new(&cargo);
            command.args(what).args(["--release", "--locked", "--offline", "--manifest-path"]).arg(&manifest);
            let status = command.arg("--target-dir").arg(target()).status().unwrap();
            assert!(
                status.success(),
                "the examples cannot be built. If examples/Cargo.lock is behind Cargo.lock: cp Cargo.lock examples/ && \
                 cargo metadata --offline --manifest-path examples/Cargo.toml > /dev/null"
            );
        }
    });
}
